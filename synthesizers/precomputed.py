"""Outputs that were made before, by any program."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from nrbench.errors import BadInput
from nrbench.imaging.convert import Image, match_channels
from nrbench.pictures.files import read_image
from nrbench.plugins.forms import Refused, Shape, Synthesis, Task
from nrbench.plugins.parameters import user_path
from nrbench.storage import find_path, read_table
from nrbench.streams import pixels_hash

_NAMES = ("sample", "output")
"""The columns of ``index.csv``."""


@dataclass(frozen=True)
class Precomputed:
    """Pictures from a folder, made before by any method, found by the sample's pixels and the output's size.

    Parameters
    ----------
    directory
        A folder that holds the outputs in one of two forms. Files named ``HASH-WIDTHxHEIGHT.png``, where HASH is
        :func:`nrbench.streams.pixels_hash` of the sample (if the file is missing, the refusal gives its name). Or files
        of any names and a table ``index.csv`` with the columns ``sample,output``: one row for each pair of pictures,
        paths relative to the folder.
    """

    directory: str

    uses_lattice: ClassVar[bool] = False
    version: ClassVar[str] = "1"

    def synthesize(self, task: Task) -> Synthesis:
        """Return the picture that was made from this sample at this size.

        Raises
        ------
        Refused
            When there is none.
        BadInput
            When there is no such folder, or its table is malformed.
        """
        folder = self._folder()
        named = folder / name_for(task.sample, task.shape)
        if named.exists():
            return Synthesis(match_channels(read_image(named), task.sample))
        for output in _listed(folder, task.sample):
            if output.shape[:2] == task.shape:
                return Synthesis(match_channels(output, task.sample))
        raise Refused(f"no {named}, and no row of index.csv with this sample and an output of that size")

    def fingerprint(self) -> str:
        """Return a hash of the folder's files (names, sizes, times): a changed folder makes another method."""
        folder = self._folder()
        files = [(str(path.relative_to(folder)), path.stat()) for path in sorted(folder.rglob("*")) if path.is_file()]
        listed = repr([(name, stat.st_size, stat.st_mtime_ns) for name, stat in files])
        return hashlib.blake2b(listed.encode(), digest_size=8).hexdigest()

    def _folder(self) -> Path:
        folder = user_path(self.directory).resolve()
        if not folder.is_dir():
            raise BadInput(
                f"precomputed: directory {self.directory!r} is no folder; give the one that holds the outputs"
            )
        return folder


def name_for(sample: Image, shape: Shape) -> str:
    """Return the file name of an output of ``shape`` made from ``sample``."""
    return f"{pixels_hash(sample)}-{shape[1]}x{shape[0]}.png"


def _listed(folder: Path, sample: Image) -> Iterator[Image]:
    """Yield the outputs that ``index.csv`` lists for a sample."""
    index = folder / "index.csv"
    if not index.exists():
        return
    wanted = pixels_hash(sample)
    columns, rows = read_table(index, ",".join(_NAMES))
    if not set(_NAMES) <= set(columns):
        raise BadInput(f"{index}: columns {columns}; its first line must be sample,output")
    for line, row in rows:
        if not (row["sample"] and row["output"]):
            raise BadInput(f"{index} line {line}: has an empty field; name a sample and an output")
        paths = [_inside(folder, row[name], f"{index} line {line}") for name in _NAMES]
        if pixels_hash(read_image(paths[0])) == wanted:
            yield read_image(paths[1])


def _inside(folder: Path, name: str, where: str) -> Path:
    """Return the path of a picture; raise BadInput if it is not in the folder, which may come from a stranger."""
    path = find_path(folder / name.replace("\0", "")).resolve()  # no name of a file has a null character
    if not path.is_relative_to(folder):
        raise BadInput(f"{where}: {name!r} is not in {folder}; put the picture there and give its path from there")
    return path
