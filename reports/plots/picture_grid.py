"""Plot samples and outputs as a grid, with verdicts and magnified defects."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import PIL.Image
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.textpath import TextPath
from numpy.typing import NDArray

from nrbench.runs.records import CellRecord

from ..statistics.format import break_name
from ..statistics.method_comparison import Comparison, ComparisonRow
from ..statistics.summaries import Method
from ..statistics.verdicts import MARKS, bound_sign, verdict
from .figure_file import GRAY, INK, add_axes, make_figure, returns_file
from .marks import DEFECTS, read_pixels, worst_place

_INSET = 0.4
"""Side of an inset, as a share of the output's."""
_MAGNIFY = 2.5
_FRAME = "#D55E00"

Pixels = NDArray[np.uint8]


@returns_file
def plot_pictures(
    comparison: Comparison,
    rows: Sequence[ComparisonRow],
    methods: Sequence[Method],
    replicate: int,
    width: float,
    insets: bool,
) -> Figure:
    """Plot the grid: a row for each texture, a column for each method.

    Parameters
    ----------
    comparison
        The comparison that has the rows and methods.
    rows, methods
        The textures and methods to show.
    replicate
        Number of the draw.
    width
        Width in inches.
    insets
        Whether to magnify the worst place of each output.
    """
    side = 72 * width / (len(methods) + 1) - 4
    font = float(np.clip(side / 11, 4.0, 8.0))
    titles, title_font = _fit_names(("sample", *(method.label for method in methods)), side, font)
    names, name_font = _fit_names([row.texture for row in rows], side, font)
    above = 4 + 1.2 * font * max(title.count("\n") + 1 for title in titles)
    high = side + 4 + 1.2 * font * max(name.count("\n") + 1 for name in names)
    figure = make_figure(width, above + high * len(rows))
    for i, row in enumerate(rows):
        records = [_record(row, list(comparison.methods).index(method), replicate) for method in methods]
        outputs = [_read(one.folder / "output.png") if one and one.status == "ok" else None for one in records]
        samples = (_read(one.folder / "sample.png") for one in records if one)
        sample = next((picture for picture in samples if picture is not None), None)
        largest = max((picture.shape[1] for picture in outputs if picture is not None), default=0)
        for j, picture in enumerate([sample, *outputs]):
            left, top = 2 + (side + 4) * j, above + high * i
            bottom = high * (len(rows) - i) - side
            axes = add_axes(figure, left, bottom, 72 * width - left - side, top)
            _draw(axes, picture, largest)
            if j and picture is not None and insets and (one := records[j - 1]):
                _draw_inset(axes, picture, one)
            under = _verdict_words(records[j - 1]) if j else names[i]
            axes.set_xlabel(under, fontsize=font if j else name_font, color=INK, labelpad=2)
            if not i:
                style = "italic" if j and methods[j - 1].reference else "normal"
                axes.set_title(titles[j], fontsize=title_font, color=INK, pad=3, style=style)
    return figure


def _fit_names(names: Sequence[str], side: float, font: float) -> tuple[list[str], float]:
    """Return names in lines no wider than a picture, and the size at which the longest line fits."""
    titles = ["\n".join(break_name(name, max(6, int(side / (0.6 * font))))) for name in names]
    widest = max(
        TextPath((0, 0), line, size=font).get_extents().width for line in "\n".join(titles).split("\n") if line
    )
    return titles, min(font, font * side / widest)


def _record(row: ComparisonRow, place: int, replicate: int) -> CellRecord | None:
    entry = row.entries[place]
    return next((one for one in entry.records if one.replicate == replicate), None) if entry else None


def _read(path: Path) -> Pixels | None:
    try:
        return read_pixels(path)
    except (OSError, SyntaxError, ValueError, PIL.Image.DecompressionBombError):
        return None


def _verdict_words(record: CellRecord | None) -> str:
    if record is None:
        return "–"
    score = record.values.get("quality.score")
    return MARKS[verdict(record)] + ("" if score is None else f" {bound_sign(record)}{float(score):.2f}")


def _draw(axes: Axes, picture: Pixels | None, largest: int) -> None:
    """Draw a picture in the scale in which ``largest`` px fill the axes, or a stroke if there is none."""
    axes.set(xticks=[], yticks=[])
    if picture is None:
        axes.plot((0, 1), (0, 1), color=GRAY, lw=0.5)
        axes.set(xlim=(0, 1), ylim=(0, 1))
    else:
        height, width = picture.shape[:2]
        axes.imshow(picture, interpolation="none")
        margin = max(0.0, largest - width) / 2
        axes.set_xlim(-0.5 - margin, width - 0.5 + margin)
        axes.set_ylim(max(height, largest) - 0.5, -0.5)
    for spine in axes.spines.values():
        spine.set(color=GRAY, lw=0.4, visible=picture is None or picture.shape[1] >= largest)


def _draw_inset(axes: Axes, picture: Pixels, record: CellRecord) -> None:
    """Draw the worst place of an output, magnified, in the corner that lies farthest from it."""
    side = round(min(picture.shape[:2]) * _INSET / _MAGNIFY)
    found = worst_place(picture, [_read(path) for name in DEFECTS if (path := record.pictures.get(name))], side)
    if found is None:
        return
    x, y = found
    axes.add_patch(Rectangle((x - 0.5, y - 0.5), side, side, fill=False, ec=_FRAME, lw=1.0))
    right, lower = x + side / 2 < picture.shape[1] / 2, y + side / 2 < picture.shape[0] / 2
    inset = axes.inset_axes(((1 - _INSET) * right, (1 - _INSET) * (not lower), _INSET, _INSET))
    inset.imshow(picture[y : y + side, x : x + side], interpolation="none")
    inset.set(xticks=[], yticks=[])
    for spine in inset.spines.values():
        spine.set(color=_FRAME, lw=1.2)
