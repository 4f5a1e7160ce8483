"""The reference of an output: the known lattice, the periodic image to follow, and images that follow it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy import ndimage

from nrbench.detectors.dominance import Dominance
from nrbench.imaging.convert import Image, mean_channels, quantize
from nrbench.imaging.mean_tile import Tile, Values, fold, tile_grid
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Again, NoLatticeFound, Observation, Shape, Texture

from ..ncc.periodic import LARGE, WINDOW_TILES, Periodic, tile_box, window_shape
from . import limits
from .measurements import Measurements
from .windows import RegisteredWindows, displace_lattice, fit_drift, register_windows, stretch_matrix

Origin = Literal["model", "given", "dominance"]
NO_LATTICE = "not applicable: no lattice in the truth"
_DIGITS = 9
"""Decimals to which the origin of a canonical lattice, in px, is rounded."""
FIRST_DRAW = 1 << 16
"""Number of the first fresh draw of the reference; the oracle and the planted defects use smaller numbers."""
DRAWS = 3
"""Number of fresh draws. With :data:`~.periodic.LARGE` tiles a side they hold 150 tiles and 600 one-tile windows."""
LATTICE_UNCERTAINTY = 0.02
"""Largest relative error of the vectors of a lattice that is given for a photograph. It corresponds to marking the
lattice by hand with an error of three pixels over the five to six tiles of a sample of 128 px."""
_LEAST_TILES_A_SIDE = 5
"""Least number of tiles along each side of a fresh draw, for tiles so large that :data:`~.periodic.LARGE` exceeds the
largest side."""
_SIDES = (128, 320)
"""Smallest and largest side of a fresh draw, px; the side is larger if the least number of tiles needs it."""
_DETAIL = 0.2
"""Standard deviation, in s, of the blur that is subtracted to get the detail. This removes colors that differ from tile
to tile, but not the joints."""
_WINDOW_SIZES = (WINDOW_TILES, 3.0, 4.0)
"""Widths of windows, in tiles, that are tried in this order."""
_WINDOWS, _MOST = 1.5, 0.7
"""Length of a part of the sample: in windows, and at most as a share of the sample."""


@dataclass(frozen=True)
class KnownLattice:
    """The lattice of the sample that all metrics use.

    Parameters
    ----------
    lattice
        In the canonical basis, with the point nearest to (0, 0) as origin; None if the sample has no lattice.
    origin
        Source of the lattice. ``"model"``: the model of the texture. ``"given"``: the user, for a photograph; the
        lattice is then uncertain. ``"dominance"``: the detector of that name, applied to the sample.
    reason
        Reason why there is no lattice.
    """

    lattice: Lattice | None
    origin: Origin
    reason: str = ""


def find_known_lattice(observation: Observation) -> KnownLattice:
    """Return the lattice of the sample: that of the truth, else what the detector ``dominance`` finds in the sample.

    If a model, or a truth of kind ``"stochastic"``, has no lattice, no detector is used. The lattice that the method
    received or used does not count: outputs of different methods are compared by one lattice of their sample.

    The detector is ``dominance`` because no synthesizer uses it by default (``rsgf`` and ``tile-set`` use
    ``consensus``). A score must not use the detector of a method that it ranks.
    """
    truth, again = observation.truth, observation.again
    if truth is not None and truth.lattice is not None:
        model = again is not None and truth.ideal is not None
        return KnownLattice(canonical_lattice(truth.lattice), "model" if model else "given")
    if again is not None or (truth is not None and truth.kind == "stochastic"):
        return KnownLattice(None, "model", NO_LATTICE)
    try:
        return KnownLattice(canonical_lattice(Dominance().detect(observation.sample).lattice), "dominance")
    except NoLatticeFound as none:
        reason = f"not applicable: no lattice is given, and the detector dominance finds none in the sample: {none}"
        return KnownLattice(None, "dominance", reason)


def canonical_lattice(lattice: Lattice) -> Lattice:
    """Return the lattice in its canonical basis, with the point nearest to (0, 0) as origin."""
    canonical = lattice.canonical()
    x, y = (round(float(value), _DIGITS) for value in canonical.wrap(canonical.origin))
    return Lattice(canonical.t1, canonical.t2, (x, y))


@dataclass(frozen=True)
class ReferenceImage:
    """An image of the texture without defects, and the periodic image that it follows."""

    image: Image
    periodic: Periodic


@dataclass(frozen=True)
class Reference:
    """The periodic image and the images without defects that an output is compared with.

    Parameters
    ----------
    source
        ``"model"``: the ideal image and fresh draws of the model. ``"sample"``: the mean tile of the sample, and two
        parts of the sample, each compared with the mean tile of the rest.
    periodic
        The periodic image that the output should follow.
    images
        Images of the texture without defects.
    regular_share
        Variance of the regular part over the total variance, in [0, 1].
    known
        The known lattice.
    fit
        2 x 2 matrix that maps the vectors of the known lattice to those of :attr:`lattice`, which is fitted to the
        sample.
    detail
        Standard deviation, px, of the blur that is subtracted from images before they are compared; 0: no blur.
    sample_windows
        Without a model: windows of parts of the sample, each registered against the mean tile of the rest.
    tile_fit
        Without a model: the mean :func:`compare_mean_tiles` of parts of the sample with the rest.
    """

    source: Literal["model", "sample"]
    periodic: Periodic
    images: tuple[ReferenceImage, ...]
    regular_share: float
    known: KnownLattice
    fit: Points = field(default_factory=lambda: np.eye(2))
    detail: float = 0.0
    sample_windows: tuple[RegisteredWindows, ...] = ()
    tile_fit: float = 1.0

    def prepare_image(self, image: Values) -> Values:
        """Return the image that is compared with the periodic image: the image itself, or its detail."""
        return _subtract_blur(image, self.detail)

    def straighten(self, image: Image) -> tuple[Image, Lattice]:
        """Return an image without its smooth displacements, and the lattice of its tiles.

        If the geometry of the texture does not vary, this is the image itself and the true lattice.
        """
        return image, self.lattice

    @cached_property
    def measurements(self) -> tuple[Measurements, ...]:
        """Measurements of the reference images."""
        return tuple(Measurements.at(one.image, one.periodic, self.prepare_image(one.image)) for one in self.images)

    @property
    def windows(self) -> tuple[RegisteredWindows, ...]:
        """Windows of the texture without defects: those of the fresh draws, or of parts of the sample."""
        return self.sample_windows if self.source == "sample" else tuple(one.windows for one in self.measurements)

    @cached_property
    def misplacement(self) -> NDArray[np.float64]:
        """Misplacement of all :attr:`windows`, in s."""
        return np.concatenate([one.misplacement for one in self.windows]) if self.windows else np.zeros(0)

    @cached_property
    def scatter(self) -> float:
        """Usual upper bound of the misplacement of the windows, in s.

        It is the 95th percentile for a model. It is the 90th for a sample, whose windows are few: one of them may lock
        onto a wrong place.
        """
        level = limits.SAMPLE_QUANTILE if self.source == "sample" else limits.MODEL_QUANTILE
        return float(np.quantile(self.misplacement, level)) if len(self.misplacement) else 0.0

    @property
    def consistent(self) -> bool:
        """Whether the windows of the sample lie in their places."""
        beyond = self.misplacement > 2 * limits.REFERENCE_SCATTER
        enough = len(beyond) > 0 and float(beyond.mean()) <= limits.SAMPLE_MISPLACED
        return enough and self.scatter <= limits.REFERENCE_SCATTER

    @property
    def lattice(self) -> Lattice:
        """The true lattice, in its canonical basis, in the sample's coordinates."""
        return self.periodic.lattice

    def allows_drift(self, drift: Points) -> bool:
        """Return whether the uncertainty of the lattice explains an output's affine displacement.

        It does not if a model gives the lattice. Otherwise the lattice of the output must lie within
        :data:`LATTICE_UNCERTAINTY` of the given one. The lattice that was fitted to the sample is not used for this
        comparison, because the fit has used a part of the uncertainty already.
        """
        difference = stretch_matrix(drift) @ self.fit - np.eye(2)
        return self.source == "sample" and float(np.linalg.norm(difference, 2)) <= LATTICE_UNCERTAINTY


