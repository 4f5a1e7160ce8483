"""Diagnostics as pictures."""

import numpy as np
from matplotlib.figure import Figure

from nrbench.cli.lattice_detection import diagram
from nrbench.plugins.forms import Curve, Surface

PEAKS = np.array([(3.0, -4.0), (6.0, 2.0)])
SURFACE = Surface(np.random.default_rng(0).random((21, 11)), (0, 10), PEAKS, np.array([(3.0, -4.0), (-6.0, -2.0)]))
CURVE = Curve(np.arange(5.0), np.arange(5.0) ** 2, (2.5,), "lag in px")


def drawn(diagnostics: dict[str, object], title: str = "") -> Figure:
    """Return the figure of some diagnostics."""
    figure = diagram(diagnostics, title)
    assert figure is not None
    return figure


def test_every_surface_and_curve_has_a_panel() -> None:
    """One panel a diagnostic that can be drawn, titled by its name; numbers stand below, the rest is left out."""
    figure = drawn({"a": SURFACE, "goodness": 0.125, "raw": np.zeros(3), "b": CURVE}, "title")
    assert [axes.get_title() for axes in figure.axes if axes.get_title()] == ["a", "b"]
    assert figure.get_supxlabel() == "goodness 0.125" and figure.get_suptitle() == "title"


def test_a_surface_counts_from_its_zero() -> None:
    """The picture's coordinates are lags: candidates lie where they are given, the edges half a sample outside."""
    axes = drawn({"a": SURFACE}).axes[0]
    assert tuple(axes.images[0].get_extent()) == (-0.5, 10.5, 10.5, -10.5)
    np.testing.assert_array_equal(np.column_stack(axes.lines[0].get_data()), PEAKS)
