"""The reference of an output: the known lattice, the periodic image to follow, and images that follow it."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from nrbench.detectors.dominance import Dominance
from nrbench.imaging.convert import Image, quantize
from nrbench.imaging.fold import Values, fold, tile_grid
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Again, NoLatticeFound, Observation, Shape, Texture

from ..ncc.periodic import LARGE, WINDOW_TILES, Periodic, tile_box, window_shape
from . import limits
from .measurements import Measurements
from .windows import fit_drift, moved, register_windows, spread

Origin = Literal["model", "given", "dominance"]
NO_LATTICE = "not applicable: no lattice in the truth"
_DIGITS = 9
"""Decimals, px, to which the origin of a canonical lattice is rounded."""
FIRST_DRAW = 1 << 16
"""Number of the first fresh draw of the reference; the oracle and the planted defects use smaller numbers."""
DRAWS = 3
"""Fresh draws looked at: of :data:`~.periodic.LARGE` tiles a side, some 150 tiles and 600 one-tile windows."""
LATTICE_UNCERTAINTY = 0.02
"""How far a lattice that was given for a photograph may be off, as a fraction of its vectors: three pixels over the
five to six tiles of a sample of 128 px, which is what marking it by hand comes to."""
_LEAST_TILES_A_SIDE = 5
"""Fewest tiles along each side of a fresh draw, where :data:`~.periodic.LARGE` would be too large."""
_SIDES = (128, 320)
"""Least and largest side of a fresh draw, px, as long as the fewest tiles fit."""
_DETAIL = 0.2
"""Standard deviation, in s, of the blur that detail is without: colors that differ from tile to tile are gone then,
joints are not."""
_WINDOWS, _MOST = 1.5, 0.7
"""A part of the sample is this many windows long, but no more than that share of the sample."""


@dataclass(frozen=True)
class KnownLattice:
    """The lattice of the sample, as all metrics use it.

    Parameters
    ----------
    lattice
        In the canonical basis, its origin the point nearest to (0, 0); None if the sample has no lattice.
    origin
        Where the lattice comes from. ``"model"``: the model of the texture. ``"given"``: the user, for a photograph;
        the lattice is then uncertain. ``"dominance"``: that detector found it in the sample.
    reason
        Why there is no lattice.
    """

    lattice: Lattice | None
    origin: Origin
    reason: str = ""


def find_known_lattice(observation: Observation) -> KnownLattice:
    """Return the lattice of the sample: that of the truth, else what the detector ``dominance`` finds in the sample.

    A model, or a truth of kind ``"stochastic"``, without a lattice is believed. The lattice that the method received
    or used does not count: outputs of different methods are compared by one lattice of their sample.

    The detector is ``dominance`` because no synthesizer uses it by default (``rsgf`` and ``tile-set`` use
    ``consensus``): a score must not share the lattice finder of a method that it ranks.
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
    """Return the lattice in its canonical basis, its origin the point nearest to (0, 0)."""
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
    """What an output is compared with.

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
        Variance of the regular part over the whole variance, in [0, 1].
    known
        The known lattice.
    fit
        2 x 2 matrix that takes the vectors of the known lattice to those of :attr:`lattice`, which is fitted to the
        sample.
    detail
        Standard deviation, px, of the blur that is subtracted from images before they are compared; 0: none is.
    """

    source: Literal["model", "sample"]
    periodic: Periodic
    images: tuple[ReferenceImage, ...]
    regular_share: float
    known: KnownLattice
    fit: Points = field(default_factory=lambda: np.eye(2))
    detail: float = 0.0

    def view(self, image: Values) -> Values:
        """Return what is compared of an image: all of it, or its detail."""
        return _detail(image, self.detail)

    @cached_property
    def measurements(self) -> tuple[Measurements, ...]:
        """Measurements of the reference images."""
        return tuple(Measurements.at(one.image, one.periodic, self.view(one.image)) for one in self.images)

    @property
    def lattice(self) -> Lattice:
        """The true lattice, in its canonical basis, in the sample's coordinates."""
        return self.periodic.lattice

    def forgiven(self, drift: Points) -> bool:
        """Return whether an output's affine displacement may come from the uncertainty of the lattice.

        Never where a model knows it. Else the output's lattice must lie within :data:`LATTICE_UNCERTAINTY` of the one
        that was given, like the sample's own: what fitting the sample took of it is not allowed once more.
        """
        away = spread(drift) @ self.fit - np.eye(2)
        return self.source == "sample" and float(np.linalg.norm(away, 2)) <= LATTICE_UNCERTAINTY


def make_reference(observation: Observation, known: KnownLattice) -> Reference:
    """Return the reference of an observation whose lattice is known."""
    assert known.lattice is not None
    if known.origin == "model" and observation.truth is not None and observation.again is not None:
        return reference_from_model(observation.truth, known.lattice, observation.again)
    return reference_from_sample(observation.sample, known.lattice, known.origin)


def reference_from_sample(sample: Image, lattice: Lattice, origin: Origin = "given") -> Reference:
    """Return the reference of a sample, or of its detail if the whole sample has too little that is regular.

    Large differences of color between tiles hide the joints, by which people still see the lattice.
    """
    whole = fold_reference(sample, lattice, origin)
    if whole.regular_share >= limits.SURE_SHARE:
        return whole
    fine = fold_reference(sample, lattice, origin, _DETAIL * canonical_lattice(lattice).s)
    return fine if fine.regular_share > whole.regular_share else whole


def _detail(image: Values, sigma: float) -> Values:
    """Return an image less its blur; the image where ``sigma`` is 0."""
    if not sigma:
        return image
    return np.asarray(image - ndimage.gaussian_filter(image, (sigma, sigma, 0), mode="reflect"), np.float32)


