"""Draw a lattice over its image, and many images on one sheet."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

import numpy as np
import PIL.Image
import PIL.ImageDraw
import PIL.ImageFont
from skimage.draw import line_aa

from nrbench.imaging.convert import Image, to_bytes
from nrbench.lattice.geometry import Lattice, Points

COLOR = (1.0, 0.1, 0.6)
"""sRGB color of lattices; rare in brick, cloth and tile."""
_LINE = 13
"""Height of a line of a caption, px."""
_MARGIN = 8
"""px; space between images."""
_LETTERS = 30
"""Least number of letters on a line of a caption."""


def draw_lattice(image: Image, lattice: Lattice) -> Image:
    """Return the image in color with the cells of the lattice drawn over it in anti-aliased lines one pixel wide.

    Parameters
    ----------
    image
        Any :data:`~nrbench.imaging.convert.Image`.
    lattice
        In the image's coordinates. The cells of its reduced basis are drawn.
    """
    basis = lattice.reduced()
    corners = basis.points((image.shape[0], image.shape[1]), margin=2 * float(np.abs(basis.matrix).max()))
    starts = np.concatenate([corners, corners])
    return draw_segments(image, starts, starts + np.repeat(basis.matrix, len(corners), 0))


def draw_segments(image: Image, starts: Points, ends: Points) -> Image:
    """Return the image in color with anti-aliased segments one pixel wide drawn over it.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    starts, ends
        ``(n, 2)`` each: (x, y) px.
    """
    canvas = np.repeat(image, 3, axis=2) if image.shape[2] == 1 else image.copy()
    for start, end in zip(starts, ends, strict=True):
        _draw_line(canvas, start, end)
    return canvas


def _draw_line(canvas: Image, start: Points, end: Points) -> None:
    x0, y0, x1, y1 = np.rint([*start, *end]).astype(int)
    rows, columns, weight = line_aa(y0, x0, y1, x1)  # type: ignore[no-untyped-call]
    inside = (rows >= 0) & (rows < canvas.shape[0]) & (columns >= 0) & (columns < canvas.shape[1])
    rows, columns, weight = rows[inside], columns[inside], weight[inside, np.newaxis].astype(np.float32)
    canvas[rows, columns] = canvas[rows, columns] * (1 - weight) + np.array(COLOR, np.float32) * weight


def contact_sheet(pictures: Sequence[Image], captions: Sequence[str], columns: int = 8) -> Image:
    """Return all images in rows, each below its caption.

    Parameters
    ----------
    pictures
        Any sizes and channels; the widest one determines the width of all columns.
    captions
        One for each image; lines that are too long for their column are cut.
    columns
        Largest number of images in a row.

    Raises
    ------
    ValueError
        If there are no images, or the numbers of images and captions differ.
    """
    if not pictures or len(pictures) != len(captions):
        raise ValueError(
            f"{len(pictures)} pictures and {len(captions)} captions: a contact sheet needs as many of both"
        )
    columns = min(columns, len(pictures))
    lines = max(caption.count("\n") + 1 for caption in captions)
    width = max(6 * _LETTERS, *(picture.shape[1] for picture in pictures)) + _MARGIN
    rows = [range(i, min(i + columns, len(pictures))) for i in range(0, len(pictures), columns)]
    heights = [max(pictures[k].shape[0] for k in row) + lines * _LINE + _MARGIN for row in rows]
    sheet = PIL.Image.new("RGB", (columns * width + _MARGIN, sum(heights) + _MARGIN), "white")
    pen, top = PIL.ImageDraw.Draw(sheet), _MARGIN
    for row, height in zip(rows, heights, strict=True):
        for column, k in enumerate(row):
            left = _MARGIN + column * width
            _write(pen, (left, top), captions[k], width - _MARGIN)
            sheet.paste(_to_pil(pictures[k]), (left, top + lines * _LINE))
        top += height
    return np.asarray(sheet, np.float32) / np.float32(255)


def _to_pil(picture: Image) -> PIL.Image.Image:
    pixels = to_bytes(picture)
    return PIL.Image.fromarray(pixels[..., 0] if pixels.shape[2] == 1 else pixels).convert("RGB")


def _write(pen: PIL.ImageDraw.ImageDraw, corner: tuple[int, int], caption: str, width: int) -> None:
    font = PIL.ImageFont.load_default(size=11)
    for i, line in enumerate(caption.split("\n")):
        letters = ceil(len(line) * min(1.0, width / max(1.0, font.getlength(line))))
        while font.getlength(line[:letters]) > width:
            letters -= 1
        pen.text((corner[0], corner[1] + i * _LINE), line[:letters], fill="black", font=font)