def make_reference(observation: Observation, known: KnownLattice) -> Reference:
    """Return the reference of an observation whose lattice is known."""
    assert known.lattice is not None
    if known.origin == "model" and observation.truth is not None and observation.again is not None:
        return reference_from_model(observation.truth, known.lattice, observation.again)
    return reference_from_sample(observation.sample, known.lattice, known.origin, observation.output.shape[:2])


def reference_from_sample(
    sample: Image, lattice: Lattice, origin: Origin = "given", output: Shape | None = None
) -> Reference:
    """Return the reference of a sample, or of its detail if the regular share of the sample is too small.

    Large differences of color between tiles dominate the variance and hide the joints, which still show the lattice to
    people.

    Parameters
    ----------
    sample, lattice, origin
        As in :func:`fold_reference`.
    output
        Shape of the output; None: windows of 2 tiles are used without a look at larger ones.
    """
    reference = fold_reference(sample, lattice, origin)
    if reference.regular_share < limits.SURE_SHARE:
        fine = fold_reference(sample, lattice, origin, _DETAIL * canonical_lattice(lattice).s)
        reference = fine if fine.regular_share > reference.regular_share else reference
    return _choose_windows(reference, sample, output)


def _choose_windows(reference: Reference, sample: Image, output: Shape | None) -> Reference:
    """Return the reference with the smallest windows of :data:`_WINDOW_SIZES` that lie in their places in the sample.

    A small window of a texture with much randomness contains too little of its regular part: it fits a wrong place
    better than its own. A window of twice the width contains four times as many pixels. Small windows are preferred
    because they show smaller regions that are displaced.

    A size is used only if the output has room for :data:`~.limits.LEAST_WINDOWS` windows along each side. If the
    windows of no size lie in their places, the size with the smallest misplacement is used.
    """
    candidates: list[Reference] = []
    for tiles in _WINDOW_SIZES if output is not None else _WINDOW_SIZES[:1]:
        periodic = replace(reference.periodic, window_tiles=tiles)
        enough = (limits.LEAST_WINDOWS + 1) / 2 * np.array(window_shape(periodic.lattice, tiles))
        if candidates and (np.array(output) < enough).any():
            break
        windows = _register_sample(sample, replace(reference, periodic=periodic))
        candidate = replace(reference, periodic=periodic, sample_windows=windows)
        if candidate.consistent:
            return candidate
        candidates.append(candidate)
    return min(candidates, key=lambda one: one.scatter if one.windows else np.inf)


