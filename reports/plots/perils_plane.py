"""Plot the perils plane: elements in place, whole and alike against randomness, one point for each method."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..statistics.summaries import PerilsPoint
from ..statistics.verdicts import BASELINE_LEGEND, BASELINE_SIGN, SHARES_LEGEND
from .captions import choose_named, describe_unnamed, draw_captions
from .figure_file import FAINT, GRAY, INK, SMALL, add_axes, make_figure, returns_file

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


@returns_file
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
    for point, place, named in zip(points, places, shown, strict=True):
        if named:
            _draw_point(axes, point, *place)
        elif point.has_height:
            axes.plot(*place, marker="o", ms=3, mfc=INK, mec="none", zorder=3)
    anchors = np.array([places[i] for i in chosen])
    slanted = [points[i].method.reference for i in chosen]
    if narrow:
        order = np.lexsort((anchors[:, 0], -anchors[:, 1]))
        _list_names(figure, [(texts[i].replace("\n", " "), slanted[i]) for i in order], listed)
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
    for x, words, side in ((0, "lattice lost, broken or unlike", "left"), (1, "all perils avoided", "right")):
        axes.text(x, 1.02, words, ha=side, transform=axes.transAxes, style="italic", **SMALL)
    axes.tick_params(length=3, width=0.7)


def _draw_point(axes: Axes, point: PerilsPoint, x: float, y: float) -> None:
    reference = point.method.reference
    bars: dict[str, Any] = {"color": GRAY if reference else INK, "lw": 0.9, "solid_capstyle": "butt", "zorder": 2}
    if (ends := point.structure.ends) is not None:
        axes.plot(ends, (y, y), **bars)
    if point.has_height and (ends := point.randomness.ends) is not None:
        axes.plot((x, x), ends, **bars)
    fill = (FAINT if reference else INK) if point.has_height else "white"
    sign, size = ("D", _SIZE - 1.4) if reference else ("o", _SIZE)
    axes.plot(x, y, marker=sign, ms=size, mfc=fill, mec=INK, mew=0.8, zorder=3, clip_on=False)


def _list_names(figure: Figure, names: Sequence[tuple[str, bool]], top: float) -> None:
    """List the names of numbered points below a narrow plane; ``top`` in points from below."""
    width, height = 72 * figure.get_size_inches()
    for row, (name, slanted) in enumerate(names):
        y = (top - 4 - _LIST_ROW * row) / height
        figure.text(30 / width, y, str(row + 1), ha="right", va="top", fontsize=7, color=INK)
        style = "italic" if slanted else "normal"
        figure.text(36 / width, y, name, va="top", fontsize=7, style=style, color=INK)


def _draw_key(figure: Figure, axes: Axes, points: Sequence[PerilsPoint], notes: Sequence[str], bottom: float) -> None:
    narrow, height = figure.get_figwidth() < _NARROW, 72 * figure.get_figheight()
    axes.set_xlabel("elements in place, whole and alike:\nthe smallest of regularity, integrity and appearance")
    most = max(point.structure.n for point in points)
    signs = [("o", INK, "method"), ("D", FAINT, "reference, not ranked")]
    if not all(point.has_height for point in points):
        signs.append(("o", "white", "not scored"))
    style: dict[str, Any] = {"ls": "", "ms": _SIZE - 1, "mec": INK, "mew": 0.8}
    handles = [Line2D([], [], marker=sign, mfc=fill, label=words, **style) for sign, fill, words in signs]
    handles.append(Line2D([], [], color=INK, lw=0.9, label=f"95 %, at most {most} textures"))
    handles.append(Line2D([], [], color=FAINT, lw=0.8, label="equal quality"))
    figure.legend(
        handles=handles,
        ncols=2 if narrow else 5,
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
