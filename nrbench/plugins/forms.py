"""The forms of plugins: what a texture, a detection, a synthesis, an observation and a score are."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import BadInput
from nrbench.imaging.convert import Image
from nrbench.imaging.masks import Mask
from nrbench.lattice.geometry import Lattice, Points
from nrbench.lattice.vertices import Vertex
from nrbench.work import work_clock

Kind = Literal["0", "I", "II", "III", "stochastic"]
Shape = tuple[int, int]
"""(height, width) in px."""
Region = tuple[int, int, int, int]
"""(x0, y0, x1, y1) in px of the picture that a crop was cut from, half-open."""
Geometry = Literal["waves", "bent", "argmax", "straight", "as-is"]
"""How a method is run where the sample is bent. It gets the straightened sample, and its output is ``"bent"`` by a
field like the sample's, bent by ``"argmax"`` as in Lin and others 2004 (appendix A, equation 3; one pass of each warp),
or left ``"straight"``. ``"waves"``: bent where the sample waves, straight where it shows a plane in perspective, a
round surface or the distortion of a lens. ``"as-is"``: it gets the sample itself."""


@dataclass(frozen=True)
class Texture:
    """An image, and the truth about it.

    Parameters
    ----------
    image
        The pixels, :data:`~nrbench.imaging.convert.Image`.
    lattice
        The smallest lattice of the ideal image, with its origin; None if there is none or it is unknown.
    lattices
        All lattices of a texture that has several, ``lattice`` first.
    name, family
        Name of the row of the suite, and of the group of rows in tables.
    kind
        ``"0"`` perfectly regular, ``"I"`` regular geometry with varying color, ``"II"`` varying geometry with regular
        color, ``"III"`` both vary, ``"stochastic"`` no lattice; None if it is unknown (photographs).
    ideal
        The periodic image, of the shape of ``image``: the mean over draws of the model at this lattice and phase,
        without damage and displacements; None if no model is known.
    displacement
        ``float32 (H, W, 2)``: displacement (x, y) in px of the content at each pixel from its ideal place; None if
        the content has not moved.
    elements
        Departures of each element (brick, thread, tile) by name, one array each whose first axis counts elements.
    regular_share
        Variance of the mean over draws over the mean total variance, in [0, 1]; None if it is unknown.
    region
        The region of a photograph that the image was cropped from; None for models.
    draw_seed
        The number that decides the draw of a model; None for photographs. It is part of no hash and no key.
    vertices
        Where the points of the lattice lie in a photograph, as a person set them; empty if nobody did. Those of a model
        follow from ``lattice`` and ``displacement``.
    known
        ``bool (H, W)``: which pixels of a photograph count, see :class:`Task`; None: all.

    Examples
    --------
    >>> from nrbench import texture
    >>> brick = texture("brick", shape=(64, 96))
    >>> brick.kind, brick.displacement is None
    ('I', True)
    """

    image: Image = field(repr=False)
    lattice: Lattice | None = None
    lattices: tuple[Lattice, ...] = ()
    name: str = ""
    family: str = ""
    kind: Kind | None = None
    ideal: Image | None = field(default=None, repr=False)
    displacement: NDArray[np.float32] | None = field(default=None, repr=False)
    elements: Mapping[str, NDArray[np.float64]] = field(default_factory=dict, repr=False)
    regular_share: float | None = None
    region: Region | None = None
    draw_seed: int | None = None
    vertices: tuple[Vertex, ...] = ()
    known: Mask | None = field(default=None, repr=False)

    def _repr_png_(self) -> bytes:
        """Return the picture as PNG, for notebooks."""
        from nrbench.pictures.files import encode_png  # reads Pillow, which most plugins do not need

        return encode_png(self.image)


@runtime_checkable
class Dataset(Protocol):
    """The form of a dataset plugin: a frozen dataclass with these two methods.

    Optional method:

    ``recompose(texture, shape, rng)``
        Return a draw of the same model and lattice in which each element copies a random element of ``texture`` that
        lies at an equal place, joined without error. The reference method ``copier`` needs it.
    """

    def render(self, shape: Shape, rng: np.random.Generator) -> Texture:
        """Return a texture of ``shape`` whose lattice phase and departures are drawn from ``rng``."""
        ...

    def again(self, texture: Texture, shape: Shape, rng: np.random.Generator) -> Texture | None:
        """Return an independent draw of the same model and lattice, with the same origin and fresh departures.

        For a photograph, return a region of ``shape`` disjoint from ``texture.region``, or None if there is none.
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
        ``(2, 2)``, rows (x, y) in samples from ``zero``: the chosen pair of vectors, or None.

    Examples
    --------
    >>> import numpy as np
    >>> from nrbench import Surface
    >>> Surface(np.zeros((9, 9)), zero=(4, 4), peaks=np.array([[2.0, 0.0]])).zero
    (4, 4)
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
        The chosen values of x.
    label
        Label of the x axis, with the unit.

    Examples
    --------
    >>> import numpy as np
    >>> from nrbench import Curve
    >>> lags = np.arange(1.0, 9.0)
    >>> Curve(lags, np.cos(lags), marks=(6.0,), label="lag (px)").marks
    (6.0,)
    """

    x: NDArray[np.floating[Any]]
    y: NDArray[np.floating[Any]]
    marks: tuple[float, ...] = ()
    label: str = ""


class Probabilities(NamedTuple):
    """The probabilities, in [0, 1] with the sum 1, of what a lattice is.

    Parameters
    ----------
    exact
        It is the smallest lattice by which the image repeats.
    sub_or_supercell
        It contains that lattice, or is contained in it: a cell holds several tiles, or a share of one.
    none
        The image has another lattice or none.

    Examples
    --------
    >>> from nrbench import Probabilities
    >>> Probabilities(0.7, 0.2, 0.1).exact
    0.7
    """

    exact: float
    sub_or_supercell: float
    none: float


@dataclass(frozen=True)
class Alternative:
    """A lattice that a detector did not choose.

    Parameters
    ----------
    lattice
        The lattice.
    confidence
        Probability, in [0, 1], that this is the exact lattice. With the detection's own confidence the sum over all
        alternatives is at most 1.
    relation
        How the lattice relates to the chosen one, whose vectors are t1 and t2: ``"half along t1"``,
        ``"double along t2"``, ``"x 3 along t2"``, ``"supercell x 4"``, ``"subcell 1/2"``, ``"unrelated"``
        (:class:`nrbench.lattice.relation.BasisChange`).
    evidence
        The rating by which the detector orders lattices; its docstring says which. None if it has none.
    has_origin
        Whether the origin of the lattice is known. If not, it is (0, 0) and means nothing.

    Examples
    --------
    >>> from nrbench import Alternative, Lattice
    >>> Alternative(Lattice((60, 0), (0, 24)), 0.1, "double along t1").lattice.area
    1440.0
    """

    lattice: Lattice
    confidence: float
    relation: str
    evidence: float | None = None
    has_origin: bool = False


@dataclass(frozen=True)
class Detection:
    """A lattice found in an image.

    Parameters
    ----------
    lattice
        The lattice.
    confidence
        In [0, 1]; the docstring of each detector defines it.
    diagnostics
        Intermediate results by name; each :class:`Surface` and :class:`Curve` can be drawn.
    alternatives
        Lattices that were not chosen, the most probable first; empty if the detector gives none. The first one may be
        more probable than ``lattice``: a detector need not choose by probability alone.
    probabilities
        What the lattice is; ``confidence`` equals ``probabilities.exact``. None if the detector does not estimate it.
    has_origin
        Whether the detector found the origin of the lattice. If not, it is (0, 0) and means nothing.
    vertices
        Where the points of the lattice lie in the image, if the detector follows them: ``lattice`` is then their mean
        lattice. Any point of a cell may be its vertex. Empty: they lie as ``lattice`` lays them.

    Examples
    --------
    >>> from nrbench import Detection, Lattice
    >>> Detection(Lattice((30, 0), (0, 24)), confidence=0.9).has_origin
    False
    """

    lattice: Lattice
    confidence: float
    diagnostics: Mapping[str, Any] = field(default_factory=dict)
    alternatives: tuple[Alternative, ...] = ()
    probabilities: Probabilities | None = None
    has_origin: bool = False
    vertices: tuple[Vertex, ...] = ()


class NoLatticeFound(Exception):
    """Raised by a detector when no candidate passes its tests; carries the best rejected candidate.

    Parameters
    ----------
    reason
        One sentence that says which test failed.
    best
        The best candidate that was rejected, or None.
    lattices
        The lattices of an image in which several are superposed; empty otherwise.

    Examples
    --------
    >>> import numpy as np
    >>> from nrbench import NoLatticeFound, detect_lattice
    >>> try:
    ...     detect_lattice(np.zeros((64, 64)))
    ... except NoLatticeFound as none:
    ...     print(none.best)
    None
    """

    def __init__(self, reason: str, best: Detection | None = None, lattices: Sequence[Lattice] = ()) -> None:
        super().__init__(reason)
        self.reason = reason
        self.best = best
        self.lattices = tuple(lattices)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.reason, self.best, self.lattices)


@runtime_checkable
class Detector(Protocol):
    """The form of a detector plugin: a frozen dataclass with this method.

    A detector that can leave pixels out declares the class variable ``masks = True``. Its method is then
    ``detect(image, known=None)``: ``known`` is ``bool (H, W)``, True where a pixel counts. The others have the color of
    the nearest one that counts. Detectors without it get such an image as if all counted.
    """

    def detect(self, image: Image) -> Detection:
        """Return the lattice of ``image``, or raise :class:`NoLatticeFound`."""
        ...


Again = Callable[[Shape, int], Texture | None]
"""``again(shape, k)`` returns the k-th independent draw of the sample's texture, of the same lattice and origin."""
SourceMap = NDArray[np.float32]
"""``float32 (H, W, 3)``: for each output pixel the place (x, y) in the sample that it shows, and the weight of that
place in (0, 1]. A place between pixels is interpolated; a pixel whose place is whole and whose weight is 1 is a copy.
Where several places were blended, the one of the largest weight. NaN where the sample is not shown."""
Value = float | bool | None
Better = Literal["higher", "lower", "one", "none"]
T = TypeVar("T")


