"""Plot the methods of a run in one style: perils plane, ranks, heat map, cost, quality by level, claims."""

from __future__ import annotations

import io
import textwrap
import warnings
from collections.abc import Callable, Sequence
from typing import Any, Generic, ParamSpec

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, NullFormatter
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

from ..statistics.estimates import Estimate, mean_of_known
from ..statistics.expectations import BROKEN, ClaimResult, LevelPanel
from ..statistics.format import break_name, format_value
from ..statistics.method_comparison import Comparison, ComparisonRow
from ..statistics.summaries import Method, MethodSummary, PerilsPoint
from ..statistics.verdicts import BASELINE_LEGEND, BASELINE_SIGN, BOUND_SIGN, RANKING, SHARES_LEGEND

P = ParamSpec("P")

INK, GRAY, FAINT = "black", "0.45", "0.8"
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#F0E442")
"""The palette of M. Okabe and K. Ito, "Color universal design", 2008; it is safe for color-blind readers."""
SIGNS = "osD^vPX*"
"""The markers of lines, so that color is not the only difference."""
SMALL: Any = {"color": GRAY, "fontsize": 7}
_STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 8,
    "text.parse_math": False,
    "svg.hashsalt": "nrbench",
    "svg.fonttype": "path",
    "pdf.fonttype": 42,
    "axes.linewidth": 0.7,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
}


def make_figure(width: float, height: float, **more: Any) -> Figure:
    """Return an empty figure; width in inches, height in points, and further arguments of ``Figure``."""
    figure = Figure(figsize=(width, height / 72), dpi=72, **more)
    FigureCanvasAgg(figure)
    return figure


def add_axes(figure: Figure, left: float, bottom: float, right: float, top: float) -> Axes:
    """Add axes to a figure and return them; the arguments are the margins to the edges of the figure, points."""
    width, height = 72 * figure.get_size_inches()
    return figure.add_axes((left / width, bottom / height, 1 - (left + right) / width, 1 - (bottom + top) / height))


def open_frame(axes: Axes) -> None:
    """Give axes short ticks, and a frame that is open at the top and at the right."""
    axes.tick_params(length=3, width=0.7)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


class Plotter(Generic[P]):
    """A function that draws a figure, and returns its file. Its new first argument is the kind: svg, pdf or png.

    Parameters
    ----------
    draw
        Draws the figure.
    """

    def __init__(self, draw: Callable[P, Figure]) -> None:
        self._draw = draw

    def __call__(self, kind: str, /, *args: P.args, **kwargs: P.kwargs) -> bytes:
        """Return the file of one kind."""
        return self.files("", (kind,), *args, **kwargs)[f".{kind}"]

    def files(self, stem: str, kinds: Sequence[str], /, *args: P.args, **kwargs: P.kwargs) -> dict[str, bytes]:
        """Return the files of several kinds by their names; the figure is drawn once."""
        files = {}
        dates = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}  # equal runs give equal bytes
        with matplotlib.rc_context(_STYLE), warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Glyph .* missing from font")  # an emoji in a name is drawn as a box
            figure = self._draw(*args, **kwargs)
            for kind in kinds:
                file, (back, dots) = io.BytesIO(), ("white", 160) if kind == "png" else ("none", 72)
                figure.savefig(file, format=kind, facecolor=back, metadata=dates.get(kind), dpi=dots)
                files[f"{stem}.{kind}"] = file.getvalue()
        return files


Floats = NDArray[np.float64]
_SIZE = 6.4
"""Size of a marker, pt."""
_NARROW = 4.6
"""Below this width, in inches, points have numbers, which a list below the plane explains."""
_LIST_ROW = 9.5
_CONTOURS = (0.2, 0.4, 0.6, 0.8)
_FIRST_ROW, _NEXT_ROW = -0.15, -0.07
"""Height of the first method whose randomness is not scored, and distance to the next one, in units of randomness."""


def caption_text(point: PerilsPoint) -> str:
    """Return the caption of a point: method, lattice source, what the height rests on, validity."""
    count = "" if point.has_height else f" n = {point.structure.n}"
    return point.method.label + point.rests_on + point.validity.sign + count


