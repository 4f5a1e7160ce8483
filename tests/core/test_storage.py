"""Temporary folders."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import BinaryIO

import pytest

from nrbench.errors import BadInput
from nrbench.storage import outside_user_folder, temporary_folder, write_aside


@pytest.mark.skipif(os.name == "nt", reason="has no such locks")
def test_folders_of_killed_processes_are_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The next temporary folder removes those that nobody holds; those of living processes and of others stay."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    program = (
        "import os, tempfile\nfrom nrbench.storage import temporary_folder\n"
        f"tempfile.tempdir = {str(tmp_path)!r}\nwith temporary_folder() as folder:\n    os._exit(9)\n"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 9
    (left,) = tmp_path.iterdir()
    (tmp_path / "nrbench-mine").mkdir()
    os.mkfifo(tmp_path / "nrbench-mine" / ".held")  # does not stop it
    os.utime(tmp_path / "nrbench-mine" / ".held", (0, 0))
    with temporary_folder() as living:
        assert left.exists()  # it is younger than a minute
        for folder in (left, living):
            os.utime(folder / ".held", (0, 0))
        with temporary_folder() as next_one:
            assert {path.name for path in tmp_path.iterdir()} == {"nrbench-mine", living.name, next_one.name}


LITTER = """
import os
from pathlib import Path
from typing import BinaryIO
from nrbench.storage import remove_folder

if hasattr(os, "setuid") and os.getuid() == 0:
    os.setuid(65534)  # the modes of folders mean nothing to root
mine, rests = Path("mine"), Path("rests")
(mine / "folder").mkdir(parents=True)
(mine / "folder").chmod(0o755)
(mine / "file").touch()
(mine / "file").chmod(0o644)
locked, closed = rests / "locked", rests / "closed"
for folder in (locked, closed):
    folder.mkdir(parents=True)
    (folder / "file").touch()
for name in ("file", "folder"):
    (locked / f"to {name}").symlink_to(Path("../..") / mine / name)
locked.chmod(0o500)
closed.chmod(0)
start = os.open(".", os.O_RDONLY)
os.chdir(rests)
for _ in range(1200):  # more than Python's stack and the length of a path hold
    os.mkdir("deep")
    os.chdir("deep")
os.fchdir(start)
Path("link").symlink_to(mine)
for name in ("rests", "link", "missing"):
    remove_folder(Path(name))
print(sorted(path.name for path in Path().iterdir()), *sorted(path.name for path in mine.iterdir()))
print(*(oct((mine / name).stat().st_mode) for name in ("file", "folder")))
"""


@pytest.mark.skipif(os.name == "nt", reason="has no such modes")
def test_a_folder_is_removed_whatever_it_holds(tmp_path: Path) -> None:
    """Folders that are closed or nested deeply are removed, links as such: what they point to does not change."""
    tmp_path.chmod(0o777)
    done = subprocess.run([sys.executable, "-c", LITTER], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stdout.splitlines() == ["['mine'] file folder", "0o100644 0o40755"], done.stderr


def test_a_folder_that_is_gone_is_not_left(tmp_path: Path) -> None:
    """Where the working directory was removed, a plugin is imported there; later relative paths lead nowhere else."""
    tmp_path.rmdir()
    with outside_user_folder():
        pass
    with pytest.raises(FileNotFoundError):
        Path.cwd()


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


PLUGIN = """
import helper, sys
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO
from nrbench.storage import user_path

Path("litter.txt").touch()
assert user_path("mine.py").is_file()
sys.path.append("added")

@dataclass(frozen=True)
class Mine:
    "A method."
    def synthesize(self, task): ...
"""
IMPORTING = """
import os, sys, threading
from nrbench import plugins

folder = os.getcwd()
if "thread" in sys.argv:
    threading.Thread(target=threading.Event().wait, daemon=True).start()
sys.path[:0] = ["", "lib", "__hook__"]
before = list(sys.path)
plugins.add_file("mine.py")
assert plugins.find("synthesizers", "mine").cls is not None
assert sys.path == [*before, "added"], sys.path
assert os.getcwd() == folder
print(sorted(os.listdir()))
"""


def test_an_import_leaves_nothing_in_the_users_folder(tmp_path: Path) -> None:
    """A plugin is imported in a temporary folder, with the modules that relative entries of the path lead to.

    With several threads, all of which have one working directory, it is imported there.
    """
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib" / "helper.py").touch()
    (tmp_path / "mine.py").write_text(PLUGIN)

    def listed(*words: str) -> str:
        command = [sys.executable, "-B", "-c", IMPORTING, *words]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True).stdout.strip()

    assert listed() == "['lib', 'mine.py']"
    assert listed("thread") == "['lib', 'litter.txt', 'mine.py']"
