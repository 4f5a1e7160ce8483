"""Photographs and other pictures from files."""

from __future__ import annotations

import os
import re
import unicodedata
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from nrbench.errors import BadInput, require
from nrbench.imaging.masks import MaskedImage
from nrbench.lattice.geometry import Lattice, Vector
from nrbench.lattice.vertices import fit_lattice
from nrbench.pictures.files import list_pictures, read_mask, read_masked, read_shape
from nrbench.pictures.truth import KNOWN_FILE, read_known, read_truth, read_vertices, vertices_file
from nrbench.plugins.forms import Region, Shape, Texture
from nrbench.storage import find_path

_ROW = ("family", "description", "figure", "departure", "level", "size", "recipe")
"""The keys of a suite's row that are read from ``truth.json``."""
OUTPUT_SCALE = 2
"""Least ratio of the sides of an output to those of its sample."""
OUTPUT_TILES = 6
"""Least number of tiles along each side of an output. The verdict on regularity then has 5 x 5 windows of two tiles."""
SAMPLE_TILES = 4
"""Least number of tiles along each side of a sample that leaves a region for the oracle. Each half of the sample then
contains a window of two tiles, which the verdict compares with the mean tile of the other half."""
SAMPLE_SIDE = 128
"""Least side, px, of such a sample if the lattice is not known."""
_LARGEST, _LARGEST_TILES = 512, 8
"""Largest side of such a sample: in px, or in tiles if that is more. It limits the time of a run."""
_LARGEST_OUTPUT = 16384
_LONGEST_NAME = 120


@dataclass(frozen=True)
class Images:
    """A picture from a file, such as a photograph. A sample and a fresh draw are random crops that do not touch.

    Parameters
    ----------
    path
        The file, of any kind that :func:`~nrbench.read_image` reads.
    t1, t2
        Generating vectors (x, y) of the picture's lattice in px; both or neither.
    origin
        A lattice point (x, y) of the picture in px.
    vertices
        A file of the vertices of the picture's lattice, see :func:`~nrbench.pictures.truth.read_vertices`.
    mask
        A picture of its size, in which white counts, and black is left out; transparent pixels are left out, too.
    """

    path: Path
    t1: Vector | None = None
    t2: Vector | None = None
    origin: Vector = (0.0, 0.0)
    vertices: Path | None = None
    mask: Path | None = None

    procedural: ClassVar[bool] = False
    version: ClassVar[str] = "1"

    def __post_init__(self) -> None:
        if (self.t1 is None) != (self.t2 is None):
            raise BadInput(f"picture {self.path}: has only one generating vector; give both t1 and t2, or neither")
        self._lattice((0, 0, 0, 0))

    def render(self, shape: Shape, rng: np.random.Generator) -> Texture:
        """Return a random crop of ``shape`` at a border of the picture; of a smaller picture, return all.

        A crop at a border leaves the widest possible strip beside it, from which :meth:`again` cuts. The border is
        drawn at random. If only two opposite borders leave a strip with room for twice the crop, it is one of these.

        Raises
        ------
        BadInput
            When the picture cannot be read, ``shape`` is empty, or no pixel of the crop counts.
        """
        require(min(shape) >= 1, f"shape {shape[1]}x{shape[0]} px has no pixels; give at least 1 a side")
        masked = self._read()
        height, width = masked.image.shape[:2]
        shape = min(shape[0], height), min(shape[1], width)
        return self._cut(masked, _region_corner((height, width), shape, rng), shape)

    def again(self, texture: Texture, shape: Shape, rng: np.random.Generator) -> Texture | None:
        """Return a random region of exactly ``shape`` that does not touch ``texture.region``; None if none fits."""
        masked = self._read()
        if texture.region is None:
            raise BadInput(f"picture {self.path}: the texture has no region; pass one that render returned")
        height, width = masked.image.shape[:2]
        corner = _free_corner((height, width), shape, texture.region, rng)
        return None if corner is None else self._cut(masked, corner, shape)

    @staticmethod
    def directory_rows(directory: str | Path) -> list[dict[str, Any]]:
        """Return a suite row (``name``, ``parameters``, sizes) for each picture of a directory, sorted by name.

        :func:`plan_sizes` gives the sizes of sample and output. No pixels are read. Hidden files and the contact sheet
        of ``nrbench render`` are left out.

        The directory may have a ``truth.csv`` with generating vectors: columns ``file,t1x,t1y,t2x,t2y`` and optionally
        ``originx,originy``; others are ignored. A picture without a line, or with empty numbers, has no known lattice.
        Beside a picture there may be a file of its vertices, :func:`~nrbench.pictures.truth.vertices_file`. Their mean
        lattice is that of the picture if ``truth.csv`` has none.
        It may have a ``truth.json`` by ``nrbench render``, which holds how each picture was drawn.

        Raises
        ------
        BadInput
            When there is no picture, or a truth file is malformed (the message names the line).
        """
        folder = Path(directory)
        sheet, rendered = read_rendered(folder)
        pictures = [path for path in list_pictures(folder) if path.name != sheet]
        if not pictures:
            raise BadInput(f"directory {folder}: has no picture; put PNG, JPEG or TIFF files into it")
        table = read_truth(folder)
        truth = {path.name: _read_known(path, table.get(path.name, {})) for path in pictures}
        return [
            {
                "name": name,
                "family": "picture",
                "parameters": {"path": str(path), **truth.get(path.name, {})},
                **_row_sizes(path, truth.get(path.name, {}), rendered.get(path.name, {})),
                **rendered.get(path.name, {}),
            }
            for name, path in _named(pictures)
        ]

    def _read(self) -> MaskedImage:
        files = [Path(self.path), *([Path(self.mask)] if self.mask is not None else ())]
        there = all(file.is_file() for file in files)
        return _cached(*files, written=tuple(file.stat().st_mtime_ns for file in files)) if there else _read(*files)

    def _lattice(self, region: Region) -> Lattice | None:
        origin = (self.origin[0] - region[0], self.origin[1] - region[1])
        return None if self.t1 is None or self.t2 is None else Lattice(self.t1, self.t2, origin)

    def _cut(self, masked: MaskedImage, corner: tuple[int, int], shape: Shape) -> Texture:
        x0, y0, x1, y1 = region = (*corner, corner[0] + shape[1], corner[1] + shape[0])
        lattice, name = self._lattice(region), Path(self.path).stem
        lattices = () if lattice is None else (lattice,)
        image, counted = masked.image, None if masked.known is None else masked.known[y0:y1, x0:x1].copy()
        none = f"picture {self.path}: no pixel of the crop from ({x0}, {y0}) counts; take a larger one"
        require(counted is None or bool(counted.any()), none)
        known = () if self.vertices is None else read_vertices(Path(self.vertices), image.shape[:2])
        moved = (vertex._replace(x=vertex.x - x0, y=vertex.y - y0) for vertex in known)
        size = x1 - x0 - 0.5, y1 - y0 - 0.5
        vertices = tuple(each for each in moved if -0.5 <= each.x < size[0] and -0.5 <= each.y < size[1])
        cut = image[y0:y1, x0:x1].copy()
        shown: dict[str, Any] = {"vertices": vertices, "known": None if counted is None or counted.all() else counted}
        return Texture(cut, lattice, lattices, name, family="picture", region=region, **shown)


