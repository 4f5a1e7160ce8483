"""Files are written whole or not at all, and errors of a disk name them."""

import tempfile
from pathlib import Path
from typing import BinaryIO

import pytest

from nrbench.errors import BadInput
from nrbench.storage import temporary_folder, write_aside


def test_no_place_for_temporary_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no temporary folder can be made, the error says what to set."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    with pytest.raises(BadInput, match=r"missing.*; set TMPDIR to a folder"), temporary_folder():
        pass


def test_an_error_of_a_disk_names_the_file(tmp_path: Path) -> None:
    """An error that names no file, as that of a full disk, gets the file that was to be written."""

    def fill(file: BinaryIO) -> None:
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match=r"No space left on device: .*table.csv"):
        write_aside(tmp_path / "table.csv", fill)


def test_an_error_names_the_file_that_was_to_be_written(tmp_path: Path) -> None:
    """Where the new file cannot take its name, the error names the file, not the name beside it."""
    (tmp_path / "target" / "full").mkdir(parents=True)
    with pytest.raises(OSError) as caught:
        write_aside(tmp_path / "target", lambda file: file.write(b"x"))
    assert caught.value.filename == str(tmp_path / "target")
    assert [one.name for one in tmp_path.iterdir()] == ["target"]
