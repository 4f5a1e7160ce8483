"""Plot quality against the time of the synthesis."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from ..statistics.method_comparison import Comparison
from ..statistics.summaries import MethodSummary
from ..statistics.verdicts import RANKING
from .captions import choose_named, describe_unnamed, draw_captions
from .figure_file import FAINT, GRAY, INK, SMALL, add_axes, make_figure, render_figure


def has_cost(comparison: Comparison) -> bool:
    """Return whether any method has a quality and a time."""
    return bool(_known(comparison))


def plot_cost(comparison: Comparison, kind: str = "svg", width: float = 5.5) -> bytes:
    """Return the plot as a file of a kind: mean seconds across, logarithmic, and mean quality upwards."""
    return render_figure(partial(_figure, comparison, width), kind)


def _known(comparison: Comparison) -> list[MethodSummary]:
    scored = (one for one in comparison.summaries if RANKING in one.means)
    return [one for one in scored if one.means[RANKING].value is not None and one.means["seconds"].value]


def _figure(comparison: Comparison, width: float) -> Figure:
    methods = _known(comparison)
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
    shown = [methods[i].method for i in np.flatnonzero(named)]
    draw_captions(axes, places[named], [one.label for one in shown], [one.reference for one in shown])
    figure.text(0.02, 3 / (72 * width * 0.62), describe_unnamed(named), **SMALL)
    return figure
