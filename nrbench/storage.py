"""Write files atomically (under another name, then renamed), read them, and find those that users name."""

from __future__ import annotations

import atexit
import contextlib
import errno
import json
import os
import stat
import sys
import tempfile
import threading
import time
import uuid
import zipfile
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, cast

from nrbench.errors import BadInput, describe_error

# numpy is imported by the functions that hold arrays: a list of plugins needs none.
if TYPE_CHECKING:
    from numpy.typing import NDArray

NO_LINK = "is a link or no regular file, or lies too deep; remove it (nrbench follows no links inside a run)"
"""The message for a path inside a run that is not opened."""
_NO_LINK_FLAGS = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
_DEEPEST = 8
"""Levels of folders below the folder of a cell; its own are one level deep."""
_without_links: dict[str, tuple[int, int] | None] = {}


def follow_no_link_below(root: Path) -> None:
    """Let the functions of this module follow no link below a folder, from now on and in this process.

    They then open each folder on the way by its name in the one above, so that a link is also found if it takes the
    place of a folder while they work. Where the system cannot do this (Windows), only the last name is checked.

    Parameters
    ----------
    root
        An absolute path. Links in it are followed.
    """
    if os.open in os.supports_dir_fd:
        _without_links[f"{root}{os.sep}"] = None
        with contextlib.suppress(OSError):
            _without_links[f"{root}{os.sep}"] = _identify(root.stat())


def _identify(folder: os.stat_result) -> tuple[int, int]:
    return folder.st_dev, folder.st_ino


@contextlib.contextmanager
def _folder_of(path: Path, make: bool = False) -> Iterator[tuple[str, int | None]]:
    """Yield the name of a file and the descriptor of its folder; where links are followed, the path and None.

    Raises
    ------
    BadInput
        When there is a link on the way from a folder of :func:`follow_no_link_below` to the file, or another folder has
        taken the place of that folder.
    """
    text = os.path.abspath(path)  # noqa: PTH100  (it keeps links)
    root = max((each for each in list(_without_links) if text.startswith(each)), key=len, default=None)
    if root is None:
        if make:
            path.parent.mkdir(parents=True, exist_ok=True)
        yield str(path), None
        return
    *folders, name = Path(text.removeprefix(root)).parts
    if make:
        os.makedirs(root, exist_ok=True)  # noqa: PTH103
    place, flags = root, os.O_RDONLY | getattr(os, "O_DIRECTORY", 0)
    descriptor = os.open(root, flags)
    try:
        if _without_links[root] not in (None, _identify(os.fstat(descriptor))):
            raise BadInput(f"{root}: another folder has taken its place; start again")
        for folder in folders:
            place = os.path.join(place, folder)  # noqa: PTH118
            if make:
                with contextlib.suppress(FileExistsError):
                    os.mkdir(folder, dir_fd=descriptor)
            try:
                inner = os.open(folder, flags | _NO_LINK_FLAGS, dir_fd=descriptor)
            except OSError as error:
                if error.errno in (errno.ELOOP, errno.ENOTDIR):
                    raise BadInput(f"{place}: {NO_LINK}") from None
                error.filename = place
                raise
            os.close(descriptor)
            descriptor = inner
        yield name, descriptor
    finally:
        os.close(descriptor)


def open_regular(path: Path, flags: int = os.O_RDONLY) -> int:
    """Open a regular file, follow no link at its name, and return its descriptor.

    Below a folder of :func:`follow_no_link_below` no other link is followed either.

    Raises
    ------
    BadInput
        When there is a link, a folder, a device or a named pipe at the path.
    OSError
        When the file cannot be opened.
    """
    with _folder_of(path) as (name, folder):
        if not path.is_symlink():
            try:
                descriptor = os.open(name, flags | _NO_LINK_FLAGS, 0o644, dir_fd=folder)
            except OSError as error:
                if error.errno not in (errno.ELOOP, errno.ENXIO):  # ENXIO: a socket, or a pipe that nobody reads
                    error.filename = str(path)
                    raise
            else:
                if stat.S_ISREG(os.fstat(descriptor).st_mode):
                    return descriptor
                os.close(descriptor)
    raise BadInput(f"{path}: {NO_LINK}")


