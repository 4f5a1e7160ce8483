"""Write files atomically (under another name, then renamed), read them, and find those that users name."""

from __future__ import annotations

import atexit
import contextlib
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
from typing import TYPE_CHECKING, Any

from nrbench.errors import BadInput

# numpy is imported by the functions that hold arrays: a list of plugins needs none.
if TYPE_CHECKING:
    from numpy.typing import NDArray


def write_aside(path: Path, write: Callable[[Path], object]) -> None:
    """Call ``write`` with a temporary path beside ``path``, then rename that file: no reader sees a part of it.

    The temporary name is random, so that no link can wait there.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = path.with_name(f".{path.stem[:80]}-{uuid.uuid4().hex}{path.suffix}")
    try:
        write(aside)
        aside.replace(path)
    except OSError as error:
        # A full disk names no file, and the temporary name means nothing to a user.
        if error.filename in (None, str(aside), aside):
            error.filename = str(path)
        raise
    finally:
        aside.unlink(missing_ok=True)


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
    write_aside(path, lambda aside: aside.write_bytes(content))


def write_text(path: Path, text: str) -> None:
    """Write text as UTF-8, atomically. What UTF-8 cannot hold, such as half of a surrogate pair, is written escaped."""
    write_bytes(path, text.encode("utf-8", "backslashreplace"))


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

            file = stack.enter_context((folder / _HELD).open("a"))
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            free = True
        except (ImportError, OSError):
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
    text = json.dumps(content, indent=1, allow_nan=False, default=_plain) + "\n"

    def write(aside: Path) -> None:
        with aside.open("w", encoding="utf-8") as file:
            file.write(text)
            if durable:
                file.flush()
                os.fsync(file.fileno())

    write_aside(path, write)


def _plain(value: Any) -> Any:
    import numpy as np

    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be written as JSON")


NO_LINK = "is a link or no regular file; remove it (nrbench follows no links inside a run)"
"""What is said of a path inside a run that is not opened."""


def open_regular(path: Path, flags: int = os.O_RDONLY) -> int:
    """Open a regular file, follow no link at its name, and return its descriptor.

    Raises
    ------
    BadInput
        When there is a link, a folder, a device or a named pipe at the path.
    OSError
        When the file cannot be opened.
    """
    no_link, no_wait = getattr(os, "O_NOFOLLOW", 0), getattr(os, "O_NONBLOCK", 0)
    if not path.is_symlink():
        descriptor = os.open(path, flags | no_link | no_wait, 0o644)
        if stat.S_ISREG(os.fstat(descriptor).st_mode):
            return descriptor
        os.close(descriptor)
    raise BadInput(f"{path}: {NO_LINK}")


def find_strange(folder: Path) -> Path | None:
    """Return the first entry of a folder and of its folders that is a link, a device or a named pipe; None if none is.

    No link is followed. A folder that does not exist holds nothing.
    """
    with contextlib.suppress(FileNotFoundError, NotADirectoryError):
        if folder.is_symlink():
            return folder
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    if inner := find_strange(Path(entry.path)):
                        return inner
                elif not entry.is_file(follow_symlinks=False):
                    return Path(entry.path)
    return None


def read_json(path: Path) -> dict[str, Any] | None:
    """Return the mapping in a JSON file; None where it is missing, incomplete, damaged, a link or no regular file."""
    try:
        with open(open_regular(path), encoding="utf-8") as file:
            content = json.loads(file.read())
    except (FileNotFoundError, IsADirectoryError, ValueError, RecursionError):  # ValueError: not UTF-8, not JSON
        return None
    return content if isinstance(content, dict) else None


def write_arrays(path: Path, **arrays: NDArray[Any]) -> None:
    """Write arrays as a compressed ``.npz``, atomically."""
    import numpy as np

    def write(aside: Path) -> None:
        with zipfile.ZipFile(aside, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            for name, array in arrays.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                    np.lib.format.write_array(file, np.asanyarray(array), allow_pickle=False)

    write_aside(path, write)


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of an ``.npz`` by name. Pickled objects are refused."""
    import numpy as np

    with np.load(path, allow_pickle=False) as archive:  # noqa: TID251
        return {name: archive[name] for name in archive.files}
