"""A lattice by three clicks in a window."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.backend_bases import Event, KeyEvent, MouseButton, MouseEvent
from matplotlib.figure import Figure

from nrbench.errors import BadInput
from nrbench.imaging.convert import Image
from nrbench.imaging.overlay import overlay
from nrbench.lattice.geometry import Lattice, Vector

STEPS = (
    "click a corner of a tile, or any point that you will know again",
    "click the same point of the next tile: the end of t1",
    "click it in the next tile another way: the end of t2",
)
MARKS = "cyan"
DONE = "Enter accepts, Backspace takes back a point, Escape cancels"


def lattice_of(points: Sequence[Vector]) -> Lattice:
    """Return the lattice of three points (x, y) px: its origin, the end of t1, the end of t2.

    Raises
    ------
    BadInput
        When they lie on one line.
    """
    (x, y), (x1, y1), (x2, y2) = points
    return Lattice((x1 - x, y1 - y), (x2 - x, y2 - y), (x, y))


class Picker:
    """Three points, clicked in a figure: the lattice that they span is drawn until it is accepted or cancelled.

    Parameters
    ----------
    figure
        Where to show the image; its canvas' events are listened to.
    image
        The texture.
    """

    def __init__(self, figure: Figure, image: Image) -> None:
        self.lattice: Lattice | None = None
        self.accepted = False
        self._image, self._points, self._problem = image, list[Vector](), ""
        self._figure, self._axes = figure, figure.add_axes((0.02, 0.02, 0.96, 0.88))
        self._axes.axis("off")
        shown = np.repeat(image, 3, axis=2) if image.shape[2] == 1 else image
        self._picture = self._axes.imshow(shown, interpolation="nearest")
        (self._marks,) = self._axes.plot([], [], "+-", color=MARKS, ms=14, mew=2, lw=1)
        figure.canvas.mpl_connect("button_press_event", self._click)
        figure.canvas.mpl_connect("key_press_event", self._press)
        self._show()

    def _click(self, event: Event) -> None:
        assert isinstance(event, MouseEvent)
        busy = getattr(getattr(self._figure.canvas, "toolbar", None), "mode", "")
        if event.inaxes is not self._axes or event.button != MouseButton.LEFT or busy or len(self._points) == 3:
            return
        assert event.xdata is not None and event.ydata is not None
        self._points.append((float(event.xdata), float(event.ydata)))
        self._update()

    def _press(self, event: Event) -> None:
        assert isinstance(event, KeyEvent)
        if event.key in ("enter", "escape"):
            if event.key == "enter" and self.lattice is None:
                return
            self.accepted = event.key == "enter"
            plt.close(self._figure)
        elif event.key == "backspace" and self._points:
            self._points.pop()
            self._update()

    def _update(self) -> None:
        self.lattice, self._problem = None, ""
        if len(self._points) == 3:
            try:
                self.lattice = lattice_of(self._points)
            except BadInput:
                self._points.pop()
                self._problem = "these three lie on one line; "
        self._show()

    def _show(self) -> None:
        title = DONE if self.lattice else f"{len(self._points) + 1} of 3: {self._problem}{STEPS[len(self._points)]}"
        self._axes.set_title(title, fontsize=10)
        drawn = overlay(self._image, self.lattice) if self.lattice else self._image
        self._picture.set_data(np.repeat(drawn, 3, axis=2) if drawn.shape[2] == 1 else drawn)
        order = [1, 0, 2] if len(self._points) == 3 else range(len(self._points))
        self._marks.set_data(*np.reshape([self._points[i] for i in order], (-1, 2)).T)
        self._figure.canvas.draw_idle()


def pick(image: Image) -> Lattice:
    """Open a window, and return the lattice that the user clicks and accepts.

    Raises
    ------
    BadInput
        Where no window can be opened, or the user cancels.
    """
    try:
        figure = plt.figure("nrbench lattice --pick", figsize=(9, 9))
    except Exception as error:  # a toolkit's own complaint: no display, no such module
        raise _no_window(str(error)) from error
    if getattr(figure.canvas, "required_interactive_framework", None) is None:
        plt.close(figure)
        raise _no_window(f"matplotlib's backend is {plt.get_backend()}")
    handler = getattr(figure.canvas.manager, "key_press_handler_id", None)
    if handler is not None:
        figure.canvas.mpl_disconnect(handler)
    picker = Picker(figure, image)
    plt.show(block=True)
    if picker.lattice is None or not picker.accepted:
        raise BadInput("--pick: cancelled, no lattice was picked")
    return picker.lattice


def _no_window(why: str) -> BadInput:
    return BadInput(
        f"--pick: no window can be opened ({why}); it needs a display and a toolkit such as Tk or Qt: without one, "
        "read the points in any viewer and pass --lattice x1,y1,x2,y2"
    )