def open_file(path: Path) -> BinaryIO:
    """Open a file for reading. Below a folder of :func:`follow_no_link_below` it must be a regular one."""
    guarded = any(os.path.abspath(path).startswith(root) for root in _without_links)  # noqa: PTH100
    return open(open_regular(path), "rb") if guarded else path.open("rb")


def read_bytes(path: Path) -> bytes:
    """Return the content of a file that :func:`open_file` opens."""
    with open_file(path) as file:
        return file.read()


def make_folder(path: Path) -> None:
    """Make a folder and those above it, where they do not exist; follow links as :func:`open_file` does."""
    with _folder_of(path / "any", make=True):
        pass


def remove(path: Path) -> None:
    """Remove a file, a link, or a folder with all it holds; follow links as :func:`open_file` does."""
    with contextlib.suppress(OSError, BadInput), _folder_of(path) as (name, folder):
        with contextlib.suppress(OSError):
            os.unlink(name, dir_fd=folder)  # fails if it is a folder
        opened = Path(f"/proc/self/fd/{folder}")  # no link can take its place
        remove_folder(opened / name if folder is not None and opened.is_dir() else path)


def write_aside(path: Path, write: Callable[[BinaryIO], object], durable: bool = False) -> None:
    """Write a file under a temporary name, then rename it: no reader sees a part of it.

    The temporary name is random, so that no link can wait there.

    Parameters
    ----------
    path
        The file. Its folder is made if it does not exist.
    write
        Writes the content to the opened file.
    durable
        Whether the content is on the disk before the file gets its name, so that a loss of power leaves the old file
        or the new one. This takes about 2 ms.

    Raises
    ------
    OSError
        When it cannot be written. The error names ``path``.
    BadInput
        When a link is in the way, below a folder of :func:`follow_no_link_below`.
    """
    with _folder_of(path, make=True) as (name, folder):
        aside = str(Path(name).with_name(f".{path.stem[:80]}-{uuid.uuid4().hex}{path.suffix}"))
        try:
            with os.fdopen(os.open(aside, _CREATE, 0o666, dir_fd=folder), "w+b") as file:
                write(cast("BinaryIO", file))
                if durable:
                    file.flush()
                    os.fsync(file.fileno())
            os.replace(aside, name, src_dir_fd=folder, dst_dir_fd=folder)
        except OSError as error:
            # A full disk names no file, and the temporary name means nothing to a user.
            if error.filename in (None, aside):
                error.filename = str(path)
            raise
        finally:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(aside, dir_fd=folder)


_CREATE = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)


_user_folder: Path | None = None


def leave_user_folder(user_folder: Path, working: Path) -> None:
    """Make another folder the working directory of this process, which is about to import or run a plugin.

    Files that the plugin writes to relative paths then do not litter the user's folder. :func:`user_path` still starts
    from there, and so do the relative entries of ``sys.path``, which become absolute.

    Parameters
    ----------
    user_folder
        The folder in which the user started nrbench.
    working
        The new working directory. It is made if it does not exist.
    """
    global _user_folder
    places = _relative_places(user_folder)
    sys.path[:] = [places.get(entry, entry) for entry in sys.path]
    working.mkdir(mode=0o700, parents=True, exist_ok=True)
    os.chdir(working)
    _user_folder = user_folder


@contextlib.contextmanager
def outside_user_folder() -> Iterator[None]:
    """Make a temporary folder the working directory for a while, in which a plugin is imported.

    See :func:`leave_user_folder`. Nothing changes in a process that has left the user's folder already, that could not
    return to it, or that has several threads, because the working directory is the same for all of them.
    """
    global _user_folder
    user_folder = _enterable_folder()
    if _user_folder is not None or user_folder is None or threading.active_count() > 1:
        yield
        return
    entries = {place: entry for entry, place in _relative_places(user_folder).items()}
    with temporary_folder() as folder:
        leave_user_folder(user_folder, folder / "work")
        try:
            yield
        finally:
            _user_folder = None
            with contextlib.suppress(OSError):  # the plugin has removed it
                os.chdir(user_folder)
            sys.path[:] = [entries.get(place, place) for place in sys.path]


