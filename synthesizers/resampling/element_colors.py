"""The colors of a sample's elements: a model of them, and new random colors that vary as they do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.mean_tile import Values, fold
from nrbench.plugins.forms import Shape

from ..lattice_places.equal_places import CellTorus
from .element_classes import draw_classes, group_colors
from .element_map import ElementMap, ElementShares, InstanceColors, Numbers
from .element_threads import ElementThread, link_threads

Table = NDArray[np.float64]
"""``(E, I, J, C)``: the color of each element in a box of cells."""

_SOFTNESS = 0.5
"""px, standard deviation of the Gaussian that softens the borders between the colors of elements."""
_CORE = 0.95
"""Share from which a place is inside its element, where its color is measured."""
_ROUNDS = 3
"""Fits of colors, with a fit of gains between two of them."""
MOST_GAIN = 1.6
"""Largest gain."""
_SMOOTH = 0.7
"""Standard deviation, in places of the cell, of the Gaussian that smooths gains."""
_REACH = 2
"""Largest lag, in cells, at which colors are correlated."""
_CHANCE = 2.5
"""Correlations of fewer standard errors count as 0."""
_BASES = 8
"""Orthonormal bases along whose axes colors are moved."""
_LEVELS = (np.arange(64) + 0.5) / 64
"""The quantiles that are moved."""


@dataclass(frozen=True)
class ElementColors:
    """A model of a sample's residual, the sample without its mean tile.

    residual(p) = gain(p) * sum over the elements k around p of share_k(p) * color_k + rest(p)

    The gain says how much of its element's color a place of the cell takes: 1 in the middle of an element, 0 on a joint
    that has one color everywhere.

    Parameters
    ----------
    shares
        The shares of elements in places.
    gain
        ``float32 (V, U, C)``, on the same grid.
    threads
        The thread of each element.
    colors
        The colors of the threads by their first element, in a box of numbers of threads from ``low`` on.
    low
        The first numbers of the box.
    """

    shares: ElementShares
    gain: Values
    threads: Sequence[ElementThread]
    colors: Mapping[int, InstanceColors]
    low: Numbers

    @classmethod
    def fit(cls, elements: ElementMap, residual: Values) -> ElementColors:
        """Return the model of a residual: colors and gains are fitted in turn, by least squares.

        A gain is drawn to 1 as far as noise hides it. Its mean inside elements is 1.
        """
        shape, channels = residual.shape[:2], residual.shape[2]
        shares = ElementShares.of(elements, _SOFTNESS)
        regions = elements.mean_colors(residual)
        threads = link_threads(regions, elements.lattice)
        core = shares.share[0] > _CORE
        row, column, _ = elements.places(shape)
        parts = np.stack([region.shown for region in regions])
        seen = parts > 0
        number = np.stack([thread.number(elements.cells(shape)) for thread in threads])[seen]
        low, first = number.min(0), np.array([thread.first for thread in threads])
        index = first[np.nonzero(seen)[0]], *(number - low).T
        box = len(threads), *(number.max(0) - low + 1)
        shown = np.zeros(box)
        np.maximum.at(shown, index, parts[seen])
        gain = np.ones((*core.shape, channels), np.float32)
        for turn in range(_ROUNDS):
            weight = gain[row, column] * core[row, column, np.newaxis]
            sums = np.zeros((*box, 2 * channels))
            np.add.at(sums, index, elements.sum_pixels(np.concatenate([weight * residual, weight**2], -1))[seen])
            values = sums[..., :channels] / np.maximum(sums[..., channels:], 1e-9)
            colors = {k: InstanceColors(values[k], shown[k]) for k in sorted(set(first.tolist()))}
            model = cls(shares, gain, threads, colors, low)
            if turn == _ROUNDS - 1:
                break
            flat = model.lay(model.of_sample(shape), shape)
            noise = (residual - flat * gain[row, column]).var((0, 1))
            gain = fit_gain(residual, flat, elements, 1.0, noise)
            gain = np.clip(gain / gain[core].mean(0), 0, MOST_GAIN).astype(np.float32)
        return model

    def spread(self, colors: Mapping[int, Table], low: Numbers, shape: Shape) -> Table:
        """Return the color of each instance in a picture, on the box of :meth:`ElementMap.cells`.

        Parameters
        ----------
        colors
            The colors of the threads by their first element, in a box of numbers from ``low`` on. Numbers outside take
            the nearest color.
        low
            The first numbers.
        shape
            Shape of the picture.
        """
        cells = self.shares.elements.cells(shape)
        table = []
        for thread in self.threads:
            values = colors[thread.first]
            i, j = np.moveaxis(np.clip(thread.number(cells) - low, 0, np.array(values.shape[:2]) - 1), -1, 0)
            table.append(values[i, j])
        return np.stack(table)

    def lay(self, table: Table, shape: Shape) -> NDArray[np.float64]:
        """Return the color of the elements at each pixel of a picture, before the gain."""
        corner = self.shares.elements.cells(shape)[0, 0]
        laid = np.zeros((*shape, table.shape[-1]))
        for at, share, label, cell in self.shares.within(shape):
            laid[at] += share[:, np.newaxis] * table[label, *(cell - corner).T]
        return laid

    def render(self, table: Table, shape: Shape) -> NDArray[np.float64]:
        """Return the colors at each pixel of a picture, with the gain."""
        row, column, _ = self.shares.elements.places(shape)
        return np.asarray(self.lay(table, shape) * self.gain[row, column])

    @cached_property
    def classes(self) -> dict[int, Numbers]:
        """The classes of the threads' colors, where they form classes (:func:`.element_classes.group_colors`)."""
        found = {name: group_colors(color) for name, color in self.colors.items()}
        return {name: classes for name, classes in found.items() if classes is not None}

    @cached_property
    def _means(self) -> dict[int, Table]:
        """The mean color of each class, ``(K, C)``."""
        return {
            name: np.stack([self.colors[name].values[own == k].mean(0) for k in range(own.max() + 1)])
            for name, own in self.classes.items()
        }

    def of_sample(self, shape: Shape) -> Table:
        """Return the sample's own colors, for :meth:`lay` and :meth:`render`."""
        return self.spread({k: c.values for k, c in self.colors.items()}, self.low, shape)

    def of_classes(self, shape: Shape) -> Table:
        """Return the sample's own colors; for elements that are in classes, the mean of the class."""
        means = {name: self._means[name][own] for name, own in self.classes.items()}
        return self.spread({k: c.values for k, c in self.colors.items()} | means, self.low, shape)

    def on_torus(self, torus: CellTorus) -> ElementColors:
        """Return the model for an output that repeats: a thread runs around its edges, and may meet itself."""
        return replace(self, threads=[replace(thread, torus=torus.joined(thread.turn)) for thread in self.threads])

    def draw(self, shape: Shape, rng: np.random.Generator, torus: CellTorus | None = None) -> Table:
        """Return new colors for a picture: a Gaussian field with the sample's correlations, and its distribution.

        Where colors form classes, those are drawn (:func:`.element_classes.draw_classes`), and each has its mean color.
        """
        if torus is None:
            cells = self.shares.elements.cells(shape)
            numbers = np.stack([thread.number(cells) for thread in self.threads])
            model, low = self, numbers.min((0, 1, 2))
            torus = CellTorus.of(np.diag(np.ptp(numbers, (0, 1, 2)) + 1 + 2 * _REACH))
        else:
            model, low = self.on_torus(torus), np.zeros(2, np.int64)
        field = draw_field(list(self.colors.values()), torus, rng)
        drawn = {
            name: match_distribution(field[:, :, k], color.values[color.known], rng)
            for k, (name, color) in enumerate(self.colors.items())
        }
        classes = draw_classes(list(self.classes.values()), torus, rng)
        drawn |= {name: self._means[name][classes[..., k]] for k, name in enumerate(self.classes)}
        return model.spread(drawn, low, shape)