@Plotter
def plot_perils_plane(points: Sequence[PerilsPoint], width: float = 5.5) -> Figure:
    """Plot the plane, ``width`` inches wide."""
    narrow, shown = width < _NARROW, choose_named([point.method.reference for point in points])
    unscored = [point for point, named in zip(points, shown, strict=True) if named and not point.has_height]
    rows = {id(point): _FIRST_ROW + _NEXT_ROW * i for i, point in enumerate(unscored)}
    places = [(float(one.structure.value or 0), rows.get(id(one), float(one.randomness.value or 0))) for one in points]
    chosen = [i for i, named in enumerate(shown) if named]
    notes = [line for note in _footnotes(points, shown) for line in textwrap.wrap(note, int(18 * width))]
    texts = [textwrap.fill(caption_text(points[i]), 26) for i in chosen]
    lowest = min([-0.05, *(height - 0.05 for height in rows.values())])
    below = (96.0 if narrow else 62.0) + 9.0 * len(notes)
    listed = _LIST_ROW * len(chosen) + 6.0 if narrow else 0.0
    figure = make_figure(width, 72 * width * 0.6 * (1.05 - lowest) + below + listed + 16)
    axes = add_axes(figure, 46, below + listed, 36 if narrow else 182, 16)
    _draw_frame(axes, lowest, narrow)
    styles = method_styles([point.method for point in points])
    for point, place, style, named in zip(points, places, styles, shown, strict=True):
        if named:
            _draw_point(axes, point, *place, style)
        elif point.has_height:
            axes.plot(*place, marker="o", ms=3, mfc=INK, mec="none", zorder=3)
    anchors = np.array([places[i] for i in chosen])
    slanted = [points[i].method.reference for i in chosen]
    if narrow:
        order = np.lexsort((anchors[:, 0], -anchors[:, 1]))
        names = [texts[i].replace("\n", " ") for i in order]
        _list_names(figure, names, [points[i] for i in order], [styles[i] for i in order], listed)
        texts = [str(number) for number in 1 + np.argsort(order)]
    draw_captions(axes, anchors, texts, slanted)
    _draw_key(figure, axes, points, notes, listed + 4)
    return figure


def _draw_frame(axes: Axes, lowest: float, narrow: bool) -> None:
    axes.set(xlim=(-0.05, 1.05), ylim=(lowest, 1.05), xticks=np.linspace(0, 1, 6), yticks=np.linspace(0, 1, 6))
    axes.set_ylabel("randomness")
    for quality in _CONTOURS:
        axes.plot((quality, quality, 1.05), (1.05, quality, quality), color=FAINT, lw=0.6, zorder=0)
    if lowest < -0.05:
        axes.axhline(-0.05, color=INK, lw=0.7)
        axes.text(-0.03, -0.06, "randomness not scored", va="top", **SMALL)
    for height, words, side in () if narrow else ((0.965, "as a fresh draw", "top"), (0.035, "wallpaper", "bottom")):
        axes.text(1.04, height, words, ha="right", va=side, **SMALL)
    for x, words, side in ((0, "lost, broken or unlike", "left"), (1, "all perils avoided", "right")):
        axes.text(x, 1.02, words, ha=side, transform=axes.transAxes, style="italic", **SMALL)
    axes.tick_params(length=3, width=0.7)


def _sign(point: PerilsPoint, style: dict[str, Any]) -> dict[str, Any]:
    """Return the marker of a point: in the color of its method, or open, with that color around it for an upper bound.

    A point whose randomness is not scored is open, too.
    """
    bound = point.at_most and point.has_height
    fill = style["color"] if point.has_height and not point.at_most else "white"
    edge = {"mec": style["color"], "mew": 1.5} if bound else {"mec": INK, "mew": 0.6}
    return {"marker": style["marker"], "ms": _SIZE, "mfc": fill, **edge, "ls": "", "zorder": 3}


def _draw_point(axes: Axes, point: PerilsPoint, x: float, y: float, style: dict[str, Any]) -> None:
    bars: dict[str, Any] = {"color": style["color"], "lw": 0.9, "solid_capstyle": "butt", "zorder": 2}
    if (ends := point.structure.ends) is not None:
        axes.plot(ends, (y, y), **bars)
    if point.has_height and (ends := point.randomness.ends) is not None:
        axes.plot((x, x), ends, **bars)
    axes.plot(x, y, clip_on=False, **_sign(point, style))