def plan_sizes(picture: Shape, lattice: Lattice | None = None) -> tuple[Shape, Shape]:
    """Return the shapes of the sample and of the output for a picture.

    The output is :data:`OUTPUT_SCALE` times as high and as wide as the sample, and contains at least
    :data:`OUTPUT_TILES` tiles along each side. The sample is as large as possible under the condition that the picture
    has room for the sample and for a region of the output's shape, side by side or one above the other. If such a
    sample would contain too few tiles, the sample is the whole picture, and there is no region for the oracle.

    Parameters
    ----------
    picture
        Height and width of the picture, px.
    lattice
        Its lattice; None if it is not known.

    Returns
    -------
    sample, output
        Heights and widths, px.

    Examples
    --------
    >>> plan_sizes((512, 512))
    ((170, 256), (340, 512))
    >>> plan_sizes((512, 512), Lattice((64, 0), (0, 64)))
    ((512, 512), (1024, 1024))
    """
    sides = np.array(picture)
    # Height and width of an upright box about as large as one cell: sqrt(t1^2 + t2^2) along each axis.
    tile = np.zeros(2) if lattice is None else np.sqrt((lattice.canonical().matrix ** 2).sum(0))[::-1]
    least = SAMPLE_TILES * tile if lattice is not None else np.full(2, SAMPLE_SIDE)
    wanted = np.ceil(OUTPUT_TILES * tile)
    most = np.maximum(_LARGEST, np.ceil(_LARGEST_TILES * tile))
    samples = []
    for axis in (0, 1):
        sample = np.minimum(sides // OUTPUT_SCALE, most)
        sample[axis] = min(sides[axis] // (OUTPUT_SCALE + 1), sides[axis] - wanted[axis], most[axis])
        if (sample >= least).all() and (wanted <= sides).all():
            samples.append(sample)
    sample = max(samples, key=lambda sides: float((sides / np.maximum(tile, 1)).min()), default=sides)
    output = np.minimum(np.maximum(OUTPUT_SCALE * sample, wanted), _LARGEST_OUTPUT)
    return (int(sample[0]), int(sample[1])), (int(output[0]), int(output[1]))


def _read_known(path: Path, known: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entry of a picture in ``truth.csv``, with its file of vertices if it has one."""
    file = vertices_file(path)
    if not file.is_file():
        return dict(known)
    mean = {} if "t1" in known else fit_lattice(read_vertices(file, read_shape(path))).as_dict()
    return {**mean, **known, "vertices": str(file)}


def _row_sizes(path: Path, truth: Mapping[str, Any], rendered: Mapping[str, Any]) -> dict[str, str]:
    """Return the sizes in the row of a picture; none if the file cannot be read, which is reported when it is drawn."""
    lattice = Lattice(truth["t1"], truth["t2"]) if "t1" in truth else None
    try:
        shape = read_shape(path)
        sample, output = plan_sizes(shape, lattice)
    except BadInput:
        return {}
    if "sample" in rendered:
        scaled = OUTPUT_SCALE * np.array(shape)
        sample, output = shape, (int(scaled[0]), int(scaled[1]))
    sizes = {"sample": sample, "size": output}
    return {name: f"{width}x{height}" for name, (height, width) in sizes.items()}


@lru_cache(maxsize=2)
def _cached(*files: Path, written: tuple[int, ...]) -> MaskedImage:
    """Read a picture, and its mask if there is one, once for all regions that are cut from it."""
    masked = _read(*files)
    masked.image.setflags(write=False)
    return masked


def _read(path: Path, mask: Path | None = None) -> MaskedImage:
    masked = read_masked(path)
    return masked if mask is None else masked.without(~read_mask(mask, masked.image.shape[:2]), f"mask {mask}")


def _region_corner(picture: Shape, shape: Shape, rng: np.random.Generator) -> tuple[int, int]:
    """Draw the corner (x, y) of a rectangle of ``shape`` at a border of the picture; see :meth:`Images.render`."""
    room = np.array([picture[1] - shape[1], picture[0] - shape[0]])
    corner = rng.integers(room + 1)
    side, ratio = int(rng.integers(2)), room / (shape[1], shape[0])
    if ratio[side] < OUTPUT_SCALE <= ratio[1 - side]:
        side = 1 - side
    corner[side] = room[side] * rng.integers(2)
    return int(corner[0]), int(corner[1])


def _free_corner(picture: Shape, shape: Shape, region: Region, rng: np.random.Generator) -> tuple[int, int] | None:
    """Draw the corner (x, y) of a rectangle of ``shape`` in the picture that does not touch ``region``, uniformly."""
    rows, columns = (whole - part + 1 for whole, part in zip(picture, shape, strict=True))
    if rows < 1 or columns < 1:
        return None
    x0, x1 = max(0, region[0] - shape[1] + 1), min(columns, region[2])
    y0, y1 = max(0, region[1] - shape[0] + 1), min(rows, region[3])
    free = np.full(rows, columns)
    free[y0:y1] -= max(0, x1 - x0)
    ends = np.cumsum(free)
    if ends[-1] == 0:
        return None
    k = int(rng.integers(ends[-1]))
    y = int(np.searchsorted(ends, k, side="right"))
    x = k - int(ends[y] - free[y])
    return (x + x1 - x0 if y0 <= y < y1 and x >= x0 else x), y


def _named(pictures: list[Path]) -> Iterator[tuple[str, Path]]:
    """Yield the name and path of each picture. The name lacks the ending unless two pictures would share it.

    Backslashes and control characters, which the name of a texture cannot have, become underscores; so do bytes that
    are no UTF-8, and characters that reverse the direction of the text after them. Accented letters are one character
    each (NFC). A long name is cut short.
    """
    stems = Counter(_plain(path.stem) for path in pictures)
    return ((_plain(path.stem if stems[_plain(path.stem)] == 1 else path.name), path) for path in pictures)


def _plain(name: str) -> str:
    name = unicodedata.normalize("NFC", name)
    plain = re.sub(r"[\\\x00-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]", "_", name)
    if len(plain) > _LONGEST_NAME or (plain != name and set(plain) <= {"_", "."}):
        plain = f"{plain[:_LONGEST_NAME]}-{zlib.crc32(os.fsencode(name)):08x}"
    return plain


def read_rendered(folder: Path) -> tuple[str, dict[str, dict[str, Any]]]:
    """Read the ``truth.json`` by ``nrbench render``: the contact sheet's name, and a suite row for each picture.

    Parameters
    ----------
    folder
        A directory. Without such a ``truth.json`` in it the result is empty.

    Raises
    ------
    BadInput
        When ``truth.json`` is no JSON, or the entry of a picture is no table.
    """
    path = folder / KNOWN_FILE
    content = read_known(folder, "render the textures again, or delete it")
    textures = content.get("textures") if isinstance(content, dict) else None
    if not isinstance(textures, dict):
        return "", {}
    rows = {}
    for name, entry in textures.items():
        if not isinstance(entry, dict):
            raise BadInput(f"{path}: picture {name!r}: {entry!r} is no table; render the textures again, or delete it")
        row = {key: entry[key] for key in _ROW if entry.get(key) not in (None, "")}
        shape = row["recipe"].get("shape") if isinstance(row.get("recipe"), dict) else None
        row |= {"sample": shape} if shape else {}  # the whole picture is the sample
        rows[find_path(folder / name).name] = row
    return str(content.get("sheet", "")), rows
