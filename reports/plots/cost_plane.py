"""Plot quality against the time of the synthesis."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from ..statistics.comparison import Comparison, MethodSummary
from ..statistics.verdicts import RANKING
from .captions import choose_named, describe_unnamed, draw_captions
from .figure_file import FAINT, GRAY, INK, SMALL, make_figure, render_figure


def has_cost(comparison: Comparison) -> bool:
    """Return whether any method has a quality and a time."""
    return bool(_known(comparison))


def plot_cost(comparison: Comparison, kind: str = "svg", width: float = 5.5) -> bytes:
    """Return the plot as a file of a kind: mean seconds across, logarithmic, and mean quality upwards."""
    return render_figure(partial(_figure, comparison, width), kind)


def _known(comparison: Comparison) -> list[MethodSummary]:
    def complete(one: MethodSummary) -> bool:
        return bool(RANKING in one.means and one.means[RANKING].value is not None and one.means["seconds"].value)

    return [one for one in comparison.summaries if complete(one)]


def _figure(comparison: Comparison, width: float) -> Figure:
    methods = _known(comparison)
    height = 72 * width * 0.62
    figure = make_figure(width, height)
    axes = figure.add_axes((46 / (72 * width), 40 / height, 1 - 196 / (72 * width), 1 - 52 / height))
    x = np.array([float(one.means["seconds"].value or 1) for one in methods])
    y = np.array([float(one.means[RANKING].value or 0) for one in methods])
    axes.set_xscale("log")
    axes.set(ylim=(-0.03, 1.03), xlim=(x.min() / 2, x.max() * 2))
    axes.set_xlabel("seconds for one output, mean over textures (better: left)")
    axes.set_ylabel("quality (better: up)")
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(True, color=FAINT, lw=0.5)
    axes.set_axisbelow(True)
    named = choose_named([one.method.reference for one in methods])
    for one, across, up, chosen in zip(methods, x, y, named, strict=True):
        reference, ends = one.method.reference, one.means[RANKING].ends
        if ends is not None and chosen:
            axes.plot((across, across), ends, color=GRAY if reference else INK, lw=0.9, zorder=2)
        axes.plot(
            *(across, up),
            marker="D" if reference else "o",
            ms=5 if reference else 6.4 if chosen else 3,
            mfc=FAINT if reference else INK,
            mec=INK,
            mew=0.8,
            zorder=3,
        )
    places = np.flatnonzero(named)
    points = axes.transData.transform(np.stack([x, y], 1))[places]
    shown = [methods[i].method for i in places]
    draw_captions(axes, points, [method.label for method in shown], [method.reference for method in shown])
    if note := describe_unnamed(named):
        figure.text(0.02, 3 / height, note, **SMALL)
    return figure
