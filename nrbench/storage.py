"""Write files atomically (under another name, then renamed), find them, and read them."""

from __future__ import annotations

import codecs
import contextlib
import csv
import io
import json
import os
import re
import shutil
import tempfile
import unicodedata
import uuid
import zipfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from nrbench.errors import BadInput, describe_error

# numpy is imported by the functions that hold arrays: a list of plugins needs none.
if TYPE_CHECKING:
    from numpy.typing import NDArray


def write_aside(path: Path, write: Callable[[BinaryIO], object], durable: bool = False) -> None:
    """Write a file under a temporary name, then rename it: no reader sees a part of it.

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
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = path.with_name(f".{path.stem[:80]}-{uuid.uuid4().hex}{path.suffix}")
    try:
        with aside.open("x+b") as file:
            write(file)
            if durable:
                file.flush()
                os.fsync(file.fileno())
        aside.replace(path)
    except OSError as error:
        # A full disk names no file, and the temporary name means nothing to a user.
        if error.filename in (None, str(aside)):
            error.filename = str(path)
        raise
    finally:
        aside.unlink(missing_ok=True)


def make_writable(folder: Path, remedy: str) -> None:
    """Make a folder if there is none, and write a file into it that is gone at once.

    Parameters
    ----------
    folder
        The folder.
    remedy
        What the user should do if that fails.

    Raises
    ------
    BadInput
        When it fails, whatever the rights of the folder are.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise BadInput(f"{folder}: cannot be written ({error.strerror}); {remedy}") from None


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


def remove(path: Path) -> None:
    """Remove a file or link, or a folder with all it holds, if there is one."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


@contextlib.contextmanager
def temporary_folder() -> Iterator[Path]:
    """Yield a temporary folder, and remove it afterwards.

    Raises
    ------
    BadInput
        When the system has no folder of temporary files that can be written to.
    """
    try:
        folder = tempfile.TemporaryDirectory(prefix="nrbench-", ignore_cleanup_errors=True)
    except OSError as error:
        raise BadInput(f"temporary files: {error}; set TMPDIR to a folder that can be written to") from error
    with folder as name:
        yield Path(name)


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


def read_json(path: Path) -> dict[str, Any] | None:
    """Return the mapping in a JSON file; None where the file is missing, damaged, or holds something else."""
    try:
        content = json.loads(path.read_bytes())
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError, ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None


def decode_text(content: bytes) -> str:
    """Return the text of a file as programs of a desktop save it: UTF-8 or UTF-16, with or without a mark."""
    wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    return content.decode("utf-16" if wide else "utf-16-le" if content[1:2] == b"\0" else "utf-8-sig")


def read_table(path: Path, header: str) -> tuple[list[str], list[tuple[int, dict[str, Any]]]]:
    """Return the columns of a CSV file, and the number and the texts of each line that is not empty.

    The file may be as a spreadsheet saves it in any country: with commas, semicolons or tabs between the fields, of
    which the first line has most; with a line ``sep=;`` before the columns; in UTF-8 or UTF-16. Spaces around the names
    of columns are left out. What a line has beyond its columns is a list under the key None.

    Parameters
    ----------
    path
        The file.
    header
        The columns that it should have, for the error.

    Raises
    ------
    BadInput
        When the file cannot be read as such a text.
    """
    try:
        lines = io.StringIO(decode_text(find_path(path).read_bytes()), newline="")
        first, before = lines.readline(), 0
        if named := re.fullmatch(r'"?sep=([,;\t])"?\s*', first, re.IGNORECASE):
            before = 1
        else:
            lines.seek(0)
        separator = named[1] if named else max(",;\t", key=first.count)
        reader = csv.DictReader(lines, restval="", delimiter=separator)
        fields = reader.fieldnames = [name.strip() for name in reader.fieldnames or ()]
        return fields, [(reader.line_num + before, row) for row in reader if any(row.values())]
    except (UnicodeDecodeError, csv.Error) as error:
        raise BadInput(f"{path}: is no CSV text ({error}); save it as CSV UTF-8 with the columns {header}") from None
    except OSError as error:
        raise BadInput(f"{path}: cannot be read ({error.strerror}); check the path") from error


def decimal_point(text: str) -> str:
    """Return a number with a point where spreadsheets of some countries write a decimal comma."""
    return text.strip().replace(",", ".").replace("\N{MINUS SIGN}", "-")


def find_path(path: Path) -> Path:
    """Return a path, or the one that exists and differs from it only in how accented letters are stored.

    ``é`` is one character (the form NFC) or an ``e`` and an accent (NFD). macOS and some archives store names in the
    second form, while keyboards and spreadsheets write the first one.
    """
    if str(path).isascii() or os.path.exists(path):  # noqa: PTH110 - it takes any text
        return path
    found = Path(path.anchor)
    for part in path.parts[1:] if path.anchor else path.parts:
        name = unicodedata.normalize("NFC", part)
        entries: list[str] = []
        if not os.path.exists(found / part):  # noqa: PTH110
            with contextlib.suppress(OSError, ValueError):
                entries = os.listdir(found)  # noqa: PTH208
        found /= next((entry for entry in entries if unicodedata.normalize("NFC", entry) == name), part)
    return found


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

    with path.open("rb") as file:
        try:
            with np.load(file, allow_pickle=False) as archive:  # noqa: TID251
                return {name: archive[name] for name in archive.files}
        except OSError:
            raise
        except Exception as error:  # a damaged header may end in almost any error, such as tokenize.TokenError
            raise BadInput(f"{path}: is damaged or no .npz file ({describe_error(error)})") from error