def _register_sample(sample: Image, reference: Reference) -> tuple[RegisteredWindows, ...]:
    """Register the windows of parts of the sample, each against the mean tile of the rest.

    The parts are the two ends of each side that has room for a window, so that every pixel of the sample is compared.
    The phase of all parts is known: it is that of the lattice of the sample.
    """
    prepared, lattice = reference.prepare_image(sample), reference.lattice
    tiles, registered = reference.periodic.window_tiles, []
    for axis in (0, 1):
        window = window_shape(lattice, tiles)
        if window[axis] > _MOST * sample.shape[axis] or window[1 - axis] > sample.shape[1 - axis]:
            continue
        for part in _split_sample(sample.shape[:2], lattice, axis, tiles):
            cross_fit = _cross_fit_part(prepared, prepared, lattice, part)
            periodic = replace(cross_fit.periodic, window_tiles=tiles)
            registered.append(replace(register_windows(cross_fit.image, periodic), known_phase=np.zeros(2)))
    return tuple(one for one in registered if len(one.corners))


def _subtract_blur(image: Values, sigma: float) -> Values:
    """Return an image less its Gaussian blur; the image itself if ``sigma`` is 0."""
    if not sigma:
        return image
    return np.asarray(image - ndimage.gaussian_filter(image, (sigma, sigma, 0), mode="reflect"), np.float32)


def reference_from_model(truth: Texture, lattice: Lattice, again: Again) -> Reference:
    """Return the reference of a texture whose model is known; raise :class:`NoFreshDraw` without fresh draws."""
    lattice = canonical_lattice(lattice)
    box = tile_box(lattice)
    side = np.ceil(np.maximum(np.clip(LARGE * box, *_SIDES), _LEAST_TILES_A_SIDE * box)).astype(int)
    shape = (int(side[1]), int(side[0]))
    draws = [draw_fresh_texture(again, shape, FIRST_DRAW + k) for k in range(DRAWS)]
    departures = mean_channels(np.mean([(draw.image - ideal_of(draw)) ** 2 for draw in draws], 0))[..., np.newaxis]
    variance = fold(departures, lattice)

    def ideal(wanted: Shape) -> Values:
        enough = wanted[0] <= shape[0] and wanted[1] <= shape[1]
        return (
            ideal_of(draws[0])[: wanted[0], : wanted[1]]
            if enough
            else ideal_of(draw_fresh_texture(again, wanted, FIRST_DRAW))
        )

    periodic = Periodic(lattice, ideal, variance)
    share = truth.regular_share
    if share is None:
        share = _regular_share(ideal_of(draws[0]), float(departures.mean()))
    images = tuple(ReferenceImage(quantize(draw.image), periodic) for draw in draws)
    return Reference("model", periodic, images, share, KnownLattice(lattice, "model"))


