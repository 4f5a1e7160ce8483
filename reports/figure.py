"""Write the outputs of chosen methods on chosen textures as one figure for a paper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import PIL.Image
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.textpath import TextPath
from numpy.typing import NDArray

from nrbench.errors import BadInput
from nrbench.runs.records import CellRecord, Run
from nrbench.storage import write_files

from .page.pictures import DEFECTS, read_pixels, worst_place
from .page.plots import GRAY, INK, Plotter, add_axes, make_figure
from .statistics.format import break_name
from .statistics.method_comparison import Comparison, ComparisonRow, compare_methods, match_names
from .statistics.summaries import Method
from .statistics.verdicts import MARKS, bound_sign, verdict

_INSET = 0.4
"""Side of an inset, as a share of the output's."""
_MAGNIFY = 2.5
_FRAME = "#D55E00"

Pixels = NDArray[np.uint8]


@dataclass(frozen=True)
class PictureGrid:
    """Samples and outputs side by side, as ``figure.pdf`` and ``figure.png``.

    Each row is a texture: its sample, then the output of each method, in the same scale. Below each output stand the
    mark of the verdict and the quality. The corner of an output shows its worst place magnified, and a frame shows
    where it lies; outputs without a defect that the metrics located have none.

    Parameters
    ----------
    textures
        Names of textures, or patterns such as ``brick-*``; by default the four on which the shown methods differ
        most.
    methods
        Names of methods, names with the source of the lattice in parentheses, or patterns; by default the five best
        ranked ones.
    replicate
        Number of the draw.
    width
        Width in inches, from 2 to 12; 3.3 and 7 are the widths of a column and of a page in common styles.
    insets
        Whether to magnify the worst places.
    """

    textures: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()
    replicate: int = 0
    width: float = 7.0
    insets: bool = True

    version: ClassVar[str] = "1"

    def __post_init__(self) -> None:
        if not 2 <= self.width <= 12:
            raise BadInput(f"report figure: width is {self.width:g}; give 2 to 12 inches")

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write the files and return their paths; none if the run has no cells."""
        comparison = compare_methods(run)
        methods = choose_methods(comparison, self.methods)
        rows = choose_textures(comparison, self.textures, methods)
        if not rows or not methods:
            return []
        shown = (comparison, rows, methods, self.replicate, self.width, self.insets)
        return write_files(directory, plot_pictures.files("figure", ("pdf", "png"), *shown))


def choose_textures(
    comparison: Comparison, patterns: tuple[str, ...], methods: Sequence[Method]
) -> list[ComparisonRow]:
    """Return the rows that a pattern names, or the four on which the scores of the methods differ most."""
    if not patterns:
        shown = [i for i, method in enumerate(comparison.methods) if method in methods]

        def spread(row: ComparisonRow) -> float:
            scores = [entry.score for i in shown if (entry := row.entries[i]) and entry.score is not None]
            return max(scores) - min(scores) if scores else -1.0

        best = sorted(comparison.rows, key=spread, reverse=True)[:4]
        return [row for row in comparison.rows if row in best]
    return match_names("texture", patterns, [((row.texture,), row) for row in comparison.rows])


def choose_methods(comparison: Comparison, patterns: tuple[str, ...]) -> list[Method]:
    """Return the methods that a pattern names, or the five best that are no references."""
    if not patterns:
        return [method for method in comparison.methods if not method.reference][:5]
    return match_names("method", patterns, [((method.label, method.name), method) for method in comparison.methods])


@Plotter
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
