"""The forms of plugins: what a texture, a detection, a synthesis, an observation and a score are."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice, Points

Kind = Literal["0", "I", "II", "III", "stochastic"]
Shape = tuple[int, int]
"""(height, width) in px."""
Region = tuple[int, int, int, int]
"""(x0, y0, x1, y1) in px of the picture that a crop was cut from, half-open."""


@dataclass(frozen=True)
class Texture:
    """An image, and the truth about it.

    Parameters
    ----------
    image
        The pixels, :data:`~nrbench.imaging.convert.Image`.
    lattice
        The smallest lattice of the ideal image, origin included; None where there is none or it is not known.
    lattices
        All lattices, where a texture has several (``lattice`` first).
    name, family
        For tables: the suite's row, and the group of rows it belongs to.
    kind
        ``"0"`` perfectly regular, ``"I"`` regular geometry with varying color, ``"II"`` varying geometry with regular
        color, ``"III"`` both vary, ``"stochastic"`` no lattice; None where it is not known (photographs).
    ideal
        The periodic image, shape of ``image``: the mean over the model's draws at this lattice and phase, of undamaged
        elements in their places; None unless the model is known.
    displacement
        ``float32 (H, W, 2)``: how far, (x, y) px, the content at each pixel has moved
        from its ideal place; None: not at all.
    elements
        Departures of each element (brick, thread, tile) by name, one array each whose first axis counts elements.
    regular_share
        Variance of the mean over draws (the ideal image, but for damage and displacements) over mean total variance,
        in [0, 1]; None where it is not known.
    region
        Where a photograph's crop was cut; None for models.
    """

    image: Image
    lattice: Lattice | None = None
    lattices: tuple[Lattice, ...] = ()
    name: str = ""
    family: str = ""
    kind: Kind | None = None
    ideal: Image | None = None
    displacement: NDArray[np.float32] | None = None
    elements: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    regular_share: float | None = None
    region: Region | None = None


@runtime_checkable
class Dataset(Protocol):
    """The form of a dataset plugin: a frozen dataclass with these two methods."""

    def render(self, shape: Shape, rng: np.random.Generator) -> Texture:
        """Return a texture of ``shape``: lattice phase and departures drawn from ``rng``."""
        ...

    def again(self, texture: Texture, shape: Shape, rng: np.random.Generator) -> Texture | None:
        """Return an independent draw: same model and lattice, origin included, fresh departures.

        For a photograph, a region of ``shape`` disjoint from ``texture.region``. None where there is none.
        """
        ...


@dataclass(frozen=True)
class Surface:
    """A diagnostic that is drawn as a picture: a correlation, a spectrum.

    Parameters
    ----------
    values
        ``(H, W)``.
    zero
        (x, y) index of the sample at the coordinates' origin (lag 0, frequency 0).
    peaks
        ``(n, 2)``: the candidates, (x, y) in samples from ``zero``.
    vectors
        ``(2, 2)``, rows (x, y) in samples from ``zero``: the pair that was chosen; None where there is none.
    """

    values: NDArray[np.floating[Any]]
    zero: tuple[int, int]
    peaks: Points
    vectors: Points | None = None


@dataclass(frozen=True)
class Curve:
    """A diagnostic that is drawn as a line: a one-dimensional search.

    Parameters
    ----------
    x, y
        ``(n,)`` each.
    marks
        The x that were chosen.
    label
        What x is, with its unit.
    """

    x: NDArray[np.floating[Any]]
    y: NDArray[np.floating[Any]]
    marks: tuple[float, ...] = ()
    label: str = ""


@dataclass(frozen=True)
class Detection:
    """A lattice found in an image.

    Parameters
    ----------
    lattice
        The lattice; its origin is a phase where the detector gives one, else (0, 0).
    confidence
        In [0, 1]; how each detector makes it is in its docstring.
    diagnostics
        What led to it, by name; each :class:`Surface` and :class:`Curve` can be drawn.
    """

    lattice: Lattice
    confidence: float
    diagnostics: Mapping[str, Any] = field(default_factory=dict)


class NoLatticeFound(Exception):
    """The detector's "there is none": an answer, never a guess.

    Parameters
    ----------
    reason
        One sentence.
    best
        The best candidate that was rejected, or None.
    """

    def __init__(self, reason: str, best: Detection | None = None) -> None:
        super().__init__(reason)
        self.reason = reason
        self.best = best

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.reason, self.best)


@runtime_checkable
class Detector(Protocol):
    """The form of a detector plugin: a frozen dataclass with this method."""

    def detect(self, image: Image) -> Detection:
        """Return the lattice of ``image``, or raise :class:`NoLatticeFound`."""
        ...


Again = Callable[[Shape, int], Texture | None]
"""``again(shape, k)``: the k-th independent draw of the sample's texture, same lattice and origin."""
SourceMap = NDArray[np.float32]
"""``float32 (H, W, 3)``: for each output pixel the (x, y) of the sample pixel it came from (of the largest weight where
several were blended) and that weight in (0, 1]. NaN where it came from none."""
Value = float | bool | None
T = TypeVar("T")