def fit_gain(
    residual: NDArray[np.float64] | Values,
    flat: NDArray[np.float64],
    elements: ElementMap,
    usual: NDArray[np.float64] | float,
    doubt: NDArray[np.float64] | float,
) -> NDArray[np.float64]:
    """Return how much of its color each place of the cell takes, ``(V, U, C)``, by least squares, smoothed.

    Parameters
    ----------
    residual
        ``(H, W, C)``.
    flat
        ``(H, W, C)``: the color of the element at each pixel.
    elements
        The elements.
    usual
        The gain to which noise draws that of a place.
    doubt
        Weight of the usual gain: the variance of noise over that of gains.
    """
    product, power = (
        fold(f.astype(np.float32), elements.lattice, grid=elements.label.shape) for f in (flat * residual, flat**2)
    )
    count = power.counts[..., np.newaxis]
    gain = (product.values * count + (doubt + 1e-12) * usual) / (power.values * count + doubt + 1e-12)
    return np.asarray(scipy.ndimage.gaussian_filter(gain, (_SMOOTH, _SMOOTH, 0), mode="wrap"))


def draw_field(colors: Sequence[InstanceColors], torus: CellTorus, rng: np.random.Generator) -> Table:
    """Return standard Gaussian fields on a torus, ``(I, J, E, C)``, correlated as the colors of E elements are.

    A correlation r estimated from n pairs is shrunk by the factor 1 - (2.5 / (r sqrt(n)))^2, to 0 where it is less than
    2.5 standard errors. The cross-spectra of the elements are made positive by cutting negative eigenvalues. Channels
    are independent.
    """
    count, channels = len(colors), colors[0].values.shape[-1]
    extent = torus.columns, torus.rows
    kernel = np.zeros((*extent, count, count))
    kernel[0, 0] = np.eye(count)
    lags = [(i, j) for i in range(-_REACH, _REACH + 1) for j in range(-_REACH, _REACH + 1)]
    places = torus.wrap(np.array(lags)).tolist()
    for a, b in np.ndindex(count, count):
        for lag, (i, j) in zip(lags, places, strict=True):
            r, pairs = colors[a].correlation(colors[b], lag)
            if (a, i, j) != (b, 0, 0) and pairs * r * r > _CHANCE**2:
                kernel[i, j, a, b] = r - _CHANCE**2 / (pairs * r)
    spectrum = torus.transform(kernel)
    power, axes = np.linalg.eigh((spectrum + spectrum.conj().swapaxes(-1, -2)) / 2)
    root = axes * np.sqrt(np.maximum(power, 0))[..., np.newaxis, :]
    root /= np.sqrt((np.abs(root) ** 2).sum(-1).mean((0, 1)))[:, np.newaxis]
    # axes^H makes the root Hermitian, so that opposite frequencies are conjugate and the field is real
    root = root @ axes.conj().swapaxes(-1, -2)
    white = torus.transform(rng.standard_normal((*extent, count, channels)))
    return np.asarray(torus.invert(root @ white).real)