def _list_names(
    figure: Figure,
    names: Sequence[str],
    points: Sequence[PerilsPoint],
    styles: Sequence[dict[str, Any]],
    top: float,
) -> None:
    """List the numbers, signs and names of points below a narrow plane; ``top`` in points from below."""
    width, height = 72 * figure.get_size_inches()
    for row, (name, point, style) in enumerate(zip(names, points, styles, strict=True)):
        y = (top - 4 - _LIST_ROW * row) / height
        figure.text(24 / width, y, str(row + 1), ha="right", va="top", fontsize=7, color=INK)
        sign = Line2D([32 / width], [y - 4 / height], transform=figure.transFigure, **_sign(point, style))
        figure.add_artist(sign)
        slant = "italic" if point.method.reference else "normal"
        figure.text(40 / width, y, name, va="top", fontsize=7, style=slant, color=INK)


def _draw_key(figure: Figure, axes: Axes, points: Sequence[PerilsPoint], notes: Sequence[str], bottom: float) -> None:
    narrow, height = figure.get_figwidth() < _NARROW, 72 * figure.get_figheight()
    axes.set_xlabel("elements in place, whole and alike:\nthe smallest of regularity, integrity and appearance")
    most = max(point.structure.n for point in points)
    signs = [("d", GRAY, "reference, not ranked")] if any(point.method.reference for point in points) else []
    if not all(point.has_height for point in points):
        signs.append(("o", "white", "not scored"))
    style: dict[str, Any] = {"ls": "", "ms": _SIZE - 1, "mec": INK, "mew": 0.8}
    handles = [Line2D([], [], marker=sign, mfc=fill, label=words, **style) for sign, fill, words in signs]
    if any(point.at_most and point.has_height for point in points):
        bound = {**style, "mec": GRAY, "mew": 1.5}
        handles.append(Line2D([], [], marker="o", mfc="white", label=f"{BOUND_SIGN} upper bound", **bound))
    handles.append(Line2D([], [], color=INK, lw=0.9, label=f"95 %, at most {most} textures"))
    handles.append(Line2D([], [], color=FAINT, lw=0.8, label="equal quality"))
    figure.legend(
        handles=handles,
        ncols=2 if narrow else min(5, len(handles)),
        loc="lower center",
        bbox_to_anchor=(0.5, (bottom + 9 * len(notes)) / height),
        frameon=False,
        fontsize=7,
        handlelength=1.1,
        handletextpad=0.5,
        columnspacing=1.1,
    )
    figure.text(0.5, bottom / height, "\n".join(notes), ha="center", va="bottom", linespacing=1.05, **SMALL)


def _footnotes(points: Sequence[PerilsPoint], shown: Sequence[bool]) -> list[str]:
    """Return the explanation of the brackets and signs that occur in the captions."""
    notes = []
    if any(point.rests_on for point in points):
        notes.append("[k of n]: the height rests on the k textures on which randomness is scored")
    if any(point.validity.n for point in points):
        notes.append(f"{BASELINE_SIGN} {BASELINE_LEGEND} ({SHARES_LEGEND})")
    return [*notes, describe_unnamed(shown)]


_SIDE = 17.0
"""Side of a field, pt."""
_DARK = 0.55
"""Fields of a lower quality have white marks."""
_NAME_LETTER = 4.6
"""Width of a letter of a name, pt."""


@Plotter
def plot_ranks(comparison: Comparison, width: float = 5.5) -> Figure:
    """Plot the mean quality of each ranked method, best first; bars at the right join those that do not differ.

    Parameters
    ----------
    comparison
        A comparison with :attr:`~nrbench.reports.statistics.method_comparison.Comparison.tests`.
    width
        Width in inches.
    """
    tests = comparison.tests
    assert tests is not None
    means = [one.means[RANKING] for one in comparison.summaries if one.rank]
    lines = [break_name(method.label, 26) for method in comparison.ranked]
    names = ["\n".join(each) + f"  {format_value(mean)}" for each, mean in zip(lines, means, strict=True)]
    left = 12 + _NAME_LETTER * max(len(line) for name in names for line in name.split("\n"))
    right = 12 + 7 * len(tests.cliques)
    figure = make_figure(width, 13 * len(names) * max(map(len, lines)) + 40)
    axes = add_axes(figure, left, 34, right, 6)
    open_frame(axes)
    for place, mean in enumerate(means):
        if mean.ends is not None:
            axes.plot(mean.ends, (place, place), color=INK, lw=0.9)
    axes.plot(
        np.array([one.value for one in means], np.float64), range(len(names)), "o", ms=4, color=INK, clip_on=False
    )
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.grid(True, axis="y", color=FAINT, lw=0.5)
    axes.set_xlabel(f"mean quality over {len(comparison.rows)} textures", loc="right")
    for place, clique in enumerate(tests.cliques):
        x = 1 + 7 * (place + 1) / (72 * width - left - right)
        style: Any = {"color": INK, "lw": 3, "solid_capstyle": "butt", "clip_on": False}
        axes.plot((x, x), clique, transform=axes.get_yaxis_transform(), **style)
    return figure


