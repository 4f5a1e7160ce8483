"""Pictures for a page: embedded in it, or linked where they would make it too heavy."""

from __future__ import annotations

import base64
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import PIL.Image

from nrbench.runs.records import CellRecord

_SMALLEST, _LARGEST = 192, 384


@dataclass(frozen=True)
class Picture:
    """A picture as a page shows it.

    Parameters
    ----------
    source
        What stands in ``src``: the pixels themselves, or a relative path.
    width, height
        Its size in px.
    """

    source: str
    width: int
    height: int

    @property
    def scale(self) -> float:
        """Page pixels a pixel: whole for small pictures, so that no moire arises; large ones are reduced to fit."""
        if self.width < _SMALLEST:
            return float(-(-_SMALLEST // self.width))
        return min(1.0, _LARGEST / self.width)


@dataclass(frozen=True)
class Pictures:
    """Where a page's pictures come from.

    Parameters
    ----------
    directory
        Where the page will lie.
    embedded
        Whether the pixels go into the page; otherwise they are linked by relative paths.
    """

    directory: Path
    embedded: bool

    @classmethod
    def of(cls, cells: Iterable[CellRecord], directory: Path, limit: float) -> Pictures:
        """Embed the pictures of all cells unless that takes more than ``limit`` bytes."""
        files = (file for record in cells for file in _files(record))
        size = sum(file.stat().st_size for file in files if file.is_file())
        return cls(directory, size * 4 / 3 <= limit)

    def picture(self, path: Path) -> Picture | None:
        """Return the picture in a PNG file; None where there is none that can be read."""
        try:
            with PIL.Image.open(path) as opened:
                width, height = opened.size
            return Picture(self._source(path), width, height)
        except (OSError, SyntaxError, PIL.Image.DecompressionBombError):
            return None

    def _source(self, path: Path) -> str:
        if self.embedded:
            return f"data:image/png;base64,{base64.b64encode(path.read_bytes()).decode('ascii')}"
        return quote(Path(os.path.relpath(path, self.directory)).as_posix())


def _files(record: CellRecord) -> list[Path]:
    return [record.folder / "sample.png", record.folder / "output.png", *record.pictures.values()]
