"""Prepare the pictures of the page: small WebP copies, overlays, and the files for zooming."""

from __future__ import annotations

import base64
import hashlib
import io
import os
import shutil
import zipfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache, lru_cache
from pathlib import Path

import numpy as np
import PIL.Image
from numpy.typing import NDArray

from nrbench.storage import write_aside, write_bytes

from ..plots.marks import find_marks, worst_place

SMALLEST, LARGEST = 192, 384
"""Widths on the page, px: smaller pictures are magnified, larger ones are reduced."""
CROP = 96
"""Side of the magnified part of a weak output, px."""
FOLDER = "pictures"
"""The folder beside the page with the small copies and the files for zooming."""
EMBEDDED = 7_000_000
"""Most bytes of small copies that a page embeds; a page with more of them loads all from :data:`FOLDER`."""
_RECIPE = "3"
"""Part of every name in the folder; raise it when the same file would give another picture."""
_QUALITY, _LAYER_QUALITY, _MAP_QUALITY = 68, 50, 30
_SHADE = 190
"""Opacity of the marks of an overlay, of 255."""
_CORNERS = np.array([[[0, 114, 178], [0, 158, 115]], [[213, 94, 0], [240, 228, 66]]], np.float64)
"""Colors of the corners of the sample in a source map, from the palette of Okabe and Ito."""
_UNREADABLE = (
    *(OSError, SyntaxError, ValueError, EOFError, KeyError, PIL.Image.DecompressionBombError),
    *(zipfile.BadZipFile, zlib.error),
)

Pixels = NDArray[np.uint8]


