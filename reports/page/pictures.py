"""Prepare the pictures of reports: small WebP copies, overlays, files for zooming, and the worst place of an output."""

from __future__ import annotations

import base64
import hashlib
import io
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, wraps
from pathlib import Path

import numpy as np
import PIL.Image
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from nrbench.pictures.files import to_rgb
from nrbench.storage import read_arrays, write_bytes

SMALLEST, LARGEST = 192, 384
"""Widths on the page, px: smaller pictures are magnified, larger ones are reduced."""
CROP = 96
"""Side of the magnified part of a weak output, px."""
FOLDER = "pictures"
"""The folder beside the page with the files for zooming, and with the small copies that the page does not embed."""
EMBEDDED = 7_000_000
"""Most bytes of small copies that a page embeds; a page with more of them loads all from :data:`FOLDER`."""
_QUALITY, _LAYER_QUALITY, _MAP_QUALITY = 68, 50, 30
_SHADE = 190
"""Opacity of the marks of an overlay, of 255."""
_CORNERS = np.array([[[0, 114, 178], [0, 158, 115]], [[213, 94, 0], [240, 228, 66]]], np.float64)
"""Colors of the corners of the sample in a source map, from the palette of Okabe and Ito."""
_UNREADABLE = (OSError, SyntaxError, ValueError, EOFError, KeyError, PIL.Image.DecompressionBombError, zlib.error)

Pixels = NDArray[np.uint8]