class Refused(Exception):
    """The input lies outside a method's domain: shown as N/A, not a failure."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


def _ignore(fraction: float) -> None:
    """Report progress to nobody."""


@dataclass(frozen=True)
class Task:
    """One synthesis.

    Parameters
    ----------
    sample
        The texture to continue, rounded to 8 bits.
    shape
        Height and width of the output in px.
    lattice
        The lattice handed over, in the sample's pixel coordinates; None: find it yourself.
    rng
        The only source of randomness.
    progress
        Call it with the fraction done, in [0, 1], as often as you like.
    again
        Fresh draws of the same texture; None unless the method declares ``reference = True``.
    """

    sample: Image
    shape: Shape
    lattice: Lattice | None
    rng: np.random.Generator
    progress: Callable[[float], None] = _ignore
    again: Again | None = None


@dataclass(frozen=True)
class Synthesis:
    """The answer to a task.

    Parameters
    ----------
    image
        The output, ``task.shape`` and the sample's channels.
    lattice
        The lattice that was used, in the sample's coordinates; None where none was.
    source
        A :data:`SourceMap`, where the method copies pixels.
    extras
        Pictures or arrays to keep beside the output, by name.
    detection_seconds
        Wall seconds spent in finding the lattice.
    note
        One sentence that the tables show beside the row (e.g. a fallback that was taken).
    """

    image: Image
    lattice: Lattice | None = None
    source: SourceMap | None = None
    extras: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    detection_seconds: float = 0.0
    note: str = ""


@dataclass(frozen=True)
class FoundLattice:
    """What a method works with: the lattice given or found (or None and why), and what finding it cost.

    Parameters
    ----------
    lattice
        In the sample's coordinates; None where there is none.
    seconds
        Wall seconds spent in finding it.
    reason
        Why there is none.
    confidence
        In [0, 1], as the detector makes it; None where none was asked, or it found no lattice.
    """

    lattice: Lattice | None
    seconds: float = 0.0
    reason: str = ""
    confidence: float | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the answer, JSON-ready."""
        return {**vars(self), "lattice": self.lattice.as_dict() if self.lattice else None}

    @classmethod
    def from_dict(cls, mapping: Mapping[str, Any]) -> FoundLattice:
        """Rebuild an answer from :meth:`as_dict`; what else stands in the mapping is left out."""
        names = ("seconds", "reason", "confidence")
        lattice = Lattice.from_dict(mapping["lattice"]) if mapping.get("lattice") else None
        return cls(lattice, **{name: mapping[name] for name in names if name in mapping})


def find_lattice(task: Task, detector: Detector) -> FoundLattice:
    """Return the task's lattice where it was given one, else what ``detector`` finds in the sample."""
    if task.lattice is not None:
        return FoundLattice(task.lattice)
    return timed_detection(detector, task.sample)


def require_lattice(task: Task, detector: Detector, without: str) -> tuple[Lattice, float]:
    """Return the lattice given or found, and the wall seconds that finding it cost.

    Parameters
    ----------
    task, detector
        As in :func:`find_lattice`.
    without
        What cannot be done where there is none, for the refusal.

    Raises
    ------
    Refused
        Where there is none.
    """
    found = find_lattice(task, detector)
    if found.lattice is None:
        raise Refused(f"no lattice found ({found.reason}): {without}")
    return found.lattice, found.seconds


def timed_detection(detector: Detector, image: Image) -> FoundLattice:
    """Return what a detector answers on an image, "there is none" included, and the wall seconds that it took."""
    start = time.perf_counter()
    try:
        found = detector.detect(image)
    except NoLatticeFound as none:
        return FoundLattice(None, time.perf_counter() - start, none.reason)
    return FoundLattice(found.lattice, time.perf_counter() - start, confidence=float(found.confidence))