@Plotter
def plot_heat_map(comparison: Comparison) -> Figure:
    """Plot the heat map: methods across from the best, textures down from the hardest.

    The palette is ordered by lightness, so that it can be read without color. Each field has the mark of the verdict.
    """
    rows, scores = hardest_first(comparison)
    left = 12 + _NAME_LETTER * max(len(row.texture) for row in rows)
    above = 14 + 3.3 * max(len(method.label) for method in comparison.methods)
    height = above + _SIDE * max(len(rows), 7) + 8
    right = max(110.0, above)  # the names lie at 45 degrees
    figure = make_figure((left + _SIDE * len(comparison.methods) + right) / 72, height)
    axes = add_axes(figure, left, height - above - _SIDE * len(rows), right, above)
    fields = axes.pcolormesh(np.ma.masked_invalid(scores), cmap="cividis", vmin=0, vmax=1, edgecolors="white", lw=0.5)
    axes.invert_yaxis()
    axes.set_yticks(np.arange(len(rows)) + 0.5, [row.texture for row in rows])
    axes.xaxis.tick_top()
    labels = [method.label for method in comparison.methods]
    axes.set_xticks(np.arange(len(labels)) + 0.5, labels, rotation=45, rotation_mode="anchor", ha="left")
    for label, method in zip(axes.get_xticklabels(), comparison.methods, strict=True):
        label.set_fontstyle("italic" if method.reference else "normal")
    axes.tick_params(length=0, labelcolor=INK)
    axes.set_frame_on(False)
    for i, row in enumerate(rows):
        for j, entry in enumerate(row.entries):
            if entry is not None:
                ink = GRAY if not np.isfinite(scores[i, j]) else "#fefefe" if scores[i, j] < _DARK else "#010101"
                mark = {"N/A": "–"}.get(entry.mark, entry.mark)
                axes.text(j + 0.5, i + 0.5, mark, ha="center", va="center", color=ink)
    scale = add_axes(figure, left + _SIDE * len(labels) + 16, height - above - 100, right - 26, above)
    figure.colorbar(fields, cax=scale, ticks=(0, 0.5, 1)).set_label("quality")
    return figure


def hardest_first(comparison: Comparison) -> tuple[list[ComparisonRow], Floats]:
    """Return the textures from the lowest mean score, those without a score last, and the scores of all methods."""
    scores = np.array([[entry and entry.score for entry in row.entries] for row in comparison.rows], np.float64)
    order = np.argsort(mean_of_known(scores, 1), kind="stable")
    return [comparison.rows[i] for i in order], scores[order]


def timed_methods(comparison: Comparison) -> list[MethodSummary]:
    """Return the methods with a quality and a time."""
    scored = (one for one in comparison.summaries if RANKING in one.means)
    return [one for one in scored if one.means[RANKING].value is not None and one.means["seconds"].value]


@Plotter
def plot_cost(methods: Sequence[MethodSummary], width: float = 5.5) -> Figure:
    """Plot mean seconds across, logarithmic, and mean quality upwards, of some :func:`timed_methods`."""
    figure = make_figure(width, 72 * width * 0.62)
    axes = add_axes(figure, 46, 40, 150, 12)
    places = np.array([(one.means["seconds"].value, one.means[RANKING].value) for one in methods], float)
    axes.set_xscale("log")
    axes.set(ylim=(-0.03, 1.03), xlim=(places[:, 0].min() / 2, places[:, 0].max() * 2))
    axes.set_xlabel("seconds, mean over textures (better: left)")
    axes.set_ylabel("quality (better: up)")
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(True, color=FAINT, lw=0.5)
    axes.set_axisbelow(True)
    references = [one.method.reference for one in methods]
    named = choose_named(references)
    for one, (x, y), chosen, reference in zip(methods, places, named, references, strict=True):
        if (ends := one.means[RANKING].ends) is not None and chosen:
            axes.plot((x, x), ends, color=GRAY if reference else INK, lw=0.9, zorder=2)
        sign, size, fill = ("D", 5.0, FAINT) if reference else ("o", 6.4 if chosen else 3.0, INK)
        axes.plot(x, y, marker=sign, ms=size, mfc=fill, mec=INK, mew=0.8, zorder=3)
    shown = [one.method for one, chosen in zip(methods, named, strict=True) if chosen]
    names = [textwrap.fill(one.label, 26) for one in shown]
    draw_captions(axes, places[named], names, [one.reference for one in shown])
    figure.text(0.02, 3 / (72 * width * 0.62), describe_unnamed(named), **SMALL)
    return figure


