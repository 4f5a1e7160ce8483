"""How far a run is: the cells done, and the time that the rest will take."""

from __future__ import annotations

import signal
import threading
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import FrameType

from nrbench.errors import strip_control
from nrbench.runs.store import FAILED
from nrbench.suites.cell import Cell


@dataclass(frozen=True)
class Step:
    """A cell that has ended.

    Parameters
    ----------
    done, total
        Number of cells that have ended, this one included, and of all.
    cached, failed
        How many of those that have ended had their results on disk, and how many failed.
    texture, method, lattice_source
        What the cell is.
    status
        How it ended.
    remaining
        Estimated wall seconds until the run ends; None before a cell has been run.
    """

    done: int
    total: int
    cached: int
    failed: int
    texture: str
    method: str
    lattice_source: str
    status: str
    remaining: float | None = None

    @property
    def text(self) -> str:
        """The cell and its status in words."""
        return strip_control(f"{self.texture} / {self.method} ({self.lattice_source}): {self.status}")

    @property
    def remaining_text(self) -> str:
        """The time until the run ends, rounded, in words; empty if it is unknown or none is left."""
        if self.remaining is None or self.done == self.total:
            return ""
        seconds = max(1, round(self.remaining))
        if seconds < 100:
            return f"about {seconds} s left"
        return f"about {round(seconds / 60)} min left" if seconds < 6000 else f"about {round(seconds / 3600)} h left"


Progress = Callable[[Step], None]
"""Called after each cell."""


@dataclass
class Pace:
    """Counts the cells of a run, and estimates the time that the others will take.

    Parameters
    ----------
    cells
        All cells of the run.
    """

    cells: list[Cell]
    _seconds: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    _counts: Counter[str] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        self._left = Counter(cell.label for cell in self.cells)

    def step(self, cell: Cell, status: str, seconds: float | None, slots: int) -> Step:
        """Count a cell that has ended.

        Parameters
        ----------
        cell, status
            The cell, and how it ended.
        seconds
            The wall seconds that it took; None if it was cached.
        slots
            Number of cells that run at the same time, at present.
        """
        self._left[cell.label] -= 1
        self._counts.update(done=1, cached=int(seconds is None), failed=int(status in FAILED))
        if seconds is not None:
            self._seconds[cell.label].append(seconds)
        counts = {name: self._counts[name] for name in ("done", "cached", "failed")}
        what = (cell.texture, cell.label, cell.lattice_source, status)
        return Step(counts["done"], len(self.cells), counts["cached"], counts["failed"], *what, self._remaining(slots))

    def _remaining(self, slots: int) -> float | None:
        """Return the seconds left: each method's mean for its own cells, the mean of all for an unknown method."""
        if not self._seconds:
            return None
        means = {label: sum(times) / len(times) for label, times in self._seconds.items()}
        usual = sum(means.values()) / len(means)
        total = sum(count * means.get(label, usual) for label, count in self._left.items())
        return total / max(1, min(slots, sum(self._left.values())))


@contextmanager
def first_interrupt(tell: Callable[[], None]) -> Iterator[threading.Event]:
    """Yield an event that the first interrupt (Ctrl-C) sets; the second one raises KeyboardInterrupt.

    Outside the main thread, where no signal can be caught, and in a process that ignores interrupts, the event stays
    unset.

    Parameters
    ----------
    tell
        Called at the first interrupt.
    """
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        yield stop
        return

    def handle(number: int, frame: FrameType | None) -> None:
        signal.signal(signal.SIGINT, before)
        stop.set()
        tell()

    before = signal.signal(signal.SIGINT, handle)
    try:
        yield stop
    finally:
        signal.signal(signal.SIGINT, before)
