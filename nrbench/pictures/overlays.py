"""Draw lattices over an image or a part of it, and many images on one sheet."""

from __future__ import annotations

import importlib.util
import unicodedata
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Sequence
from math import ceil
from pathlib import Path

import numpy as np
import PIL.Image
import PIL.ImageDraw
import PIL.ImageFont
import skimage
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.imaging.wallpaper_group import FoundGroup, Symmetry
from nrbench.lattice.geometry import Lattice, Points
from nrbench.lattice.vertices import Vertex
from nrbench.pictures.files import to_pil

COLOR = (1.0, 0.1, 0.6)
"""sRGB color of lattices; rare in brick, cloth and tile."""
PANEL = 248
"""px; largest side of a panel."""
_CELLS, _OTHER_CELLS = 5.0, 2.2
"""A panel shows at least this number of cells of the first lattice, and of each other one, along each side."""
_LEAST = 24.0
"""px; least side of the part of the image that a panel shows."""
_VISIBLE = 6.0
"""px; cells of a smaller side are not drawn over a whole image: the lines would hide it."""
_CLEAR = 24.0
"""px; side of a cell that is clear to see among the lines."""
_LARGEST = 2048
"""px; no overlay is enlarged beyond it."""
_AXIS, _CENTER = (0, 235, 235), (20, 20, 140)
"""sRGB colors of axes and centers of symmetries."""
_DASH = 6.0
"""px; length of the dashes of the axis of a glide."""
_ROWS = 256
"""Number of rows that are drawn at a time: arrays of the whole image would need much memory."""
_SIZE = 11
"""Height of a letter, px."""
_MARGIN = 8
"""px; space between images."""
_GAP = 3
"""px; space between a caption and its picture."""
_LETTERS = 30
"""Least number of letters on a line of a caption."""


def draw_lattice(image: Image, lattice: Lattice, color: tuple[float, float, float] = COLOR) -> Image:
    """Return the image in color with the cells of the lattice drawn over it in anti-aliased lines one pixel wide.

    Parameters
    ----------
    image
        Any :data:`~nrbench.imaging.convert.Image`.
    lattice
        In the image's coordinates. The cells of its reduced basis are drawn.
    color
        sRGB color of the lines, in [0, 1].

    Returns
    -------
    Image
        Float32 ``(H, W, 3)`` in [0, 1].

    Notes
    -----
    Each pixel is mixed with the color by its distance from the nearest line, which follows from its cell coordinates.
    The time depends on the image alone and not on the number of cells.

    Examples
    --------
    >>> from nrbench import draw_lattice, texture
    >>> brick = texture("brick", shape=(64, 96))
    >>> draw_lattice(brick.image, brick.lattice).shape
    (64, 96, 3)
    """
    canvas = np.repeat(image, 3, axis=2) if image.shape[2] == 1 else image.copy()
    basis = lattice.reduced()
    steps = np.linalg.inv(basis.matrix)
    slopes = steps / np.hypot(*steps)  # columns of length 1: their products with a vector are distances in px
    apart = 1 / np.hypot(*steps)
    x = np.arange(image.shape[1]) - basis.origin[0]
    for top in range(0, image.shape[0], _ROWS):
        rows = canvas[top : top + _ROWS]
        y = np.arange(top, top + len(rows))[:, np.newaxis] - basis.origin[1]
        near = np.full(rows.shape[:2], np.inf)
        for (right, down), spacing in zip(slopes.T, apart, strict=True):
            distance = x * right + y * down
            distance -= spacing * np.rint(distance / spacing)
            np.minimum(near, np.abs(distance, out=distance), out=near)
        lines = near < 1
        weight = (1 - near[lines]).astype(np.float32)[:, np.newaxis]
        rows[lines] += weight * (np.array(color, np.float32) - rows[lines])
    return canvas