class Refused(Exception):
    """Raised by a method whose input lies outside its domain; tables show N/A, and the cell is no failure.

    Parameters
    ----------
    reason
        One sentence that says what is outside the domain.

    Examples
    --------
    >>> from nrbench import Refused
    >>> str(Refused("the sample is constant"))
    'the sample is constant'
    """

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


def _ignore(fraction: float) -> None:
    """Ignore the progress."""


@dataclass(frozen=True)
class Task:
    """The input of a synthesis method.

    Parameters
    ----------
    sample
        The sample of the texture, rounded to 8 bits, or to the 16 of a picture file.
    shape
        Height and width of the output in px.
    lattice
        The given lattice, in pixel coordinates of the sample; None if the method must find it.
    rng
        The only source of randomness.
    progress
        A function that a method may call at any time with the completed fraction, in [0, 1].
    again
        Fresh draws of the same texture; None unless the method declares ``reference = True``.
    recompose
        ``recompose(shape, k)`` returns the k-th draw whose elements are copies of elements of the sample; None unless
        the method declares ``reference = True`` and the dataset has a method ``recompose``.
    cache
        The folder that the method's ``prepare`` has filled for this sample; None unless the method has ``prepare``.
    tileable
        Whether the opposite edges of the output must continue each other. It is True only if the class variable
        ``wraps`` of the method is. If there is a lattice, (width, 0) and (0, height) are vectors of it.
    detected
        What a detector found in a sample before the method ran: the sample, the detector, and the answer.
        :func:`find_lattice` returns this answer for the same sample and an equal detector; None if there is none.
    known
        ``bool (h, w)``: True where a pixel of ``sample`` counts; None if all do. It is None unless the class variable
        ``masks`` of the method is True: then the output holds nothing of the other pixels, which were transparent or
        left out by a mask. They have the color of the nearest pixel that counts.

    Examples
    --------
    >>> import numpy as np
    >>> from nrbench import Task
    >>> task = Task(np.ones((8, 8, 3), np.float32), (16, 16), None, np.random.default_rng(0))
    >>> task.progress(0.5)
    """

    sample: Image
    shape: Shape
    lattice: Lattice | None
    rng: np.random.Generator
    progress: Callable[[float], None] = _ignore
    again: Again | None = None
    recompose: Again | None = None
    cache: Path | None = None
    tileable: bool = False
    detected: tuple[Image, Detector, FoundLattice] | None = None
    known: Mask | None = field(default=None, repr=False)


