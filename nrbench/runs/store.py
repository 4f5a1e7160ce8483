"""The run directory: one file, one writer, written aside and renamed."""

from __future__ import annotations

import json
import shutil
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import BadInput

RUN_FILE = "run.json"


def write_aside(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` fill a file beside ``path``, then rename it: readers see the old file or the whole new one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = path.with_name(f".{path.stem}-{uuid.uuid4().hex[:8]}{path.suffix}")
    try:
        write(aside)
        aside.replace(path)
    finally:
        aside.unlink(missing_ok=True)


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a mapping as JSON, atomically; NaN is refused (None says "not known")."""
    text = json.dumps(content, indent=1, allow_nan=False, default=_plain) + "\n"
    write_aside(path, lambda aside: aside.write_text(text, "utf-8"))


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be written as JSON")


def read_json(path: Path) -> dict[str, Any] | None:
    """Return the mapping in a JSON file; None where there is no such file, or not a whole one."""
    try:
        content = json.loads(path.read_text("utf-8"))
    except (FileNotFoundError, json.JSONDecodeError):
        return None
    return content if isinstance(content, dict) else None


def write_arrays(path: Path, **arrays: NDArray[Any]) -> None:
    """Write arrays as a compressed ``.npz``, atomically."""
    write_aside(path, lambda aside: np.savez_compressed(aside, **arrays))  # type: ignore[arg-type]


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of an ``.npz`` by name; nothing in it is ever unpickled."""
    with np.load(path, allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}


@dataclass(frozen=True)
class CellFolder:
    """One cell on disk.

    Parameters
    ----------
    path
        The folder, named by the cell's key.
    """

    path: Path

    @property
    def cell_file(self) -> Path:
        """What was asked."""
        return self.path / "cell.json"

    @property
    def result_file(self) -> Path:
        """How the synthesis ended; once it is there, the synthesis is never repeated."""
        return self.path / "result.json"

    @property
    def sample(self) -> Path:
        """The sample's pixels."""
        return self.path / "sample.png"

    @property
    def again(self) -> Path:
        """For a picture and a reference method: the region that the sample does not touch."""
        return self.path / "again.png"

    @property
    def output(self) -> Path:
        """The output's pixels."""
        return self.path / "output.png"

    @property
    def source(self) -> Path:
        """The source map, array ``source``."""
        return self.path / "source.npz"

    @property
    def extras(self) -> Path:
        """Folder of the method's extras."""
        return self.path / "extras"

    @property
    def scores(self) -> Path:
        """Folder of the scores, one file a metric, named by the metric and its key."""
        return self.path / "scores"

    @property
    def log(self) -> Path:
        """What the method and the metrics printed, and tracebacks."""
        return self.path / "log.txt"

    def result(self) -> dict[str, Any] | None:
        """Return how the synthesis ended, or None while it has not."""
        return read_json(self.result_file)

    def clear(self) -> None:
        """Remove what an interrupted or failed attempt left."""
        shutil.rmtree(self.path, ignore_errors=True)

    def log_tail(self, lines: int = 12) -> str:
        """Return the log's last lines."""
        try:
            return "\n".join(self.log.read_text("utf-8", "replace").splitlines()[-lines:])
        except FileNotFoundError:
            return ""


@dataclass(frozen=True)
class RunDirectory:
    """The directory of a run.

    Parameters
    ----------
    root
        Its path.
    """

    root: Path

    @property
    def cells(self) -> Path:
        """Folder of the cells."""
        return self.root / "cells"

    @property
    def lattices(self) -> Path:
        """Folder of the lattices that were detected once a texture."""
        return self.root / "lattices"

    @property
    def tables(self) -> Path:
        """Folder of the tables."""
        return self.root / "tables"

    @property
    def report(self) -> Path:
        """Folder of the report."""
        return self.root / "report"

    def cell(self, key: str) -> CellFolder:
        """Return the folder of the cell with this key."""
        return CellFolder(self.cells / key)

    def lattice(self, key: str) -> CellFolder:
        """Return the folder of the detection with this key."""
        return CellFolder(self.lattices / key)

    def info(self) -> dict[str, Any]:
        """Return what ``run.json`` holds.

        Raises
        ------
        BadInput
            When the directory is no run.
        """
        content = read_json(self.root / RUN_FILE)
        if content is None or not {"suite", "cells"} <= set(content):
            raise BadInput(
                f"{self.root}: is no run (it has no {RUN_FILE}); pass the directory that `nrbench run` printed"
            )
        return content

    def claim(self) -> None:
        """Make the directory, or make sure that what is there is a run.

        Raises
        ------
        BadInput
            When the path is a file, or a directory with something else in it.
        """
        if self.root.exists() and not self.root.is_dir():
            raise BadInput(f"{self.root}: is a file; pass another --out")
        strangers = self.root.is_dir() and any(self.root.iterdir()) and not (self.root / RUN_FILE).is_file()
        if strangers and not self.cells.is_dir():
            raise BadInput(f"{self.root}: holds something that is no run; pass an empty or new directory as --out")
        self.cells.mkdir(parents=True, exist_ok=True)