def draw_overlay(image: Image, lattice: Lattice, symmetry: FoundGroup | None = None) -> Image:
    """Return the image with a lattice drawn over it, enlarged by a whole factor if the picture or the cells are small.

    The factor makes the shortest side of a cell at least 24 px and the longer side of the picture at least 248 px,
    as far as the picture stays under 2048 px.

    Parameters
    ----------
    image
        Any :data:`~nrbench.imaging.convert.Image`.
    lattice
        In the image's coordinates.
    symmetry
        Its symmetries are drawn by the usual signs: mirrors as lines, glides as dashed lines, centers of rotations of
        order 2, 3, 4 and 6 as rhombi, triangles, squares and hexagons.
    """
    longer = max(image.shape[:2])
    wanted = max(ceil(_CLEAR / lattice.s), ceil(PANEL / longer))
    panel, factor = _scale(image, longer * max(1, min(wanted, _LARGEST // longer)))
    drawn = draw_lattice(panel, _place(lattice, (0, 0), factor))
    return drawn if symmetry is None else _draw_signs(drawn, symmetry, factor)


def _draw_signs(panel: Image, found: FoundGroup, factor: float) -> Image:
    """Return the color panel, enlarged by a factor, with the signs of all symmetries of the texture."""
    picture, shape = to_pil(panel), (panel.shape[0], panel.shape[1])
    pen = PIL.ImageDraw.Draw(picture)
    radius = min(max(0.12 * found.lattice.s * factor, 4.0), 9.0)
    for each in reversed(found.symmetries):
        if each.kind != "rotation":
            for start, end in _axis_segments(each, shape, factor):
                pen.line([*start, *end], fill=_AXIS, width=2)
            continue
        corners, breadth = (4, 0.5) if each.order == 2 else (each.order, 1.0)
        angles = 2 * np.pi * np.arange(corners) / corners - np.pi / (4 if each.order == 4 else 2)
        sign = radius * np.stack([breadth * np.cos(angles), np.sin(angles)], -1)
        basis = np.linalg.inv(np.eye(2) - each.matrix)
        centers = _place(Lattice.from_basis(found.lattice.matrix @ basis, each.center), (0, 0), factor)
        for center in centers.points(shape):
            pen.polygon((center + sign).ravel().tolist(), fill=_CENTER, outline="white")
    return np.asarray(picture, np.float32) / np.float32(255)


def _axis_segments(reflection: Symmetry, shape: tuple[int, int], factor: float) -> Iterator[tuple[Points, Points]]:
    """Yield the ends of the lines, and of the dashes of glides, along all axes in a picture enlarged by a factor."""
    (height, width), step = shape, np.array(reflection.spacing) * factor
    first, along = (np.array(reflection.center) + 0.5) * factor - 0.5, np.array(reflection.axis)
    along, reach = along / np.hypot(*along), (height + width) / 2
    middle = np.array([width, height]) / 2 - first
    count, half = middle @ step / (step @ step), reach / np.hypot(*step)
    for number in np.arange(np.ceil(2 * (count - half)), 2 * (count + half) + 1):
        if number % 2 and not reflection.centered:
            continue
        at = first + number / 2 * step + middle @ along * along
        if reflection.kind == "glide" or number % 2:
            for dash in np.arange(-reach, reach, 2 * _DASH):
                yield at + dash * along, at + (dash + _DASH) * along
        else:
            yield at - reach * along, at + reach * along


def draw_vertices(image: Image, vertices: Sequence[Vertex]) -> Image:
    """Return the image in color with a line between each two vertices that are neighbors in a row or a column."""
    canvas = np.repeat(image, 3, axis=2) if image.shape[2] == 1 else image.copy()
    at = {(vertex.row, vertex.column): (vertex.x, vertex.y) for vertex in vertices}
    for (row, column), start in at.items():
        for end in filter(None, (at.get((row, column + 1)), at.get((row + 1, column)))):
            _draw_line(canvas, start, end)
    return canvas


def draw_outlines(image: Image, outlines: Sequence[Sequence[tuple[float, float]]]) -> Image:
    """Return the image in color with closed outlines, each given by its corners (x, y) px, and their numbers from 1."""
    picture = to_pil(np.repeat(image, 3, axis=2) if image.shape[2] == 1 else image)
    pen = PIL.ImageDraw.Draw(picture)
    color = tuple(round(255 * part) for part in COLOR)
    for number, corners in enumerate(outlines, 1):
        pen.polygon(list(corners), outline=color, width=2)
        pen.text(min(corners), str(number), fill=color, font=_load_font(_SIZE), anchor="rb", stroke_width=1)
    return np.asarray(picture, np.float32) / np.float32(255)


def _draw_line(canvas: Image, start: Iterable[float], end: Iterable[float]) -> None:
    x0, y0, x1, y1 = np.rint([*start, *end]).astype(int)
    rows, columns, weight = skimage.draw.line_aa(y0, x0, y1, x1)  # type: ignore[no-untyped-call]
    inside = (rows >= 0) & (rows < canvas.shape[0]) & (columns >= 0) & (columns < canvas.shape[1])
    rows, columns, weight = rows[inside], columns[inside], weight[inside, np.newaxis].astype(np.float32)
    canvas[rows, columns] = canvas[rows, columns] * (1 - weight) + np.array(COLOR, np.float32) * weight


def draw_seams(image: Image, *profiles: NDArray[np.float32] | None) -> Image:
    """Return the image in color, rolled by half, with the seams drawn that its edges make.

    Parameters
    ----------
    image
        Any :data:`~nrbench.imaging.convert.Image`.
    profiles
        Of the right edge and of the lower edge: numbers along it. The seam is drawn where they exceed 1, or whole where
        none does; None: not at all.
    """
    half = (image.shape[0] // 2, image.shape[1] // 2)
    canvas = np.roll(np.repeat(image, 3, axis=2) if image.shape[2] == 1 else image, half, (0, 1))
    for part, middle, before, profile in zip((canvas.swapaxes(0, 1), canvas), half[::-1], half, profiles, strict=True):
        if profile is not None:
            drawn = np.roll(profile > min(1.0, float(profile.max()) / 2), before)
            part[middle - 1 : middle + 1, drawn] = COLOR
    return canvas


def zoom_panels(image: Image, lattices: Sequence[Lattice], side: int = PANEL) -> list[Image]:
    """Return the same part of an image once for each lattice, with this lattice drawn over it.

    Parameters
    ----------
    image
        Any :data:`~nrbench.imaging.convert.Image`.
    lattices
        In the image's coordinates. The part is the middle of the image. It shows about five cells of the
        first lattice along each side, and two of the others.
    side
        Largest side of a panel, px. Small parts are enlarged by a whole factor, large ones are shrunk.
    """
    if not lattices:
        return []
    longest = [float(np.hypot(*lattice.reduced().t2)) for lattice in lattices]
    extent = max(_CELLS * longest[0], _OTHER_CELLS * max(longest), _LEAST)
    height, width = (min(n, round(extent)) for n in image.shape[:2])
    top, left = (image.shape[0] - height) // 2, (image.shape[1] - width) // 2
    part = image[top : top + height, left : left + width]
    panel, factor = _scale(part, side)
    return [draw_lattice(panel, _place(lattice, (left, top), factor)) for lattice in lattices]


def draw_overview(image: Image, lattice: Lattice | None, side: int = PANEL) -> Image:
    """Return a whole image, scaled to ``side`` px, with a lattice drawn over it if its cells can be seen at this scale.

    Parameters
    ----------
    image
        Any :data:`~nrbench.imaging.convert.Image`.
    lattice
        In the image's coordinates; None: nothing is drawn.
    side
        Largest side of the result, px.
    """
    panel, factor = _scale(image, side)
    if lattice is None or lattice.s * factor < _VISIBLE:
        return np.repeat(panel, 3, axis=2) if panel.shape[2] == 1 else panel
    return draw_lattice(panel, _place(lattice, (0, 0), factor))


def _scale(image: Image, side: int) -> tuple[Image, float]:
    """Return an image whose longer side is at most ``side`` px, and the factor: a whole number if it is enlarged."""
    longer = max(image.shape[:2])
    if longer <= side:
        times = side // longer
        return np.repeat(np.repeat(image, times, axis=0), times, axis=1), float(times)
    size = (max(1, round(n * side / longer)) for n in image.shape[1::-1])
    small = np.asarray(to_pil(image).resize(tuple(size), PIL.Image.Resampling.BOX), np.float32) / np.float32(255)
    return small.reshape(*small.shape[:2], -1), side / longer


def _place(lattice: Lattice, corner: tuple[int, int], factor: float) -> Lattice:
    """Return a lattice in the coordinates of a part of the image that begins at ``corner`` (x, y) and is scaled."""
    origin = (np.array(lattice.origin) - corner + 0.5) * factor - 0.5
    return Lattice.from_basis(lattice.matrix * factor, (float(origin[0]), float(origin[1])))


def stack(upper: Image, lower: Image) -> Image:
    """Return two color images one above the other; the narrower one is filled up with white on its right."""
    width = max(upper.shape[1], lower.shape[1])
    parts = [np.pad(each, ((0, 0), (0, width - each.shape[1]), (0, 0)), constant_values=1) for each in (upper, lower)]
    return np.concatenate(parts)


def contact_sheet(pictures: Sequence[Image], captions: Sequence[str], columns: int = 8, letters: int = _SIZE) -> Image:
    """Return all images in rows, each below its caption.

    Parameters
    ----------
    pictures
        Any sizes and channels; the widest one determines the width of all columns.
    captions
        One for each image; lines that are too long for their column are broken, if possible between words.
    columns
        Largest number of images in a row.
    letters
        Height of a letter, px.
    """
    font, line = _load_font(letters), round(1.4 * letters) - 2
    columns = min(columns, len(pictures))
    width = max(6 * _LETTERS, *(picture.shape[1] for picture in pictures)) + _MARGIN
    texts = [break_lines(caption, lambda text: font.getlength(text) <= width - _MARGIN) for caption in captions]
    rows = [range(i, min(i + columns, len(pictures))) for i in range(0, len(pictures), columns)]
    lines = [max(len(texts[k]) for k in row) * line + _GAP for row in rows]
    heights = [max(pictures[k].shape[0] for k in row) + top + _MARGIN for row, top in zip(rows, lines, strict=True)]
    sheet = PIL.Image.new("RGB", (columns * width + _MARGIN, sum(heights) + _MARGIN), "white")
    pen, top = PIL.ImageDraw.Draw(sheet), _MARGIN
    for row, height, above in zip(rows, heights, lines, strict=True):
        for column, k in enumerate(row):
            left = _MARGIN + column * width
            for i, text in enumerate(texts[k]):
                pen.text((left, top + i * line), text, fill="black", font=font)
            sheet.paste(to_pil(pictures[k]).convert("RGB"), (left, top + above))
        top += height
    return np.asarray(sheet, np.float32) / np.float32(255)


def _load_font(letters: int) -> PIL.ImageFont.FreeTypeFont | PIL.ImageFont.ImageFont:
    """Return matplotlib's font, which has the letters of most alphabets; else that of Pillow, which has ASCII."""
    package = importlib.util.find_spec("matplotlib")
    folder = Path(package.origin).parent if package and package.origin else Path()
    try:
        return PIL.ImageFont.truetype(str(folder / "mpl-data" / "fonts" / "ttf" / "DejaVuSans.ttf"), letters)
    except OSError:
        return PIL.ImageFont.load_default(letters)


def break_lines(text: str, fits: Callable[[str], bool]) -> list[str]:
    """Return the lines of a text, broken so that each one fits: between words, or within a word that is too long.

    Parameters
    ----------
    text
        The text. Accented letters become one character each (NFC), which fonts draw better.
    fits
        Whether a line fits. A single letter counts as fitting.
    """
    lines = []
    for rest in unicodedata.normalize("NFC", text).split("\n"):
        while not fits(rest) and len(rest) > 1:
            most = max(1, bisect_left(range(1, len(rest)), True, key=lambda count: not fits(rest[:count])))
            end = max(rest.rfind(" ", 0, most + 1), 0) or most
            lines.append(rest[:end].rstrip())
            rest = rest[end:].lstrip()
        lines.append(rest)
    return lines
