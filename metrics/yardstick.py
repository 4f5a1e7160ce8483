"""What a synthesis is measured against: the periodic image that it should follow, and textures that do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.door import Image
from nrbench.imaging.fold import Tile, Values, fold
from nrbench.lattice.geometry import Lattice
from nrbench.synthesis import Again, Observation
from nrbench.texture import Shape, Texture

FIRST_DRAW = 1 << 16
"""Fresh draws from here on are the judge's own: the oracle and the planted defects use others."""
DRAWS = 4
_TILES_A_SIDE = 9
_SIDES = (160, 384)
_VARIANCE_FLOOR = 0.1


@dataclass(frozen=True)
class Periodic:
    """The periodic image that a texture follows, and how much each of its pixels varies from tile to tile.

    Parameters
    ----------
    lattice
        Reduced, in the pixel coordinates of ``ideal``.
    ideal
        From a shape to the periodic image of that shape, its first pixel at (0, 0).
    variance
        Mean tile of the squared departures, one channel.
    """

    lattice: Lattice
    ideal: Callable[[Shape], Values]
    variance: Tile

    def patch(self, shape: Shape) -> tuple[Values, NDArray[np.float32]]:
        """Return the periodic image and the weight of each pixel: the inverse of its variance across tiles.

        A tenth of the mean variance (and that of rounding to 8 bits) is added to every pixel's, so that no few pixels
        carry all the weight. The weights' mean is 1.
        """
        variance = self.variance.unfold(shape)[..., 0]
        weights = 1 / (variance + _VARIANCE_FLOOR * self.variance.values.mean() + 1 / 255**2)
        return self.ideal(shape), np.asarray(weights / weights.mean(), np.float32)


@dataclass(frozen=True)
class Reference:
    """An image that is known to be right, and the periodic image that it follows."""

    image: Image
    periodic: Periodic


@dataclass(frozen=True)
class Yardstick:
    """What an output is compared with.

    Parameters
    ----------
    source
        ``"model"``: ideal image and fresh draws of the texture's model; ``"sample"``: mean tile of the sample, and
        the sample itself, each half judged by the mean tile of the other.
    periodic
        What the output should follow.
    references
        What an output like the texture looks like.
    regular_share
        Share of the regular part in the variance, in [0, 1].
    """

    source: Literal["model", "sample"]
    periodic: Periodic
    references: tuple[Reference, ...]
    regular_share: float

    @property
    def lattice(self) -> Lattice:
        """The true lattice, reduced, in the sample's coordinates."""
        return self.periodic.lattice


def tile_box(lattice: Lattice) -> NDArray[np.float64]:
    """Return width and height of the upright box that stands for one cell.

    It has the spread of the cell along x and y: sqrt(t1^2 + t2^2) componentwise, with the reduced basis.
    """
    return np.asarray(np.sqrt((lattice.reduced().matrix ** 2).sum(0)))


def yardstick(observation: Observation) -> Yardstick | None:
    """Return what the output is to be measured against; None where the truth has no lattice."""
    truth = observation.truth
    if truth is None or truth.lattice is None:
        return None
    if observation.again is not None and truth.ideal is not None:
        return model_yardstick(truth, truth.lattice.reduced(), observation.again)
    return sample_yardstick(observation.sample, truth.lattice.reduced())


def model_yardstick(truth: Texture, lattice: Lattice, again: Again) -> Yardstick:
    """Return the yardstick of a texture whose model is known."""
    side = np.clip(np.ceil(_TILES_A_SIDE * tile_box(lattice)), *_SIDES).astype(int)
    shape = (int(side[1]), int(side[0]))
    draws = [_draw(again, shape, FIRST_DRAW + k) for k in range(DRAWS)]
    departures = np.mean([(draw.image - _ideal(draw)) ** 2 for draw in draws], 0).mean(-1, keepdims=True)
    variance = fold(departures, lattice)
    periodic = Periodic(lattice, lambda wanted: _ideal(_draw(again, wanted, FIRST_DRAW)), variance)
    share = truth.regular_share
    if share is None:
        share = regular_share(_ideal(draws[0]), float(departures.mean()))
    return Yardstick("model", periodic, tuple(Reference(draw.image, periodic) for draw in draws), share)


def sample_yardstick(sample: Image, lattice: Lattice) -> Yardstick:
    """Return the yardstick of a sample of which only the lattice is known."""
    x, y = np.arange(sample.shape[1]) < sample.shape[1] // 2, np.arange(sample.shape[0]) < sample.shape[0] // 2
    first = np.broadcast_to(x, sample.shape[:2]) if sample.shape[1] >= sample.shape[0] else _rows(y, sample)
    whole = _folded(sample, lattice, np.ones(sample.shape[:2], np.bool_))
    references = tuple(_crossed(sample, lattice, half) for half in (first, ~first))
    share = regular_share(whole.ideal(sample.shape[:2]), float(whole.variance.values.mean()))
    return Yardstick("sample", whole, references, share)


def regular_share(ideal: Values, departures: float) -> float:
    """Return the variance of the periodic image (mean over channels) over that plus the departures'."""
    regular = float(ideal.var((0, 1), dtype=np.float64).mean())
    return regular / max(regular + departures, 1e-12)


def _rows(mask: NDArray[np.bool_], image: Image) -> NDArray[np.bool_]:
    return np.broadcast_to(mask[:, np.newaxis], image.shape[:2])


def _crossed(sample: Image, lattice: Lattice, half: NDArray[np.bool_]) -> Reference:
    """Return one half of the sample, to be judged by the mean tile of the other half."""
    rows, columns = np.flatnonzero(half.any(1)), np.flatnonzero(half.any(0))
    crop = sample[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    other = _folded(sample, lattice, ~half)
    x, y = float(columns[0]), float(rows[0])
    shifted = lattice.shifted((-x, -y))

    def ideal(shape: Shape) -> Values:
        return other.ideal((shape[0] + int(y), shape[1] + int(x)))[int(y) :, int(x) :]

    variance = Tile(other.variance.values, other.variance.counts, shifted)
    return Reference(crop, Periodic(shifted, ideal, variance))


def _folded(sample: Image, lattice: Lattice, mask: NDArray[np.bool_]) -> Periodic:
    tile = fold(sample, lattice, mask)
    cells = max(float(mask.sum()) / lattice.area, 1.5)
    departures = ((sample - tile.unfold(sample.shape[:2])) ** 2).mean(-1, keepdims=True) * np.float32(
        cells / (cells - 1)
    )
    return Periodic(lattice, tile.unfold, fold(departures, lattice, mask))


def _draw(again: Again, shape: Shape, k: int) -> Texture:
    draw = again(shape, k)
    if draw is None:
        raise ValueError(f"the texture's model gave no fresh draw of {shape[1]}x{shape[0]} px")
    return draw


def _ideal(texture: Texture) -> Values:
    if texture.ideal is None:
        raise ValueError(f"texture {texture.name!r}: a fresh draw came without its ideal image")
    return texture.ideal