@runtime_checkable
class Synthesizer(Protocol):
    """The form of a synthesizer plugin: a frozen dataclass with this method.

    Optional class variables: ``reference`` (True: receives ``task.again`` and is never ranked), ``uses_lattice``
    (False: the lattice axis does not apply), ``needs_lattice`` (False: where a detector of the lattice axis finds none,
    the method runs without one; otherwise the cell is refused), ``right_on`` (a cheat's: the kinds of texture on which
    it is no cheat but right), ``always_shown`` (parameters that the method's label shows even at their defaults),
    ``paper`` (BibTeX), ``version``.
    """

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis, or raise :class:`Refused`."""
        ...


@dataclass(frozen=True)
class Observation:
    """The input of a metric: one synthesis, and all that is known about it.

    Parameters
    ----------
    sample, output
        The pixels of the PNG files.
    truth
        The texture of the sample; None if nothing is known about it.
    lattice_given
        The lattice that the method received; None if it received none.
    lattice_used
        The lattice that the method reports to have used; None if it reports none.
    source, extras
        As in :class:`Synthesis`.
    seconds
        Wall seconds of ``synthesize``; None if they were not measured.
    again
        Fresh draws of the texture at any shape; None for photographs.
    rng
        The random stream of this metric.
    detected
        The answer of the detector that the lattice comes from; None if it comes from no detector.
    cost
        Further costs by name: ``cpu_seconds``, ``detection_seconds``, ``peak_mib``; ``side_by_side`` is 1 if other
        cells ran at the same time.
    """

    sample: Image
    output: Image
    truth: Texture | None = None
    lattice_given: Lattice | None = None
    lattice_used: Lattice | None = None
    source: SourceMap | None = None
    extras: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    seconds: float | None = None
    again: Again | None = None
    rng: np.random.Generator = field(default_factory=np.random.default_rng)
    cost: Mapping[str, float] = field(default_factory=dict)
    detected: FoundLattice | None = None
    _shared: dict[Callable[[Observation], Any], Any] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def with_stream(self, rng: np.random.Generator) -> Observation:
        """Return the same observation with the random stream of another metric; what metrics share stays shared."""
        observation = replace(self, rng=rng)
        object.__setattr__(observation, "_shared", self._shared)
        return observation

    def shared(self, make: Callable[[Observation], T]) -> T:
        """Return ``make(self)``, computed on the first call and kept for all metrics of this observation.

        Parameters
        ----------
        make
            A function of the observation. It must not use ``rng``, because any metric may be the first to call it.

        Examples
        --------
        >>> import numpy as np
        >>> from nrbench import Observation
        >>> white = np.ones((8, 8, 1), np.float32)
        >>> observation = Observation(white, white)
        >>> observation.shared(lambda seen: float(seen.output.mean()))
        1.0
        """
        if make not in self._shared:
            self._shared[make] = make(self)
        found: T = self._shared[make]
        return found


@dataclass(frozen=True)
class Column:
    """What a score's column means.

    Parameters
    ----------
    meaning
        One sentence.
    unit
        ``""`` for ratios and truth values.
    range
        Lowest and highest possible value.
    better
        ``"higher"``, ``"lower"``, ``"one"`` (two-sided: nearest to 1), or ``"none"`` (no better way).
    """

    meaning: str
    unit: str = ""
    range: tuple[float, float] = (0.0, 1.0)
    better: Literal["higher", "lower", "one", "none"] = "none"


@dataclass(frozen=True)
class Score:
    """The output of a metric.

    Parameters
    ----------
    values
        One value for each declared column: a number, a truth value, or None.
    reasons
        One sentence for each None: why there is no value.
    pictures
        Images for the report, by name.
    records
        Further results by name; JSON can hold them.
    """

    values: Mapping[str, Value]
    reasons: Mapping[str, str] = field(default_factory=dict)
    pictures: Mapping[str, Image] = field(default_factory=dict)
    records: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def missing(cls, columns: Mapping[str, Column], reason: str) -> Score:
        """Return a score with None in every column, all for the same reason."""
        return cls(dict.fromkeys(columns), dict.fromkeys(columns, reason))


@runtime_checkable
class Metric(Protocol):
    """The form of a metric plugin: a frozen dataclass with declared columns and this method."""

    columns: ClassVar[Mapping[str, Column]]

    def score(self, observation: Observation) -> Score:
        """Return a value, or None and a reason, for every declared column."""
        ...