def fold_reference(sample: Image, lattice: Lattice, origin: Origin = "given", detail: float = 0.0) -> Reference:
    """Return the reference of a sample without a model.

    The lattice is first fitted to the sample, within :data:`LATTICE_UNCERTAINTY`.

    Parameters
    ----------
    sample
        The sample.
    lattice, origin
        The lattice of the sample, and its source.
    detail
        Standard deviation, px, of the blur that is subtracted from the sample; 0: no blur.
    """
    prepared = _subtract_blur(sample, detail)
    known = KnownLattice(canonical_lattice(lattice), origin)
    everywhere = np.ones(sample.shape[:2], np.bool_)
    assert known.lattice is not None
    rough = _fold_periodic(prepared, known.lattice, everywhere)
    drift = fit_drift(register_windows(prepared, rough))
    if not 0 < np.linalg.norm(stretch_matrix(drift) - np.eye(2), 2) <= LATTICE_UNCERTAINTY:
        drift = np.zeros((2, 2))
    periodic = _fold_periodic(prepared, displace_lattice(known.lattice, drift, np.zeros(2)), everywhere)
    ratio = np.array(sample.shape[:2]) / window_shape(periodic.lattice, WINDOW_TILES)
    axis = int(sample.shape[1] >= sample.shape[0])
    if _MOST * ratio[axis] < 1 <= _MOST * ratio[1 - axis]:
        axis = 1 - axis
    parts = _split_sample(sample.shape[:2], periodic.lattice, axis)
    images = tuple(_cross_fit_part(sample, prepared, periodic.lattice, part) for part in parts)
    share = _sample_regular_share(prepared, periodic.lattice)
    crops = (_crop(prepared, part) for part in parts)
    fits = [compare_mean_tiles(crop, one.periodic, share) for crop, one in zip(crops, images, strict=True)]
    fit = float(np.mean(fits))
    return Reference("sample", periodic, images, share, known, stretch_matrix(drift), detail, tile_fit=fit)


def compare_mean_tiles(image: Values, periodic: Periodic, regular_share: float, drift: Points | None = None) -> float:
    """Return how much of the periodic image an image contains as a whole: about 1 for the same texture, 0 by chance.

    The image is folded by the lattice. The result is the correlation of its mean tile with that of the periodic image
    at the best phase, times the square root of its regular share over the usual share. Content off the lattice has a
    small regular share; another pattern has another mean tile. The result is divided by the correlation that two mean
    tiles of the same texture have, because each contains a part of the departures: the usual share over the sum of the
    usual share and of 1/n of the rest, for n cells.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    periodic
        A periodic image of one tile.
    regular_share
        The usual regular share, that of the sample.
    drift
        2 x 2 matrix of an affine displacement of the image; None: no drift.
    """
    if not isinstance(periodic.ideal, Tile):
        raise TypeError("the mean tile of a model is not known; give a periodic image of one tile")
    lattice = displace_lattice(periodic.lattice, np.zeros((2, 2)) if drift is None else drift, np.zeros(2))
    usual = periodic.ideal.values - periodic.ideal.values.mean((0, 1))
    tile = fold(image, lattice, grid=usual.shape[:2]).values
    tile = tile - tile.mean((0, 1))
    spectrum = (scipy.fft.rfft2(tile, axes=(0, 1)) * np.conj(scipy.fft.rfft2(usual, axes=(0, 1)))).sum(-1)
    energy = float(np.sqrt((tile**2).sum(dtype=np.float64) * (usual**2).sum(dtype=np.float64)))
    correlation = float(scipy.fft.irfft2(spectrum, usual.shape[:2]).max()) / max(energy, 1e-12)
    cells = [image.shape[0] * image.shape[1] / lattice.area, float(periodic.ideal.counts.sum()) / lattice.area]
    share = max(regular_share, limits.NO_SHARE)
    expected = float(np.prod([share / (share + (1 - share) / max(count, 1.0)) for count in cells])) ** 0.5
    return float(correlation * np.sqrt(_sample_regular_share(image, lattice) / share) / expected)