@dataclass(frozen=True)
class Synthesis:
    """The result of a synthesis method.

    Parameters
    ----------
    image
        The output, of shape ``task.shape`` and with the channels of the sample.
    lattice
        The lattice that the method used, in coordinates of the sample; None if it used none.
    source
        A :data:`SourceMap`, if the method copies pixels.
    extras
        Pictures or arrays by name; they are kept beside the output.
    detection_seconds
        Wall seconds of the detection of the lattice.
    note
        One sentence that the tables show beside the row, for example about a fallback.
    files
        Functions by the names of text files, which are kept beside the pictures of ``extras``. Each takes a prefix of
        the names of these pictures, and returns the text: "" in a run, "OUT-" for ``nrbench synth -o OUT.png``.
    blended
        ``float32 (H, W, K, 3)``: the next K places of each pixel that is blended, in the order of their weights; weight
        0 where there is none. None if no pixel is blended.
    tints
        ``float32 (h, w, 2 + C)``: places (x, y) in the sample, and the part of its color there that the method drew
        anew; None if it drew none. Then the output differs from its sources, and other maps follow by regression.
    sample
        The sample; nrbench adds it.
    maps
        The maps of the call, in the layout of the output; nrbench adds them.
    able
        The names of the methods that give source maps, for a message; nrbench adds them if there is none.

    Examples
    --------
    >>> import numpy as np
    >>> from nrbench import Synthesis
    >>> Synthesis(np.zeros((8, 8, 3), np.float32), note="the sample was used once").lattice is None
    True
    """

    image: Image = field(repr=False)
    lattice: Lattice | None = None
    source: SourceMap | None = field(default=None, repr=False)
    extras: Mapping[str, NDArray[Any]] = field(default_factory=dict, repr=False)
    detection_seconds: float = 0.0
    note: str = ""
    files: Mapping[str, Callable[[str], str]] = field(default_factory=dict, repr=False)
    blended: NDArray[np.float32] | None = field(default=None, repr=False)
    tints: NDArray[np.float32] | None = field(default=None, repr=False)
    sample: Image | None = field(default=None, repr=False)
    maps: tuple[NDArray[Any], ...] = field(default=(), repr=False)
    able: str = field(default="", repr=False)

    def apply(self, other: NDArray[Any]) -> NDArray[Any]:
        """Return another map of the sample, such as heights, in the layout of the output.

        Copies are exact. Between pixels the map is interpolated, and where the output is blended, so is the map. The
        vectors of a normal map, which is recognized by their lengths, get length 1 again. Truth values are those of the
        nearest pixel of the largest weight.

        Parameters
        ----------
        other
            ``(h, w)`` or ``(h, w, C)``, of the size of the sample: bool, whole numbers, or finite floats of any range.

        Returns
        -------
        NDArray
            ``(H, W)`` or ``(H, W, C)``, of the same dtype.

        Raises
        ------
        BadInput
            If the method gives no source map, the map is not finite, or it has another size than the sample.

        Examples
        --------
        >>> from nrbench import synthesize, texture
        >>> brick = texture("brick", shape=(96, 96))
        >>> made = synthesize("quilting:block=24", brick, (80, 60))
        >>> heights = brick.image[..., 1] ** 2
        >>> bool(abs(made.apply(heights) - made.image[..., 1] ** 2).max() < 1 / 255)  # the image has 8 bits
        True
        """
        from nrbench.imaging.source_maps import as_layers_of_map, follow_tints, lay_out, like_map, read_nearest

        if self.source is None or self.sample is None or not np.isfinite(self.source).all():
            raise BadInput(f"apply: the method gives no complete source map; {self.able or 'others'} do")
        values = as_layers_of_map(other, self.sample.shape)
        laid, nearest = lay_out(values, self.source, self.blended), read_nearest(values, self.source)
        if self.tints is not None:
            copies = lay_out(self.sample.astype(np.float64), self.source, self.blended)
            laid += follow_tints(values, self.tints, self.image.reshape(copies.shape) - copies)
        return like_map(laid, other, nearest)

    def _repr_png_(self) -> bytes:
        """Return the picture as PNG, for notebooks."""
        from nrbench.pictures.files import encode_png  # reads Pillow, which most plugins do not need

        return encode_png(self.image)


