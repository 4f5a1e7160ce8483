"""The contact sheet: many pictures on one, each under its caption."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

import numpy as np
import PIL.Image
import PIL.ImageDraw
import PIL.ImageFont

from nrbench.imaging.convert import Image, to_bytes

_LINE = 13
_MARGIN = 8
_WIDEST = 30
"""Letters on a line of a caption, at least."""


def contact_sheet(pictures: Sequence[Image], captions: Sequence[str], columns: int = 8) -> Image:
    """Return all pictures in rows, each under its caption.

    Parameters
    ----------
    pictures
        Any sizes and channels; the widest gives the width of all columns.
    captions
        As many; lines that are too long for their column are cut.
    columns
        At most.

    Raises
    ------
    ValueError
        When there are no pictures, or not as many captions.
    """
    if not pictures or len(pictures) != len(captions):
        raise ValueError(
            f"{len(pictures)} pictures and {len(captions)} captions: a contact sheet needs as many of both"
        )
    columns = min(columns, len(pictures))
    lines = max(caption.count("\n") + 1 for caption in captions)
    width = max(6 * _WIDEST, *(picture.shape[1] for picture in pictures)) + _MARGIN
    rows = [range(i, min(i + columns, len(pictures))) for i in range(0, len(pictures), columns)]
    heights = [max(pictures[k].shape[0] for k in row) + lines * _LINE + _MARGIN for row in rows]
    sheet = PIL.Image.new("RGB", (columns * width + _MARGIN, sum(heights) + _MARGIN), "white")
    pen, top = PIL.ImageDraw.Draw(sheet), _MARGIN
    for row, height in zip(rows, heights, strict=True):
        for column, k in enumerate(row):
            left = _MARGIN + column * width
            _write(pen, (left, top), captions[k], width - _MARGIN)
            sheet.paste(_opened(pictures[k]), (left, top + lines * _LINE))
        top += height
    return np.asarray(sheet, np.float32) / np.float32(255)


def _opened(picture: Image) -> PIL.Image.Image:
    pixels = to_bytes(picture)
    return PIL.Image.fromarray(pixels[..., 0] if pixels.shape[2] == 1 else pixels).convert("RGB")


def _write(pen: PIL.ImageDraw.ImageDraw, corner: tuple[int, int], caption: str, width: int) -> None:
    font = PIL.ImageFont.load_default(size=11)
    for i, line in enumerate(caption.split("\n")):
        letters = ceil(len(line) * min(1.0, width / max(1.0, font.getlength(line))))
        while font.getlength(line[:letters]) > width:
            letters -= 1
        pen.text((corner[0], corner[1] + i * _LINE), line[:letters], fill="black", font=font)