@dataclass(frozen=True)
class PagePicture:
    """A picture as the page shows it.

    Parameters
    ----------
    name
        Name of the file in :data:`FOLDER` that the page embeds or loads.
    width, height
        Size of the picture in px.
    full
        Address of the file of all pixels, relative to the page; empty if ``name`` has all pixels.
    """

    name: str
    width: int
    height: int
    full: str = ""

    @property
    def scale(self) -> float:
        """Page pixels for each pixel: a whole number for small pictures, which avoids moire; below 1 for large ones."""
        if self.width < SMALLEST:
            return float(-(-SMALLEST // self.width))
        return min(1.0, LARGEST / self.width)


@dataclass(frozen=True)
class PictureStore:
    """The pictures of a page.

    Whatever is made of a file of the run is kept in :data:`FOLDER` beside the page, under a name that hashes the bytes
    of the file. A second report makes only the pictures of cells that changed.

    Parameters
    ----------
    directory
        Folder of the page.
    single_file
        Whether the page embeds all pixels without loss, instead of small copies beside files for zooming.
    """

    directory: Path
    single_file: bool = False
    _used: set[str] = field(default_factory=set)
    _made: dict[tuple[Path | None, ...], PagePicture | None] = field(default_factory=dict)
    _known: dict[Path, tuple[str, tuple[int, int]]] = field(default_factory=dict)

    def _once(self, make: Callable[..., PagePicture | None], *paths: Path | None) -> PagePicture | None:
        """Return the picture that is made of some files, which is made once; None if one cannot be read."""
        if paths not in self._made:
            try:
                self._made[paths] = None if None in paths else make(*paths)
            except _UNREADABLE:
                self._made[paths] = None
        return self._made[paths]

    def load(self, path: Path | None) -> PagePicture | None:
        """Return the picture in a PNG file; None if there is no readable picture."""
        return self._once(self._load, path)

    def _load(self, path: Path) -> PagePicture:
        digest, (width, height) = self._identify(path)
        if self.single_file or width <= 64:
            name = self._kept("lossless", [digest], lambda: _webp(_decode(path, digest), 30, lossless=True))
            return PagePicture(name, width, height)
        name = self._kept("small", [digest], lambda: _webp(_decode(path, digest), _QUALITY, effort=2))
        return PagePicture(name, width, height, f"{FOLDER}/{self._link(path, _name('full', digest))}")

    def _identify(self, path: Path) -> tuple[str, tuple[int, int]]:
        """Return the hash of a picture's file and its size (width, height); a picture is read once for all layers."""
        if path not in self._known:
            content = path.read_bytes()
            with PIL.Image.open(io.BytesIO(content)) as image:
                self._known[path] = _digest(content), image.size
        return self._known[path]

    def overlay(self, output: Path, layer: Path | None) -> PagePicture | None:
        """Return the marks of a metric's picture over an output, transparent elsewhere.

        Returns
        -------
        PagePicture or None
            None if there is no readable picture, or it has another size than the output: then it is no overlay.
        """
        return self._once(self._overlay, output, layer)

    def _overlay(self, output: Path, layer: Path) -> PagePicture | None:
        (digest, size), (below, base) = self._identify(layer), self._identify(output)
        if size != base:
            return None
        make = lambda: _webp(_marks(_pixels(layer), _decode(output, below)), _LAYER_QUALITY)  # noqa: E731
        return PagePicture(self._kept("overlay", [digest, below], make), *size)

    def source_map(self, output: Path, source: Path) -> PagePicture | None:
        """Return the map of the sample's places that the pixels of an output come from, by color; None without one."""
        return self._once(self._source_map, output, source)

    def _source_map(self, output: Path, source: Path) -> PagePicture:
        content = source.read_bytes()
        name = self._kept("source", [_digest(content)], lambda: _webp(_place_colors(_places(content)), _MAP_QUALITY))
        return PagePicture(name, *self._identify(output)[1])  # a source map has the size of its output

    def worst_crop(self, output: Path, layers: Sequence[Path]) -> PagePicture | None:
        """Return the square of an output with the most marks of defects, its middle without marks; None if unreadable.

        Parameters
        ----------
        output
            The output.
        layers
            Pictures of defects over the output; the first with any marks decides.
        """
        return self._once(lambda *_: self._worst_crop(output, layers), output, *layers, Path("worst"))

    def _worst_crop(self, output: Path, layers: Sequence[Path]) -> PagePicture:
        digest, size = self._identify(output)
        side = min(CROP, *size)
        digests = [digest, *(self._identify(layer)[0] for layer in layers)]
        name = self._kept("crop", digests, lambda: _webp(_crop(_decode(output, digest), layers, side), _QUALITY, 2))
        return PagePicture(name, side, side)

    def sweep(self) -> None:
        """Remove the files of pictures that the page no longer has."""
        folder = self.directory / FOLDER
        for file in folder.glob("*") if folder.is_dir() else ():
            if file.name not in self._used and file.suffix in (".webp", ".png"):
                file.unlink(missing_ok=True)

    def embeds(self) -> bool:
        """Return whether the page embeds the small copies of all pictures that were made so far."""
        files = (self.directory / FOLDER / name for name in sorted(self._used) if name.endswith(".webp"))
        return self.single_file or sum(file.stat().st_size for file in files) <= EMBEDDED

    def address(self, picture: PagePicture, embed: bool) -> str:
        """Return the value of ``src`` of a picture: its embedded bytes, or the address of its file."""
        if not embed:
            return f"{FOLDER}/{picture.name}"
        content = base64.b64encode((self.directory / FOLDER / picture.name).read_bytes())
        return f"data:image/webp;base64,{content.decode('ascii')}"

    def _kept(self, kind: str, digests: Sequence[str], make: Callable[[], bytes]) -> str:
        """Return the name of a WebP file of the folder, which is made if it is absent."""
        name = f"{_name(kind, *digests)}.webp"
        file = self.directory / FOLDER / name
        if not file.exists():
            content = make()
            file.parent.mkdir(parents=True, exist_ok=True)
            write_bytes(file, content)
        self._used.add(name)
        return name

    def _link(self, path: Path, name: str) -> str:
        """Put a file of the run into the folder, as a hard link where the disk can, and return its name there."""
        name = f"{name}.png"
        self._used.add(name)
        file = self.directory / FOLDER / name
        if not file.exists():
            file.parent.mkdir(parents=True, exist_ok=True)
            try:
                os.link(path, file)
            except OSError:
                write_aside(file, lambda aside: shutil.copyfile(path, aside))
        return name


def _digest(content: bytes) -> str:
    return hashlib.blake2b(content, digest_size=16).hexdigest()


def _name(kind: str, *digests: str) -> str:
    return hashlib.blake2s(" ".join([_RECIPE, kind, *digests]).encode(), digest_size=12).hexdigest()


@lru_cache(maxsize=4)
def _decode(path: Path, digest: str) -> Pixels:
    """Return the pixels of an output; its thumbnail and its layers need them one after another."""
    return _pixels(path)


def _pixels(path: Path) -> Pixels:
    with PIL.Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def _crop(output: Pixels, layers: Sequence[Path], side: int) -> Pixels:
    """Return the square of an output with the most marks of defects, or its middle."""
    middle = (output.shape[1] - side) // 2, (output.shape[0] - side) // 2
    x, y = worst_place(output, [_pixels(layer) for layer in layers], side) or middle
    return output[y : y + side, x : x + side]


def _webp(pixels: Pixels, quality: int, effort: int = 0, lossless: bool = False) -> bytes:
    """Return a picture as WebP, reduced to the size on the page unless it keeps all pixels."""
    image, file = PIL.Image.fromarray(pixels), io.BytesIO()
    if not lossless:
        image.thumbnail((LARGEST, 4 * LARGEST))
    image.save(file, "WEBP", lossless=lossless, quality=quality, method=effort)
    return file.getvalue()


def _marks(layer: Pixels, output: Pixels) -> Pixels:
    """Return a metric's picture with an alpha channel that hides what is gray or equal to the output."""
    marked = find_marks(layer, output)
    shown = np.empty((*marked.shape, 4), np.uint8)
    np.multiply(layer, marked[..., None], out=shown[..., :3])
    np.multiply(marked, np.uint8(_SHADE), out=shown[..., 3])
    return shown


def _places(content: bytes) -> NDArray[np.float32]:
    """Return the places (x, y) of a source map, ``(H, W, 2)``."""
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        return np.asarray(arrays["source"][..., :2], np.float32)


def _place_colors(places: NDArray[np.float32]) -> Pixels:
    """Return colors of places (x, y) in the sample, blended between the colors of the corners of the used region."""
    x, y = (np.rint(255 * _relative(places[..., axis])).astype(np.uint8) for axis in (0, 1))
    return _color_table()[y, x]


def _relative(values: NDArray[np.float32]) -> NDArray[np.float32]:
    known = np.isfinite(values)  # a method may leave the place of a pixel open
    low, high = (float(values[known].min()), float(values[known].max())) if known.any() else (0.0, 0.0)
    return np.where(known, (values - low) / max(high - low, 1e-9), 0.0)


@cache
def _color_table() -> Pixels:
    """Return 256 x 256 colors, blended between :data:`_CORNERS`."""
    x = np.linspace(0, 1, 256)[:, None]
    top, bottom = (left * (1 - x) + right * x for left, right in _CORNERS)
    colors: Pixels = np.rint(top * (1 - x[:, None]) + bottom * x[:, None]).astype(np.uint8)
    return colors