def _enterable_folder() -> Path | None:
    """Return the working directory; None if somebody has removed it, or this user may not enter it, as under sudo."""
    try:
        folder = Path.cwd()
        os.chdir(folder)
    except OSError:
        return None
    return folder


def _relative_places(user_folder: Path) -> dict[str, str]:
    """Return the places of the relative entries of ``sys.path``; entries that name no place are for import hooks."""
    entries = [entry for entry in sys.path if not Path(entry).is_absolute() and (user_folder / entry).exists()]
    return {entry: str(user_folder / entry) for entry in entries}


def working_folder() -> str:
    """Return the working directory of this process; that of temporary files if it does not exist any more."""
    try:
        return str(Path.cwd())
    except FileNotFoundError:  # somebody has removed it
        return tempfile.gettempdir()


def user_path(path: str | Path) -> Path:
    """Return a path that a user gave, as it is to be opened: a relative one starts from the user's folder.

    Parameters
    ----------
    path
        As the user wrote it.

    Returns
    -------
    Path
        Absolute where the working directory is not the user's folder.

    Examples
    --------
    >>> from nrbench import user_path
    >>> user_path("picture.png").name
    'picture.png'
    """
    return Path(path) if _user_folder is None else _user_folder / path


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file, atomically."""
    write_aside(path, lambda file: file.write(content))


def write_text(path: Path, text: str) -> None:
    """Write text as UTF-8, atomically. What UTF-8 cannot hold, such as half of a surrogate pair, is written escaped."""
    write_bytes(path, text.encode("utf-8", "backslashreplace"))


def write_files(folder: Path, contents: Mapping[str, str | bytes]) -> list[Path]:
    """Write files of text or bytes by their names, each atomically, and return their paths."""
    for name, content in contents.items():
        if isinstance(content, str):
            write_text(folder / name, content)
        else:
            write_bytes(folder / name, content)
    return [folder / name for name in contents]


@contextlib.contextmanager
def temporary_folder() -> Iterator[Path]:
    """Yield a temporary folder, and remove it, as well as those that processes which were killed left behind.

    Raises
    ------
    BadInput
        When the system has no folder of temporary files that can be written to.
    """
    try:
        _remove_stale(Path(tempfile.gettempdir()))
        folder = Path(tempfile.mkdtemp(prefix=_PREFIX))
    except OSError as error:
        raise BadInput(f"temporary files: {error}; set TMPDIR to a folder that can be written to") from error
    remove = partial(remove_folder, folder)
    atexit.register(remove)  # a process may end without leaving the context
    try:
        with _hold(folder):
            yield folder
    finally:
        atexit.unregister(remove)
        remove()


def remove_folder(folder: Path) -> None:
    """Remove a folder and all it holds, whatever a plugin has put there; what cannot be removed stays.

    No link is followed. Folders may be nested to any depth, and their owner need not be allowed to write to them. Both
    is more than :func:`shutil.rmtree` and :class:`tempfile.TemporaryDirectory` do, of which the latter changes the
    modes of files that links point to in Python 3.11. Each inner folder is moved to the top, and emptied there.
    """
    inner = [folder]
    while inner:
        place = inner.pop()
        with contextlib.suppress(OSError):
            inner += _empty(place, folder)
        with contextlib.suppress(OSError):
            if place != folder:
                place.rmdir()
    with contextlib.suppress(OSError):
        folder.rmdir()


def _empty(place: Path, top: Path) -> Iterator[Path]:
    """Remove the files of a folder, and move its folders to ``top``; yield where they are."""
    if not stat.S_ISDIR(place.lstat().st_mode):
        place.unlink()
        return
    _open(place)
    with os.scandir(place) as found:
        entries = list(found)
    for entry in entries:
        with contextlib.suppress(OSError):
            if entry.is_dir(follow_symlinks=False):
                _open(Path(entry.path))  # a folder that may not be written to cannot be moved
                yield Path(entry.path).rename(top / uuid.uuid4().hex)
            else:
                os.unlink(entry.path)  # noqa: PTH108


def _open(folder: Path) -> None:
    """Let this user read and change a folder, if it is theirs."""
    with contextlib.suppress(OSError):
        folder.chmod(0o700)


_PREFIX, _HELD = "nrbench-", ".held"


@contextlib.contextmanager
def _hold(folder: Path) -> Iterator[bool]:
    """Lock a folder while its process lives; yield whether it was free. Where there are no locks, none is free."""
    with contextlib.ExitStack() as stack:
        try:
            import fcntl

            file = open_regular(folder / _HELD, os.O_RDWR | os.O_CREAT)
            stack.callback(os.close, file)
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            free = True
        except (ImportError, OSError, BadInput):
            free = False
        yield free


def _remove_stale(place: Path) -> None:
    """Remove the temporary folders of this user that no living process holds, except those of the last minute."""
    if sys.platform == "win32":
        return
    for folder in place.glob(f"{_PREFIX}*"):
        with contextlib.suppress(OSError):
            held = (folder / _HELD).lstat()
            if not folder.is_symlink() and held.st_uid == os.getuid() and time.time() - held.st_mtime > 60:
                with _hold(folder) as free:
                    if free:
                        remove_folder(folder)


def write_json(path: Path, content: Mapping[str, Any], durable: bool = False) -> None:
    """Write a mapping as JSON, atomically. NaN and infinity raise ValueError; None means that a value is unknown.

    Parameters
    ----------
    path, content
        The file, and what it will hold.
    durable
        Whether the content is on the disk before the file gets its name, so that a loss of power leaves the old file
        or the new one. This takes about 2 ms.
    """
    text = json_text(content) + "\n"
    write_aside(path, lambda file: file.write(text.encode()), durable)


def json_text(content: Mapping[str, Any], indent: int | None = 1) -> str:
    """Return a mapping as JSON, in one line if ``indent`` is None. NaN and infinity raise ValueError."""
    return json.dumps(content, indent=indent, allow_nan=False, default=_plain)


def _plain(value: Any) -> Any:
    import numpy as np

    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be written as JSON")


def find_strange(folder: Path, levels: int = _DEEPEST) -> Path | None:
    """Return the first entry of a folder and of its folders that is a link, a device or a named pipe; None if none is.

    No link is followed. A folder that does not exist holds nothing. One that lies more than ``levels`` deep is strange.
    """
    with contextlib.suppress(FileNotFoundError, NotADirectoryError):
        if folder.is_symlink() or not levels:
            return folder
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    if inner := find_strange(Path(entry.path), levels - 1):
                        return inner
                elif not entry.is_file(follow_symlinks=False):
                    return Path(entry.path)
    return None


MOST_JSON = 1 << 30
"""Bytes of the largest JSON file that is read; that of a run of 200 000 cells has half of it."""


def read_json(path: Path) -> dict[str, Any] | None:
    """Return the mapping in a JSON file; None where it is missing, damaged, too large, a link or no regular file."""
    try:
        with open(open_regular(path), encoding="utf-8") as file:
            content = json.loads(file.read()) if os.fstat(file.fileno()).st_size <= MOST_JSON else None
    except (FileNotFoundError, NotADirectoryError, ValueError, RecursionError):  # ValueError: not UTF-8, not JSON
        return None
    return content if isinstance(content, dict) else None


def write_arrays(path: Path, **arrays: NDArray[Any]) -> None:
    """Write arrays as a compressed ``.npz``, atomically."""
    import numpy as np

    def write(aside: BinaryIO) -> None:
        with zipfile.ZipFile(aside, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            for name, array in arrays.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                    np.lib.format.write_array(file, np.asanyarray(array), allow_pickle=False)

    write_aside(path, write)


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of an ``.npz`` by name. Pickled objects are refused.

    Raises
    ------
    BadInput
        When the file is damaged, or holds something else.
    OSError
        When it cannot be read.
    """
    import numpy as np

    with open_file(path) as file:
        try:
            with np.load(file, allow_pickle=False) as archive:  # noqa: TID251
                return {name: archive[name] for name in archive.files}
        except OSError:
            raise
        except Exception as error:  # a damaged header may end in almost any error, such as tokenize.TokenError
            raise BadInput(f"{path}: is damaged or no .npz file ({describe_error(error)})") from error