@dataclass(frozen=True)
class FoundLattice:
    """A lattice that was given or detected, or the reason why there is none.

    Parameters
    ----------
    lattice
        In coordinates of the sample; None if there is none.
    seconds
        Wall seconds of the detection.
    reason
        Why there is none.
    confidence
        Confidence of the detector, in [0, 1]; None if no detector was used or it found no lattice.
    vertices
        Those of the :class:`Detection`.

    Examples
    --------
    >>> from nrbench import FoundLattice
    >>> FoundLattice(None, reason="the image has one color").lattice is None
    True
    """

    lattice: Lattice | None
    seconds: float = 0.0
    reason: str = ""
    confidence: float | None = None
    vertices: tuple[Vertex, ...] = ()


def find_lattice(task: Task, detector: Detector) -> FoundLattice:
    """Return the lattice of the task, or detect that of the sample if none was given and it is not known yet.

    Parameters
    ----------
    task
        The input of the method.
    detector
        Called if the task has no lattice.

    Returns
    -------
    FoundLattice
        The lattice, or the reason why there is none.

    Examples
    --------
    >>> import numpy as np
    >>> from nrbench import Lattice, NamedDetector, Task, find_lattice
    >>> task = Task(np.ones((64, 64, 3), np.float32), (128, 128), Lattice((16, 0), (0, 12)), np.random.default_rng(0))
    >>> find_lattice(task, NamedDetector("gncc")).lattice.t1[0]
    16.0
    """
    if task.lattice is not None:
        return FoundLattice(task.lattice)
    if task.detected is not None:
        sample, earlier, found = task.detected
        if sample is task.sample and earlier == detector:
            return replace(found, seconds=0.0)
    return timed_detection(detector, task.sample, task.known)