@dataclass(frozen=True)
class PagePicture:
    """A picture as the page shows it.

    Parameters
    ----------
    content
        The WebP file that the page embeds or loads.
    width, height
        Size of the picture in px.
    full
        Address of the file of all pixels, relative to the page; empty if ``content`` has all pixels.
    """

    content: bytes
    width: int
    height: int
    full: str = ""

    @property
    def scale(self) -> float:
        """Page pixels for each pixel: a whole number for small pictures, which avoids moire; below 1 for large ones."""
        if self.width < SMALLEST:
            return float(-(-SMALLEST // self.width))
        return min(1.0, LARGEST / self.width)


def _once(make: Callable[..., PagePicture | None]) -> Callable[..., PagePicture | None]:
    """Let a method of a store make the picture of some files once, and return None if a file is None or unreadable."""

    @wraps(make)
    def made(store: PictureStore, *paths: Path | None) -> PagePicture | None:
        key = (make, *paths)
        if key not in store._made:
            try:
                store._made[key] = None if None in paths else make(store, *paths)
            except _UNREADABLE:
                store._made[key] = None
        return store._made[key]

    return made


@dataclass(frozen=True)
class PictureStore:
    """The pictures of a page. Each is made once; it is None if there is no readable file.

    Parameters
    ----------
    directory
        Folder of the page.
    single_file
        Whether the page embeds all pixels without loss, instead of small copies beside files for zooming.
    """

    directory: Path
    single_file: bool = False
    _files: set[str] = field(default_factory=set)
    _made: dict[tuple[object, ...], PagePicture | None] = field(default_factory=dict)
    _pixels: Callable[[Path], Pixels] = field(default_factory=lambda: lru_cache(maxsize=8)(read_pixels))

    @_once
    def load(self, path: Path) -> PagePicture | None:
        """Return the picture in a PNG file."""
        pixels = self._pixels(path)
        height, width = pixels.shape[:2]
        if self.single_file or width <= 64:
            return PagePicture(_webp(pixels, 30, lossless=True), width, height)
        return PagePicture(_webp(pixels, _QUALITY, effort=2), width, height, self._keep(path.read_bytes(), ".png"))

    @_once
    def overlay(self, output: Path, layer: Path) -> PagePicture | None:
        """Return the marks of a metric's picture over an output, transparent elsewhere; None if the sizes differ."""
        marks, below = self._pixels(layer), self._pixels(output)
        if marks.shape != below.shape:
            return None
        return PagePicture(_webp(_marks(marks, below), _LAYER_QUALITY), marks.shape[1], marks.shape[0])

    @_once
    def source_map(self, source: Path) -> PagePicture | None:
        """Return the map of the sample's places that the pixels of an output come from, by color."""
        colors = _place_colors(np.asarray(read_arrays(source)["source"][..., :2], np.float32))
        return PagePicture(_webp(colors, _MAP_QUALITY), colors.shape[1], colors.shape[0])

    @_once
    def worst_crop(self, output: Path, *layers: Path) -> PagePicture | None:
        """Return the square of an output with the most marks of defects, its middle without marks.

        Parameters
        ----------
        output
            The output.
        layers
            Pictures of defects over the output; the first with any marks decides.
        """
        pixels = self._pixels(output)
        height, width = pixels.shape[:2]
        side = min(CROP, height, width)
        middle = (width - side) // 2, (height - side) // 2
        x, y = worst_place(pixels, [self._pixels(layer) for layer in layers], side) or middle
        return PagePicture(_webp(pixels[y : y + side, x : x + side], _QUALITY, effort=2), side, side)

    def embeds(self) -> bool:
        """Return whether the page embeds the small copies of all pictures that were made so far."""
        return self.single_file or sum(len(one.content) for one in self._made.values() if one) <= EMBEDDED

    def address(self, picture: PagePicture, embed: bool) -> str:
        """Return the value of ``src`` of a picture: its embedded bytes, or the address of its file."""
        if not embed:
            return self._keep(picture.content, ".webp")
        return f"data:image/webp;base64,{base64.b64encode(picture.content).decode('ascii')}"

    def _keep(self, content: bytes, suffix: str) -> str:
        """Write a file of the folder unless it is there, and return its address; its name is a hash of its content."""
        name = hashlib.blake2s(content, digest_size=12).hexdigest() + suffix
        self._files.add(name)
        if not (self.directory / FOLDER / name).exists():
            write_bytes(self.directory / FOLDER / name, content)
        return f"{FOLDER}/{name}"

    def sweep(self) -> None:
        """Remove the files of pictures that the page no longer has."""
        folder = self.directory / FOLDER
        for file in folder.glob("*") if folder.is_dir() else ():
            if file.name not in self._files and file.suffix in (".webp", ".png"):
                file.unlink(missing_ok=True)


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
    for channel in range(3):  # planes are several times faster than pixels
        np.multiply(layer[..., channel], marked, out=shown[..., channel])
    np.multiply(marked, np.uint8(_SHADE), out=shown[..., 3])
    return shown


def _place_colors(places: NDArray[np.float32]) -> Pixels:
    """Return colors of places (x, y) in the sample, blended between the colors of the corners of the used region."""
    x, y = (_relative(places[..., axis]) for axis in (0, 1))
    colors = np.empty((*x.shape, 3), np.uint8)
    for channel in range(3):  # planes are several times faster than pixels
        top, bottom = (left * (1 - x) + right * x for left, right in _CORNERS[..., channel])
        colors[..., channel] = np.rint(top * (1 - y) + bottom * y)
    return colors


def _relative(values: NDArray[np.float32]) -> NDArray[np.float32]:
    known = np.isfinite(values)  # a method may leave the place of a pixel open
    low, high = (float(values[known].min()), float(values[known].max())) if known.any() else (0.0, 0.0)
    return np.where(known, (values - low) / max(high - low, 1e-9), 0.0)


DEFECTS = ("regularity.defects", "integrity.broken")
"""The pictures of defects, from the one that decides where an output is worst."""
_LEVELS = 3
"""Channels that differ by more levels than this make a pixel colored, or different from the output."""


def read_pixels(path: Path) -> NDArray[np.uint8]:
    """Return the pixels of a PNG file of a cell, ``(H, W, 3)``."""
    with path.open("rb") as file, PIL.Image.open(file, formats=("PNG",)) as image:
        return to_rgb(image)


def find_marks(layer: NDArray[np.uint8], output: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return where a metric's picture has marks, ``(H, W)``.

    A metric draws its marks in color over the output, or over a gray copy of it. Pixels that are gray, or equal to the
    output, are no marks.

    Parameters
    ----------
    layer, output
        The picture and the output, ``(H, W, 3)``.
    """
    planes = _planes(layer)
    marked: NDArray[np.bool_] = planes.max(0) - planes.min(0) > _LEVELS
    if marked.any():
        marked &= _planes(np.maximum(layer, output) - np.minimum(layer, output)).max(0) > _LEVELS
    return marked


def _planes(picture: Pixels) -> Pixels:
    """Return the channels ``(3, H, W)``; a reduction over them is many times faster than over the last axis."""
    return np.ascontiguousarray(np.moveaxis(picture, -1, 0))


def worst_place(
    output: NDArray[np.uint8], layers: Sequence[NDArray[np.uint8] | None], side: int
) -> tuple[int, int] | None:
    """Return the corner (x, y) of the square of an output that has the most marks of defects.

    Parameters
    ----------
    output
        The output.
    layers
        Pictures of defects over the output; the first with any marks decides.
    side
        Side of the square, px.

    Returns
    -------
    tuple of int or None
        None without marks, and if more than half of the output is marked: then no place is the worst.
    """
    for layer in layers:
        if layer is None or layer.shape != output.shape or side < 2:
            continue
        marked = find_marks(layer, output)
        if 0 < marked.mean() <= 0.5:
            density = uniform_filter(marked.astype(np.float64), side, mode="constant")
            y, x = np.unravel_index(int(density.argmax()), density.shape)
            height, width = marked.shape
            return int(np.clip(x - side // 2, 0, width - side)), int(np.clip(y - side // 2, 0, height - side))
    return None