def match_distribution(field: Table, sample: NDArray[np.float64], rng: np.random.Generator) -> Table:
    """Return a standard Gaussian field with the distribution of some colors.

    The colors are smoothed by a Gaussian of the shape of their covariance, the wider the fewer they are; the covariance
    stays the same. Gaussian colors of this covariance are moved to them by sliced transport (Pitie, Kokaram and Dahyot
    2007, section 3): along one direction after the other, quantiles go to quantiles.

    Parameters
    ----------
    field
        ``(..., C)``.
    sample
        ``(n, C)``.
    rng
        Draws the smoothed colors and the directions.
    """
    count, channels = sample.shape
    if count < 2:
        return np.zeros_like(field)
    power, axes = np.linalg.eigh(np.atleast_2d(np.cov(sample.T)))
    root = (axes * np.sqrt(np.maximum(power, 0))).T
    width = 0.6 * count ** (-1 / 7)
    size = (max(4096, 8 * count), channels)
    target = (sample[rng.integers(count, size=size[0])] - sample.mean(0)) * np.sqrt(count / (count - 1))
    target = (target + width * rng.standard_normal(size) @ root) / np.hypot(1, width)
    points = np.concatenate([rng.standard_normal(size) @ root, field.reshape(-1, channels) @ root])
    for _ in range(_BASES):
        for axis in np.linalg.qr(rng.standard_normal((channels, channels)))[0]:
            along = points @ axis
            old, new = _read_quantiles(along[: size[0]]), _read_quantiles(target @ axis)
            points += np.interp(along, old, new - old)[:, np.newaxis] * axis
    return np.asarray(points[size[0] :].reshape(field.shape))


def _read_quantiles(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the quantiles of values at :data:`_LEVELS`, as :func:`numpy.quantile` does, but by a sort: faster."""
    place = _LEVELS * (len(values) - 1)
    first, ranked = place.astype(np.intp), np.sort(values)
    low, high, share = ranked[first], ranked[first + 1], place - first
    return np.where(share >= 0.5, high - (high - low) * (1 - share), low + (high - low) * share)
