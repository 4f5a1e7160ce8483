"""A picture of the line that stands out most."""

from __future__ import annotations

import numpy as np

from nrbench.imaging.convert import Image

from .seams import Line

_MARK = np.array((0.9, 0.1, 0.1), np.float32)
_DASH, _GAP = 8, 24


def line_map(output: Image, line: Line) -> Image:
    """Return the output in its colors, the line drawn in short dashes, far enough apart to see what is there."""
    picture = np.array(np.broadcast_to(output, (*output.shape[:2], 3)))
    (x0, y0), (x1, y1) = line.ends
    number = int(max(abs(x1 - x0), abs(y1 - y0))) + 1
    along = np.linspace(0, 1, number)
    along = along[np.arange(number) % (_DASH + _GAP) < _DASH]
    x, y = np.rint(x0 + along * (x1 - x0)).astype(int), np.rint(y0 + along * (y1 - y0)).astype(int)
    inside = (x >= 0) & (y >= 0) & (x < picture.shape[1]) & (y < picture.shape[0])
    picture[y[inside], x[inside]] = _MARK
    return picture