_NARROWEST = 2.9
"""Smallest width of a panel, inches."""
_SPREAD = 0.07
"""Distance of the points of two series at one level, in levels, so that their intervals do not cover each other."""
_LINE: Any = {"lw": 1.1, "ms": 4.6, "mew": 0.5, "mec": "white", "clip_on": False}


@Plotter
def plot_levels(panels: Sequence[LevelPanel], width: float = 5.5) -> Figure:
    """Plot the quality by level, one panel for each difficulty.

    Parameters
    ----------
    panels
        At least one.
    width
        Width in inches. The number of columns follows from it.
    """
    columns = min(len(panels), max(1, int(width / _NARROWEST + 0.15)))
    rows = -(-len(panels) // columns)
    methods = [series.method for series in panels[0].series if series.method]
    styles = method_styles(methods)
    across = max(1, int(width / 1.7))
    figure = make_figure(width, 130 * rows + 11 * -(-len(methods) // across) + 24, layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, panel in zip(grid, panels, strict=False):
        axes.set(xlim=(-0.15, len(panel.levels) - 0.85), ylim=(-0.04, 1.04), yticks=(0, BROKEN, 1), ylabel="quality")
        axes.set_title(panel.departure, loc="left", fontsize=8)
        axes.axhline(BROKEN, color=FAINT, lw=0.6, zorder=0)
        for series, style in zip(panel.series, styles, strict=True):
            _draw_line(axes, panel.levels, series.levels, series.estimates, style)
    for axes in grid[len(panels) :]:
        axes.remove()
    figure.legend(
        handles=[Line2D([], [], **_LINE, **style) for style in styles],
        title=f"Below the gray line at {BROKEN:g} a method breaks. References are gray.",
        loc="outside lower center",
        ncols=across,
        frameon=False,
        fontsize=7,
        title_fontsize=7,
    )
    return figure


def method_styles(methods: Sequence[Method]) -> list[dict[str, Any]]:
    """Return the label, the color, the sign and the dashes of each method; references are gray.

    The first 64 methods differ in color or sign.
    """
    styles = []
    for index, method in enumerate(methods):
        place = sum(other.reference == method.reference for other in methods[:index])
        signs = "d<>p" if method.reference else SIGNS
        turn, first = divmod(place, len(signs))
        color = GRAY if method.reference else COLORS[place % len(COLORS)]
        style = {"color": color, "marker": signs[(first + turn) % len(signs)], "ls": "--" if turn else "-"}
        styles.append({"label": method.label, **style, "zorder": 2 if method.reference else 3})
    return styles


def _draw_line(
    axes: Axes,
    levels: Sequence[float],
    shown_levels: Sequence[float],
    estimates: Sequence[Estimate],
    style: dict[str, Any],
    shift: float = 0.0,
    bars: bool = False,
) -> None:
    """Draw the estimates of one series at its levels of the series."""
    open_frame(axes)
    axes.set_xticks(range(len(levels)), [f"{level:g}" for level in levels])
    pairs = zip(shown_levels, estimates, strict=True)
    known = [(levels.index(level) + shift, one.value, one.ends) for level, one in pairs if one.value is not None]
    if known:
        axes.plot([place for place, _, _ in known], [value for _, value, _ in known], **_LINE, **style)
    for place, _, ends in known:
        if bars and ends:
            axes.plot([place, place], ends, color=style["color"], lw=0.8, zorder=1)


@Plotter
def plot_claim(result: ClaimResult) -> Figure:
    """Plot the panel of a claim.

    All levels of all series lie at equal distances, in the order of their numbers. The scale of the scores shows 0, and
    1 if it is the best or the highest value.
    """
    figure = make_figure(4.3, 150)
    axes = add_axes(figure, 34, 30, 102, 9)
    levels = sorted({level for series in result.series for level in series.levels})
    for i, series in enumerate(result.series):
        shift = _SPREAD * (i - (len(result.series) - 1) / 2)
        style = {"color": COLORS[i % len(COLORS)], "marker": SIGNS[i % len(SIGNS)], "label": series.name}
        _draw_line(axes, levels, series.levels, series.estimates, style, shift, bars=True)
    axes.set_xlim(-0.3, len(levels) - 0.7)
    low, high = axes.get_ylim()
    column = result.column
    shows_one = column is None or column.better == "one" or column.range[1] == 1
    high = max(high, 1.04 if shows_one else 0.0)
    axes.set_ylim(min(low, -0.04 * high), high)
    axes.set_xlabel(result.claim.axis, labelpad=2)
    axes.set_ylabel(result.score_with_unit, labelpad=2)
    axes.axhline(0, color=FAINT, lw=0.6, zorder=0)
    axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, fontsize=7)
    return figure


_CAPTION_LINE = 8.6
"""Height of a line of a caption, pt."""
MOST_NAMES = 20
"""Most points of a plot that have names; names of more would be too small to read."""
_GUTTER = 20.0


def choose_named(references: Sequence[bool]) -> list[bool]:
    """Return which points of a plot have names: the references and the first others, :data:`MOST_NAMES` in total."""
    left = MOST_NAMES - sum(references)
    return [reference or sum(not one for one in references[:i]) < left for i, reference in enumerate(references)]


def describe_unnamed(named: Sequence[bool]) -> str:
    """Return the sentence that explains points without names; empty if all points have one."""
    rest = len(named) - sum(named)
    if not rest:
        return ""
    return f"The best methods and the references have names and intervals; {rest} further methods have neither."


def draw_captions(axes: Axes, anchors: Floats, texts: Sequence[str], slanted: Sequence[bool]) -> None:
    """Draw a caption for each point, in a column at the right of the axes, with a leader.

    A leader goes from its point straight to the right edge, and from there to the caption. The captions have the order
    of the heights of the points, so leaders do not cross.

    Parameters
    ----------
    axes
        The plot. Its figure has 72 dots an inch.
    anchors
        ``(n, 2)``: the points, in the units of the axes.
    texts
        The captions; a caption may have several lines.
    slanted
        Whether a caption is italic.
    """
    frame, back = axes.get_window_extent(), axes.transAxes.inverted()
    heights = np.array([(text.count("\n") + 1) * _CAPTION_LINE + 3.0 for text in texts])
    shrink = min(1.0, (frame.height + 2 * _CAPTION_LINE) / heights.sum())
    points = axes.transData.transform(anchors)
    order = np.lexsort((points[:, 0], -points[:, 1]))
    sorted_heights = heights[order] * shrink
    gaps = (sorted_heights[:-1] + sorted_heights[1:]) / 2
    places = spread(points[order, 1], gaps, (frame.y0 - _CAPTION_LINE, frame.y1 + _CAPTION_LINE))
    for index, place in zip(order, places, strict=True):
        x, y = points[index]
        line = back.transform([(x, y), (frame.x1 + 3, y), (frame.x1 + _GUTTER - 2, place)])
        axes.plot(*line.T, color=GRAY, lw=0.45, zorder=1, transform=axes.transAxes, clip_on=False)
        left, middle = back.transform((frame.x1 + _GUTTER, place))
        axes.text(
            left,
            middle,
            texts[index],
            transform=axes.transAxes,
            va="center",
            color=INK,
            fontsize=7 * shrink,
            linespacing=1.05,
            style="italic" if slanted[index] else "normal",
        )


def spread(heights: Floats, gaps: Floats, limits: tuple[float, float] = (-np.inf, np.inf)) -> Floats:
    """Return the places nearest to falling ``heights`` that lie at least ``gaps`` apart, within limits if they fit."""
    below = np.concatenate([[0.0], np.cumsum(gaps)])
    level = np.asarray(isotonic_regression(heights + below, increasing=False).x, np.float64)
    within: Floats = np.minimum(np.maximum(level, limits[0] + below[-1]), limits[1]) - below
    return within
