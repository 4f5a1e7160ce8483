"""Departures: how a draw differs from its ideal image, element by element and as a whole.

Jitter moves elements by a quarter of s, however small they are. Where neighbors move farther apart than they are broad,
the picture folds over. So small elements move independently only as far as their breadth allows. The rest of the
displacement is shared with their neighbors: it consists of waves whose length is proportional to their amplitude.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Kind, Shape

from .materials import Material
from .pattern import Displacement, Field, Layer, Pattern
from .random_fields import (
    WAVES,
    factor_variance,
    factors,
    grain,
    ink_shares,
    palette,
    role_seed,
    uniform,
    unit,
    waves,
)
from .recomposition import Draw, Reader

_INDEPENDENT = 0.27
"""Largest standard deviation of the independent jitter of small elements, as a share of their breadth."""
_STRETCH = 22.0
"""Length of the waves of the shared jitter over its standard deviation. Its gradients then have a standard deviation
of 0.2."""

Elements = dict[str, NDArray[np.float64]]
"""``NAME.index`` ``(n, k)``, ``NAME.factor`` ``(n, 3)``, ... of the n elements in the picture, for each kind."""


@dataclass(frozen=True)
class Departures:
    """The strengths of all departures, in [0, 1], as in :class:`~.model.Model`, and two lengths in px.

    Parameters
    ----------
    s
        Length of the shortest lattice vector: the unit of displacements.
    element_size
        Typical breadth of an element. The holes of worn elements, and the seams between displaced elements, are a
        fraction of it.
    material, rotation
        What the surface shows beside the tints, None if nothing; the direction of its streaks in degrees.
    inks
        Number of colors of each kind of element; 0 if colors are continuous.
    """

    color: float
    intensity: float
    noise: float
    light: float
    damage: float
    missing: float
    jitter: float
    bend: float
    s: float
    element_size: float
    material: Material | None = None
    rotation: float = 0.0
    inks: int = 0

    @property
    def kind(self) -> Kind:
        """``"I"`` if only colors depart, ``"II"`` if only places depart, ``"III"`` if both depart, else ``"0"``."""
        colors = (
            self.color or self.intensity or self.noise or self.light or self.damage or self.missing or self.material
        )
        places = self.jitter or self.bend
        return "III" if colors and places else "II" if places else "I" if colors else "0"

    @property
    def spread(self) -> float:
        """Standard deviation in px, along each axis, of displacements: of elements by jitter, of pixels by bend."""
        return 0.25 * self.s * math.hypot(self.jitter, self.bend)

    @property
    def margin(self) -> int:
        """Number of px around the picture that :meth:`displacement` needs."""
        return math.ceil(4 * self._seam) if self.jitter else 0

    @property
    def reach(self) -> int:
        """Largest distance, px, by which content can move along either axis."""
        waves_bound = math.sqrt(2 * WAVES) * (0.25 * self.s * self.bend + self._shared)
        return math.ceil(waves_bound + math.sqrt(3) * self._independent)

    @property
    def _independent(self) -> float:
        """Standard deviation in px of the independent jitter of elements. More would fold the picture over.

        Elements half as broad as s, with few seams, move independently up to a strength of 0.8.
        """
        share = max(_INDEPENDENT, 0.8 * self.element_size / self.s)
        return min(0.25 * self.s * self.jitter, share * self.element_size)

    @property
    def _shared(self) -> float:
        """Standard deviation in px of the jitter that elements share with their neighbors: the rest."""
        rest = (0.25 * self.s * self.jitter) ** 2 - self._independent**2
        return math.sqrt(rest) if rest > 1e-9 * self.s**2 else 0.0

    @property
    def _seam(self) -> float:
        """Standard deviation in px of the Gaussian across seams. It is limited so that elements do not fold over."""
        size = self.element_size
        return min(max(0.25 * self.s * self.jitter, 0.1 * size), 0.3 * size)

    def displacement(self, around: Pattern, shape: Shape, seed: int, numbers: Draw) -> Displacement:
        """Return the displacement (x, y) px of the content at each pixel, ``(H, W, 2)``.

        Parameters
        ----------
        around
            The pattern on the picture and :attr:`margin` px around it. Each element moves as a whole, except for the
            shared waves. The space between two elements is stretched.
        shape, seed
            Shape (height, width) of the picture, and seed of the draw.
        numbers
            The draw whose random numbers the elements take.
        """
        moved = np.zeros((*shape, 2))
        if self.bend:
            moved += self._waves("bend", 0.25 * self.s * self.bend, 5 * self.s, shape, seed)
        if self.jitter:
            moved += self._jitter(around, numbers)
        if self._shared:
            moved += self._shared_jitter(shape, seed)
        return moved

    def _waves(self, role: str, spread: float, period: float, shape: Shape, seed: int) -> Displacement:
        return np.stack([spread * waves(role_seed(seed, f"{role}.{axis}"), shape, period) for axis in range(2)], -1)

    def _shared_jitter(self, shape: Shape, seed: int) -> Displacement:
        """Return the displacement that neighbors share. Its waves are so long that the picture does not fold over."""
        return self._waves("drift", self._shared, _STRETCH * self._shared, shape, seed)

    def _jitter(self, around: Pattern, numbers: Draw) -> Displacement:
        """Return the displacement of the element at each pixel, smoothed across the seams by a Gaussian."""
        weight = self._smooth(around.coverage() + 1e-3)
        moves = [self._moves(layer, number, numbers) for number, layer in enumerate(around.layers)]
        inside = slice(self.margin, -self.margin)
        fields = (reduce(np.add, axis) for axis in zip(*moves, strict=True))
        return np.stack([(self._smooth(field) / weight)[inside, inside] for field in fields], -1)

    def _moves(self, layer: Layer, number: int, numbers: Draw) -> list[Field]:
        """Return the independent displacement of each element along x and y, times its coverage, at each point."""
        census = layer.census()
        table = self._move_table(layer.name, numbers.elements(number, census.index), numbers.seed)
        return [layer.coverage * column.take(census.row) for column in np.ascontiguousarray(table.T)]

    def _move_table(self, name: str, index: NDArray[np.int64], seed: int) -> NDArray[np.float64]:
        parts = [column[:, np.newaxis] for column in index.T]
        return self._independent * uniform(role_seed(seed, f"{name}.jitter"), *parts, np.arange(2))

    def _smooth(self, field: Field) -> Field:
        kernel = np.exp(-(np.arange(-self.margin, self.margin + 1) ** 2) / (2 * self._seam**2))
        kernel /= kernel.sum()
        return np.asarray(scipy.ndimage.correlate1d(scipy.ndimage.correlate1d(field, kernel, 0), kernel, 1))

    def paint(self, pattern: Pattern, seed: int, numbers: Draw) -> tuple[Image, Elements]:
        """Return the image, not yet clipped, and the elements in it with their departures.

        Parameters
        ----------
        pattern, seed
            The displaced pattern, and the seed of the draw.
        numbers
            The draw whose random numbers the elements and the pixels take. The light is always that of ``seed``.
        """
        read = numbers.reader(pattern) if self.noise or self.damage else None
        elements: Elements = {}
        layers, tables = [], []
        for layer, factor, truth in self._depart(pattern, seed, numbers, read):
            layers.append(layer)
            tables.append(factor)
            for name, rows in truth.items():
                elements[name] = np.concatenate([elements[name], rows]) if name in elements else rows
        image = replace(pattern, layers=tuple(layers)).ground_image()
        for layer, factor in zip(layers, tables, strict=True):
            image += layer.paint() * factor
        shape = image.shape[:2]
        if self.light:
            gradient = waves(role_seed(seed, "light"), shape, 16 * self.s, count=1)
            shade = np.asarray(1 + 0.25 * self.light * gradient, np.float32)
            for plane in np.moveaxis(image, -1, 0):
                plane *= shade
        if self.material:
            self.material.add(image, pattern, seed, numbers, self.s, self.rotation)
        if read and self.noise:
            noise = read(lambda size: grain(role_seed(numbers.seed, "noise"), size))
            grains = np.float32(self.noise) * noise
            for plane in np.moveaxis(image, -1, 0):
                plane += grains
        return image, elements

    def _depart(
        self, pattern: Pattern, seed: int, numbers: Draw, read: Reader | None
    ) -> Iterator[tuple[Layer, Image, Elements]]:
        """Yield each layer with its damage, its factor at each pixel and the truth about its elements."""
        shape = pattern.layers[0].coverage.shape
        holes = read(lambda size: self._holes(size, numbers.seed)) if read and self.damage else 0.0
        shared = self._shared_jitter(shape, seed) if self._shared else None
        for number, layer in enumerate(pattern.layers):
            census = layer.census()
            visible, source = census.visible(layer.coverage), numbers.elements(number, census.index)
            truth = {"index": census.index.astype(np.float64), **self._tints(layer.name, source, numbers.seed)}
            table = truth["factor"]
            if self.damage or self.missing:
                truth["damage"] = self._losses(layer.name, source, numbers.seed)
                loss = truth["damage"].take(census.row)
                lost = np.where(loss < 1, (loss > 0) * holes, 1.0)
                layer = replace(layer, coverage=layer.coverage * (1 - lost))
            if self.jitter:
                truth["displacement"] = self._move_table(layer.name, source, numbers.seed)
            if shared is not None:
                truth["displacement"] += census.means(shared)
            named = {f"{layer.name}.{part}": rows[visible] for part, rows in truth.items()}
            yield layer, table.astype(np.float32).take(census.row, 0), named

    def _tints(self, name: str, index: NDArray[np.int64], seed: int) -> Elements:
        """Return the factor of each element and, where colors are inks, the number of its ink."""
        if not self.inks:
            return {"factor": factors(seed, name, index, self.color, self.intensity)}
        number = unit(role_seed(seed, f"{name}.ink"), *index.T)
        ink = np.searchsorted(ink_shares(self.inks).cumsum()[:-1], number, side="right")
        return {
            "factor": palette(name, self.inks, self.color, self.intensity)[ink],
            "ink": ink.astype(np.float64),
        }

    def _losses(self, name: str, index: NDArray[np.int64], seed: int) -> NDArray[np.float64]:
        """Return the share that each element has lost: 0, 0.5 (holes in it) or 1 (missing)."""
        number = unit(role_seed(seed, f"{name}.damage"), *index.T)
        worn = number < self.missing + (1 - self.missing) * self.damage
        return np.where(number < self.missing, 1.0, 0.5 * worn)

    def _holes(self, shape: Shape, seed: int) -> Field:
        """Return the share of each pixel that holes cover. They are blots, an element wide, on half of the plane."""
        slope = 2 * math.pi / self.element_size
        return np.clip(0.5 + waves(role_seed(seed, "holes"), shape, self.element_size) / slope, 0, 1)

    def regular_share(self, cell: Pattern, lattice: Lattice) -> float:
        """Return the regular share: the variance of the mean over draws, over the mean total variance.

        Parameters
        ----------
        cell
            The pattern on a grid of cell coordinates, ``(n, n)``, that covers one cell.
        lattice
            Its lattice.
        """
        mean, variance = self._moments(cell)
        regular = mean.var((0, 1), dtype=np.float64).mean()
        remaining = self._unblurred_share(mean, lattice) if self.spread else 1.0
        return float(remaining * regular / (regular + variance.mean()))

    def measured_share(self, draws: Iterable[Pattern]) -> float:
        """Return the regular share over some draws of the displacements; colors and losses are integrated out.

        There is no closed form: the displacement of a pixel depends on the number of elements at the seams around it.

        Parameters
        ----------
        draws
            The displaced patterns on one grid ``(n, m)``, at least two, some periods wide.
        """
        moments = [self._moments(draw) for draw in draws]
        means = np.stack([mean for mean, _ in moments])
        height, width = means.shape[1:3]
        # The window fades out, so that broken periods at the border count for little.
        window = np.outer(np.hanning(height + 2)[1:-1], np.hanning(width + 2)[1:-1])[..., np.newaxis]
        window /= window.sum() * means.shape[-1]
        moved = float((window * means.var(0, ddof=1)).sum())
        mean = means.mean(0)
        flat = (window * mean).sum((0, 1)) * means.shape[-1]
        regular = max(float((window * (mean - flat) ** 2).sum()) - moved / len(means), 0.0)
        own = float(np.mean([(window * variance).sum() for _, variance in moments]))
        return regular / (regular + moved + own)

    def _moments(self, cell: Pattern) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return mean and variance over draws at each point, without displacements."""
        intact = (1 - self.missing) * (1 - self.damage / 2)
        ground = np.asarray(cell.ground, np.float64)
        mean = cell.ground_image().astype(np.float64)
        variance = np.zeros_like(mean)
        for layer in cell.layers:
            paint, bare = layer.paint().astype(np.float64), layer.coverage[..., np.newaxis] * ground
            expected = intact * paint + (1 - intact) * bare
            square = intact * paint**2 * (1 + factor_variance(self.color, self.intensity)) + (1 - intact) * bare**2
            mean += expected
            variance += square - expected**2
        lit = (0.25 * self.light) ** 2 * (mean**2 + variance)
        if self.material:
            lit += self.material.variance(mean, variance + lit, cell) - variance - lit
        return mean, variance + lit + self.noise**2

    def _unblurred_share(self, mean: NDArray[np.float64], lattice: Lattice) -> float:
        """Return the share of the periodic image's variance that remains when each point moves by :attr:`spread`.

        The mean over normal displacements is the image under a Gaussian: a product in the cell's Fourier series.
        """
        power = (np.abs(np.fft.fft2(mean, axes=(0, 1))) ** 2).sum(-1)
        power[0, 0] = 0
        order = np.fft.fftfreq(len(mean), 1 / len(mean))
        wave_vectors = np.stack(np.meshgrid(order, order), -1) @ np.linalg.inv(lattice.matrix).T
        gain = np.exp(-((2 * math.pi * self.spread) ** 2) * (wave_vectors**2).sum(-1))
        return float((power * gain).sum() / power.sum())
