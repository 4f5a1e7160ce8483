"""Diagnostics as pictures, and a lattice by three clicks on a canvas that no window shows."""

from __future__ import annotations

import matplotlib
import numpy as np
import pytest
from matplotlib.backend_bases import CloseEvent, KeyEvent, MouseEvent
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from nrbench.cli.lattice_figures import diagram, lattice_of, pick_in
from nrbench.errors import BadInput
from nrbench.lattice.geometry import Lattice
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


CLICKS = ((10, 10), (30, 12), (12, 35))


class Hand(FigureCanvasAgg):
    """A user before a figure, who clicks points (x, y) px of the image and presses keys."""

    def __init__(self, *actions: tuple[float, float] | str) -> None:
        super().__init__(Figure(figsize=(6, 6)))
        self.actions, self.titles, self.pictures = iter(actions), list[str](), list[np.ndarray]()

    def flush_events(self) -> None:
        """Do the next thing; the loop that waits for events calls this."""
        axes, action = self.figure.axes[0], next(self.actions)
        self.titles.append(axes.get_title())
        self.pictures.append(np.asarray(axes.images[0].get_array()).copy())
        self.draw()
        if action == "close":
            self.callbacks.process("close_event", CloseEvent("close_event", self))
        elif isinstance(action, str):
            self.callbacks.process("key_press_event", KeyEvent("key_press_event", self, action))
        else:
            x, y = axes.transData.transform(action)
            self.callbacks.process("button_press_event", MouseEvent("button_press_event", self, x, y, button=1))

    def pick(self) -> Lattice:
        """Return the lattice."""
        return pick_in(self.figure, IMAGE)


def test_three_points_are_origin_and_ends() -> None:
    """The first point is the origin, the others are the ends of t1 and t2."""
    lattice = lattice_of([(10.0, 5.0), (42.0, 6.0), (11.0, 29.0)])
    assert (lattice.t1, lattice.t2, lattice.origin) == ((32.0, 1.0), (1.0, 24.0), (10.0, 5.0))
    with pytest.raises(BadInput, match="parallel"):
        lattice_of([(0.0, 0.0), (8.0, 8.0), (16.0, 16.0)])


@pytest.mark.parametrize(
    "before",
    [
        (),
        ((50, 10), "backspace"),
        ((-500, 10),),
        (*CLICKS, (40, 40)),
        ((10, 10), (20, 10), (40, 10)),
    ],
    ids=["at once", "backspace", "beside the image", "again", "one line"],
)
def test_clicks_give_the_lattice_and_a_key_accepts(before: tuple[tuple[float, float] | str, ...]) -> None:
    """Three clicks give the lattice in px, and a key accepts it.

    Backspace takes a point back, a click beside the image is none, a fourth click or points on one line begin again.
    """
    lattice = Hand(*before, *CLICKS, "enter").pick()
    np.testing.assert_allclose(lattice.matrix, [(20, 2), (2, 25)], atol=1e-9)


def test_the_lattice_is_drawn_over_the_image() -> None:
    """With the third point the picture changes, along the lattice's lines only, and the title names what follows."""
    hand = Hand((10, 10), (30, 10), (10, 35), "enter")
    hand.pick()
    changed = (hand.pictures[3] != hand.pictures[2]).any(-1)
    assert changed[10, 10] and changed[10, 20] and changed[20, 30] and not changed[20, 20]
    assert "t2" in hand.titles[0] and "accepts" in hand.titles[3]


@pytest.mark.parametrize("actions", [("escape",), ("close",), ((10, 10), "enter"), (*CLICKS, "close")])
def test_the_choice_can_be_cancelled(actions: tuple[tuple[float, float] | str, ...]) -> None:
    """Escape and Enter before the third point, and closing the window at any time, cancel."""
    with pytest.raises(BadInput, match="cancelled"):
        Hand(*actions).pick()