def reference_from_model(truth: Texture, lattice: Lattice, again: Again) -> Reference:
    """Return the reference of a texture whose model is known."""
    lattice = canonical_lattice(lattice)
    box = tile_box(lattice)
    side = np.ceil(np.maximum(np.clip(LARGE * box, *_SIDES), _LEAST_TILES_A_SIDE * box)).astype(int)
    shape = (int(side[1]), int(side[0]))
    draws = [_draw(again, shape, FIRST_DRAW + k) for k in range(DRAWS)]
    departures = np.mean([(draw.image - _ideal(draw)) ** 2 for draw in draws], 0).mean(-1, keepdims=True)
    variance = fold(departures, lattice)

    def ideal(wanted: Shape) -> Values:
        enough = wanted[0] <= shape[0] and wanted[1] <= shape[1]
        return _ideal(draws[0])[: wanted[0], : wanted[1]] if enough else _ideal(_draw(again, wanted, FIRST_DRAW))

    periodic = Periodic(lattice, ideal, variance)
    share = truth.regular_share
    if share is None:
        share = _share(_ideal(draws[0]), float(departures.mean()))
    images = tuple(ReferenceImage(quantize(draw.image), periodic) for draw in draws)
    return Reference("model", periodic, images, share, KnownLattice(lattice, "model"))


def fold_reference(sample: Image, lattice: Lattice, origin: Origin = "given", detail: float = 0.0) -> Reference:
    """Return the reference of a sample, or of its detail, of which only the lattice is known.

    The lattice is first fitted to the sample, within :data:`LATTICE_UNCERTAINTY`.
    """
    seen = _detail(sample, detail)
    known = KnownLattice(canonical_lattice(lattice), origin)
    everywhere = np.ones(sample.shape[:2], np.bool_)
    assert known.lattice is not None
    rough = _folded(seen, known.lattice, everywhere)
    drift = fit_drift(register_windows(seen, rough))
    if not 0 < np.linalg.norm(spread(drift) - np.eye(2), 2) <= LATTICE_UNCERTAINTY:
        drift = np.zeros((2, 2))
    periodic = _folded(seen, moved(known.lattice, drift, np.zeros(2)), everywhere)
    parts = _parts(sample.shape[:2], periodic.lattice)
    images = tuple(_crossed(sample, seen, periodic.lattice, part) for part in parts)
    share = _sample_share(seen, periodic.lattice)
    return Reference("sample", periodic, images, share, known, spread(drift), detail)


def _parts(shape: Shape, lattice: Lattice) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return masks of two ends of the sample's longer side: halves, or more where windows would not fit."""
    axis = int(shape[1] >= shape[0])
    length = int(np.clip(_WINDOWS * window_shape(lattice, WINDOW_TILES)[axis], shape[axis] / 2, _MOST * shape[axis]))
    along = np.arange(shape[axis])
    along = along[np.newaxis] if axis else along[:, np.newaxis]
    first, last = (np.broadcast_to(end, shape) for end in (along < length, along >= shape[axis] - length))
    return first, last


def _crossed(sample: Image, seen: Values, lattice: Lattice, part: NDArray[np.bool_]) -> ReferenceImage:
    """Return one part of the sample as a reference image whose periodic image is the mean tile of the rest."""
    rows, columns = np.flatnonzero(part.any(1)), np.flatnonzero(part.any(0))
    crop = sample[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    rest = _folded(seen, lattice, ~part)
    shifted = lattice.shifted((-float(columns[0]), -float(rows[0])))
    return ReferenceImage(crop, rest.on(shifted))


def _folded(sample: Values, lattice: Lattice, mask: NDArray[np.bool_]) -> Periodic:
    """Return the sample's mean tile, and its variance across tiles: a mean of n tiles takes 1/n of it."""
    tile = fold(sample, lattice, mask)
    cells = max(float(mask.sum()) / lattice.area, 1.5)
    departures = ((sample - tile.unfold(sample.shape[:2])) ** 2).mean(-1, keepdims=True)
    return Periodic(lattice, tile, fold(departures * np.float32(cells / (cells - 1)), lattice, mask))


def _sample_share(sample: Values, lattice: Lattice) -> float:
    """Return the regular share of a sample, on the scale of a model's.

    Folding smooths: with one sample a pixel the mean tile loses a fourth of the variance of thin joints. So the tile is
    sampled twice as finely, what a second folding loses is put back, and 1/n of the departures, which a mean of n tiles
    keeps, is taken out.
    """
    rows, columns = tile_grid(lattice)
    grid, shape = (2 * rows, 2 * columns), sample.shape[:2]
    once = fold(sample, lattice, grid=grid).unfold(shape)
    twice = fold(once, lattice, grid=grid).unfold(shape)
    total, regular, kept = (float(one.var((0, 1), dtype=np.float64).mean()) for one in (sample, once, twice))
    share, left = regular**2 / max(kept * total, 1e-12), lattice.area / (shape[0] * shape[1])
    return float(np.clip((share - left) / max(1 - left, 1e-12), 0, 1))


def _share(ideal: Values, departures: float) -> float:
    """Return the variance of the periodic image (mean over channels) over that plus the departures'."""
    regular = float(ideal.var((0, 1), dtype=np.float64).mean())
    return regular / max(regular + departures, 1e-12)


def _draw(again: Again, shape: Shape, k: int) -> Texture:
    draw = again(shape, k)
    if draw is None:
        raise ValueError(f"the texture's model gave no fresh draw of {shape[1]}x{shape[0]} px")
    return draw


def _ideal(texture: Texture) -> Values:
    if texture.ideal is None:
        raise ValueError(f"texture {texture.name!r}: a fresh draw came without its ideal image")
    return texture.ideal
