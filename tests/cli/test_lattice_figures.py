"""Diagnostics as pictures, and a lattice by three clicks on a canvas that no window shows."""

from __future__ import annotations

import matplotlib
import numpy as np
import pytest
from matplotlib.backend_bases import KeyEvent, MouseEvent
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from nrbench.cli.lattice_figures import Picker, diagram, lattice_of
from nrbench.errors import BadInput
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


def test_a_vector_outside_is_drawn_as_its_negative() -> None:
    """A right half holds -v where it does not hold v."""
    figure = drawn({"a": SURFACE})
    tips = [text.xy for text in figure.axes[0].texts]
    np.testing.assert_array_equal(tips, [(3, -4), (6, 2)])


def test_a_curve_shows_its_marks() -> None:
    """Each mark is a vertical line with its value, and the axis says what it is."""
    axes = drawn({"b": CURVE}).axes[0]
    assert axes.get_xlabel() == "lag in px" and list(axes.lines[1].get_xdata()) == [2.5, 2.5]
    assert [text.get_text() for text in axes.texts] == ["2.5"]


def test_nothing_to_draw() -> None:
    """Numbers alone make no figure."""
    assert diagram({"goodness": 1.0}) is None


def test_no_global_state() -> None:
    """Drawing leaves matplotlib's settings and its list of figures alone."""
    from matplotlib._pylab_helpers import Gcf

    before = dict(matplotlib.rcParams)
    diagram({"a": SURFACE, "b": CURVE})
    assert dict(matplotlib.rcParams) == before and not Gcf.get_all_fig_managers()


IMAGE = np.random.default_rng(0).random((60, 80, 1), np.float32)


class Hand:
    """A user before a figure."""

    def __init__(self, *clicked: tuple[float, float]) -> None:
        self.figure = Figure(figsize=(6, 6))
        self.canvas = FigureCanvasAgg(self.figure)
        self.picker = Picker(self.figure, IMAGE)
        self.canvas.draw()
        for x, y in clicked:
            self.click(x, y)

    def click(self, x: float, y: float, button: int = 1) -> None:
        """Click on a point of the image, px."""
        left, top = self.figure.axes[0].transData.transform((x, y))
        event = MouseEvent("button_press_event", self.canvas, left, top, button=button)
        self.canvas.callbacks.process("button_press_event", event)

    def press(self, key: str) -> None:
        """Press a key."""
        self.canvas.callbacks.process("key_press_event", KeyEvent("key_press_event", self.canvas, key))

    @property
    def title(self) -> str:
        """What the figure says."""
        return self.figure.axes[0].get_title()


def test_three_points_are_origin_and_ends() -> None:
    """The first point is the origin, the others are the ends of t1 and t2."""
    lattice = lattice_of([(10.0, 5.0), (42.0, 6.0), (11.0, 29.0)])
    assert (lattice.t1, lattice.t2, lattice.origin) == ((32.0, 1.0), (1.0, 24.0), (10.0, 5.0))
    with pytest.raises(BadInput, match="parallel"):
        lattice_of([(0.0, 0.0), (8.0, 8.0), (16.0, 16.0)])


@pytest.mark.parametrize("key", ["enter", "escape"])
def test_clicks_give_the_lattice_and_enter_accepts(key: str) -> None:
    """Three left clicks give the lattice in px, Enter accepts it, Escape does not; a fourth click changes nothing."""
    hand = Hand((10, 10), (30, 12), (12, 35), (70, 50))
    hand.press(key)
    assert hand.picker.lattice is not None and hand.picker.accepted == (key == "enter")
    np.testing.assert_allclose(hand.picker.lattice.matrix, [(20, 2), (2, 25)], atol=1e-9)


def test_the_lattice_is_drawn_over_the_image() -> None:
    """With the third point the shown picture changes, along the lattice's lines only."""
    hand = Hand()
    before = np.asarray(hand.figure.axes[0].images[0].get_array()).copy()
    for point in ((10, 10), (30, 10), (10, 35)):
        hand.click(*point)
    changed = (np.asarray(hand.figure.axes[0].images[0].get_array()) != before).any(-1)
    assert changed[10, 10] and changed[10, 20] and changed[20, 30] and not changed[20, 20]


def test_backspace_takes_a_point_back() -> None:
    """After Backspace the third point may be clicked again."""
    hand = Hand((10, 10), (30, 12), (12, 35))
    hand.press("backspace")
    assert hand.picker.lattice is None and "t2" in hand.title
    hand.click(14, 40)
    assert hand.picker.lattice is not None and hand.picker.lattice.t2 == pytest.approx((4, 30))


def test_points_on_one_line_are_not_taken() -> None:
    """A third point on the line of the first two is refused, and the title says why."""
    hand = Hand((10, 10), (20, 10), (40, 10))
    assert hand.picker.lattice is None and "on one line" in hand.title
    hand.click(10, 40)
    assert hand.picker.lattice is not None


def test_what_does_not_count() -> None:
    """Other buttons, clicks beside the image, and Enter before the third point do nothing."""
    hand = Hand()
    hand.click(10, 10, button=3)
    hand.click(-500, 10)
    hand.press("enter")
    assert "1 of 3" in hand.title and not hand.picker.accepted