def _split_sample(
    shape: Shape, lattice: Lattice, axis: int, tiles: float = WINDOW_TILES
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return masks of the two ends of one side of the sample: halves, or longer parts if windows would not fit."""
    length = int(np.clip(_WINDOWS * window_shape(lattice, tiles)[axis], shape[axis] / 2, _MOST * shape[axis]))
    along = np.arange(shape[axis])
    along = along[np.newaxis] if axis else along[:, np.newaxis]
    first, last = (np.broadcast_to(end, shape) for end in (along < length, along >= shape[axis] - length))
    return first, last


def _cross_fit_part(sample: Image, prepared: Values, lattice: Lattice, part: NDArray[np.bool_]) -> ReferenceImage:
    """Return one part of the sample as a reference image, with the mean tile of the rest as its periodic image."""
    rest = _fold_periodic(prepared, lattice, ~part)
    shifted = lattice.shifted((-float(part.any(0).argmax()), -float(part.any(1).argmax())))
    return ReferenceImage(_crop(sample, part), rest.with_lattice(shifted))


def _crop(image: Values, part: NDArray[np.bool_]) -> Values:
    """Return the rectangle of an image that a mask covers."""
    rows, columns = np.flatnonzero(part.any(1)), np.flatnonzero(part.any(0))
    return image[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def _fold_periodic(sample: Values, lattice: Lattice, mask: NDArray[np.bool_]) -> Periodic:
    """Return the sample's mean tile, and the variance across tiles, corrected for the share 1/n that a mean takes."""
    tile = fold(sample, lattice, mask)
    cells = max(float(mask.sum()) / lattice.area, 1.5)
    departures = mean_channels((sample - tile.unfold(sample.shape[:2])) ** 2)[..., np.newaxis]
    return Periodic(lattice, tile, fold(departures * np.float32(cells / (cells - 1)), lattice, mask))


def _sample_regular_share(sample: Values, lattice: Lattice) -> float:
    """Return the regular share of a sample, comparable with that of a model.

    Folding smooths: with one sample per pixel the mean tile loses a fourth of the variance of thin joints. Therefore
    the tile is sampled twice as finely, and the loss is estimated by a second folding and added. A mean of n tiles also
    contains 1/n of the variance of the departures, which is subtracted.
    """
    rows, columns = tile_grid(lattice)
    grid, shape = (2 * rows, 2 * columns), sample.shape[:2]
    once = fold(sample, lattice, grid=grid).unfold(shape)
    twice = fold(once, lattice, grid=grid).unfold(shape)
    total, regular, kept = (float(one.var((0, 1), dtype=np.float64).mean()) for one in (sample, once, twice))
    share, bias = regular**2 / max(kept * total, 1e-12), lattice.area / (shape[0] * shape[1])
    return float(np.clip((share - bias) / max(1 - bias, 1e-12), 0, 1))


def _regular_share(ideal: Values, departures: float) -> float:
    """Return the variance of the periodic image, mean over channels, over the total variance."""
    regular = float(ideal.var((0, 1), dtype=np.float64).mean())
    return regular / max(regular + departures, 1e-12)


class NoFreshDraw(Exception):
    """The dataset of a texture gave no fresh draw, or one without its ideal image; the message is the reason."""


def draw_fresh_texture(again: Again, shape: Shape, k: int) -> Texture:
    """Return a fresh draw; raise :class:`NoFreshDraw` if the dataset gives none."""
    draw = again(shape, k)
    if draw is None:
        raise NoFreshDraw(f"not applicable: the texture's dataset gives no fresh draw of {shape[1]}x{shape[0]} px")
    return draw


def ideal_of(draw: Texture) -> Values:
    """Return the ideal image of a fresh draw; raise :class:`NoFreshDraw` if it has none."""
    if draw.ideal is None:
        raise NoFreshDraw("not applicable: the fresh draws of the texture's dataset have no ideal image")
    return draw.ideal