def require_lattice(task: Task, detector: Detector, without: str) -> tuple[Lattice, float]:
    """Return the given or detected lattice, and the wall seconds of the detection.

    Parameters
    ----------
    task, detector
        As in :func:`find_lattice`.
    without
        What the method cannot do without a lattice, for the message.

    Returns
    -------
    lattice
        In coordinates of the sample.
    seconds
        Wall seconds of the detection; 0 if the lattice was given.

    Raises
    ------
    Refused
        If no lattice was given or found.

    Examples
    --------
    >>> import numpy as np
    >>> from nrbench import Lattice, NamedDetector, Task, require_lattice
    >>> task = Task(np.ones((64, 64, 3), np.float32), (128, 128), Lattice((16, 0), (0, 12)), np.random.default_rng(0))
    >>> require_lattice(task, NamedDetector("gncc"), "there is no tile to repeat")[0].t1[0]
    16.0
    """
    found = find_lattice(task, detector)
    if found.lattice is None:
        raise Refused(f"no lattice found ({found.reason}): {without}")
    return found.lattice, found.seconds


def detect_known(detector: Any, image: Image, known: Mask | None) -> Detection:
    """Return the lattice that a detector finds in the pixels that count, or in all if it can leave none out.

    Raises
    ------
    NoLatticeFound
        If it finds none.
    """
    masked = known is not None and getattr(detector, "masks", False)
    found: Detection = detector.detect(image, known) if masked else detector.detect(image)
    return found


def timed_detection(detector: Detector, image: Image, known: Mask | None = None) -> FoundLattice:
    """Detect the lattice of an image, and measure the wall seconds; if there is none, return the reason.

    Parameters
    ----------
    detector
        The detector.
    image
        The image.
    known
        The pixels that count, see :func:`detect_known`.

    Raises
    ------
    TypeError
        When the detector returns no :class:`Detection`.
    """
    start = work_clock()
    try:
        found: object = detect_known(detector, image, known)
    except NoLatticeFound as none:
        return FoundLattice(None, work_clock() - start, none.reason)
    if not isinstance(found, Detection):
        raise TypeError(f"returned {type(found).__name__} instead of a Detection")
    seconds = work_clock() - start
    return FoundLattice(found.lattice, seconds, confidence=float(found.confidence), vertices=found.vertices)


@runtime_checkable
class Synthesizer(Protocol):
    """The form of a synthesizer plugin: a frozen dataclass with this method.

    The section "A method" of docs/plugins.md lists what a method may declare beside it: whether it uses, needs or finds
    a lattice, how it treats bent samples, its label and version.
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
    cost
        Further costs by name: ``cpu_seconds``, ``detection_seconds``, ``peak_mib``; ``side_by_side`` is 1 if other
        cells ran at the same time.
    detected
        The answer of the detector that the lattice comes from; None if it comes from no detector.
    known
        As in :class:`Task`: which pixels of the sample count; None: all.

    Examples
    --------
    >>> import numpy as np
    >>> from nrbench import Observation
    >>> white = np.ones((8, 8, 1), np.float32)
    >>> Observation(white, white).truth is None
    True
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
    known: Mask | None = field(default=None, repr=False)
    _shared: dict[Callable[[Observation], Any], Any] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def with_stream(self, rng: np.random.Generator) -> Observation:
        """Return the same observation with the random stream of another metric. Shared results stay shared.

        Parameters
        ----------
        rng
            The random stream.

        Returns
        -------
        Observation
            A copy with this stream.
        """
        observation = replace(self, rng=rng)
        object.__setattr__(observation, "_shared", self._shared)
        return observation

    def shared(self, make: Callable[[Observation], T]) -> T:
        """Return ``make(self)``, computed on the first call and kept for all metrics of this observation.

        Parameters
        ----------
        make
            A function of the observation. It must not use ``rng``, because any metric may be the first to call it.

        Returns
        -------
        Any
            What ``make`` returned.

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
    """The declaration of a score's column.

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

    Examples
    --------
    >>> from nrbench import Column
    >>> Column("Mean of all pixels of the output.").range
    (0.0, 1.0)
    """

    meaning: str
    unit: str = ""
    range: tuple[float, float] = (0.0, 1.0)
    better: Better = "none"


def describe_silence(reason: str) -> str:
    """Return what it means that a peril has no score, by the reason.

    ``no peril``: a fault of this kind could not be seen in this texture, and the quality is no upper bound.
    ``cannot tell``: a fault may be there.
    """
    return "no peril" if reason.startswith("not applicable") else "cannot tell"


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

    Examples
    --------
    >>> from nrbench import Score
    >>> Score({"mean": 0.5, "contrast": None}, {"contrast": "the sample has one color"}).values["mean"]
    0.5
    """

    values: Mapping[str, Value]
    reasons: Mapping[str, str] = field(default_factory=dict)
    pictures: Mapping[str, Image] = field(default_factory=dict)
    records: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def missing(cls, columns: Mapping[str, Column], reason: str) -> Score:
        """Return a score with None in every column, all for the same reason.

        Parameters
        ----------
        columns
            The declared columns of the metric.
        reason
            One sentence: why there is no value.

        Returns
        -------
        Score
            Its values are None.
        """
        return cls(dict.fromkeys(columns), dict.fromkeys(columns, reason))


@runtime_checkable
class Metric(Protocol):
    """The form of a metric plugin: a frozen dataclass with declared columns and this method."""

    columns: ClassVar[Mapping[str, Column]]

    def score(self, observation: Observation) -> Score:
        """Return a value, or None and a reason, for every declared column."""
        ...


@runtime_checkable
class Report(Protocol):
    """The form of a report plugin: a frozen dataclass with this method.

    Optional class variables:

    ``folder``
        The folder of its files, below the run directory; ``"report"`` by default. It exists when ``write`` is called.
    ``terminal``
        True: after a run, the text that its method ``render(run)`` returns is printed; it has a parameter ``width``,
        the number of characters in a line.

    If it has a parameter ``labels``, it receives the files of ``nrbench report RUN --labels FILE...``.
    """

    def write(self, run: Any, directory: Path) -> Iterable[str | Path]:
        """Write files into ``directory`` and return their paths.

        Parameters
        ----------
        run
            The run, a :class:`nrbench.runs.records.Run`: its cells, its tables and its columns.
        directory
            A folder that exists. Names of textures and methods come from users, so escape them.
        """
        ...
