"""The outlines of a sample's elements: which pixels take the color of which instance."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.mean_tile import Values, fold

from .element_colors import ElementColors, Table
from .element_map import ElementMap, ElementShares, Numbers

OUTLINE_REACH = 0.05
"""Standard deviation, in s, of the Gaussian that spreads an element over its surroundings, where its outline may lie."""
_SHARP = 6.0
"""Exponent of the shares that are the first probabilities of elements."""
_ROUNDS = 4
"""Rounds of expectation and maximization."""
_SMOOTH = 0.7
"""px, standard deviation of the Gaussian that smooths the colors that are compared."""
_SEEN = 0.01
"""Smallest probability of an element at a place where its outline may lie, and of the ground."""
_CORE = 0.95
"""Share from which a place is inside its element."""
_GROUND = 0.5
"""Gain below which a place may be ground."""
_LEAST_GROUND = 0.005
"""Least share of the sample that is ground; with less there is none."""
_SOFTNESS = 0.5
"""px, standard deviation of the Gaussian that softens outlines."""
_MOST_GAIN = 1.6
_GAIN_SPREAD = 0.25


@dataclass(frozen=True, eq=False)
class ElementOutlines:
    """The mattes of a sample's instances, and the gain inside them.

    The color of a pixel p is gain(p) * sum over the instances around p of matte(p) * color, and the rest.

    Parameters
    ----------
    shares
        The elements around each place of the cell.
    mattes
        ``float32 (4 E, H, W)``: 1 inside an instance, 0 outside. There is one plane for each element and each parity of
        the cell of its instance, so that the instances in a plane are apart.
    gain
        ``float32 (V, U, C)``: how much of its color an element takes at each place of the cell, where it is shown.
    """

    shares: ElementShares
    mattes: Values
    gain: Values

    @classmethod
    def fit(cls, sample: Values, mean: Values, colors: ElementColors) -> ElementOutlines:
        """Return the outlines of a sample.

        A pixel shows one of the elements around it, or the ground between them. Each of them has a normal distribution
        of colors around its own color, and a probability at each place of the cell. Probabilities of places, and those
        of pixels given their colors, are estimated in turn (expectation and maximization). So a joint that lies
        elsewhere than in the mean tile is seen where it lies, if its color differs from those of the elements; where
        colors tell nothing, outlines are those of the mean tile.

        Parameters
        ----------
        sample
            The sample.
        mean
            Its mean tile at each pixel.
        colors
            The colors of its elements.
        """
        elements, shape = colors.shares.elements, sample.shape[:2]
        shares = ElementShares.of(elements, OUTLINE_REACH * elements.lattice.s)
        row, column, _ = elements.places(shape)
        smooth = scipy.ndimage.gaussian_filter(sample.astype(np.float64), (_SMOOTH, _SMOOTH, 0))
        core = (shares.share[0] > _CORE)[row, column]
        own = _expect_colors(shares, mean, core, colors.of_sample(shape))
        spread = np.full(len(own) + 1, np.square(smooth - own[0])[core].mean() + 1e-5)
        gain = np.clip(colors.gain.mean(-1).astype(np.float64), 0, 1)
        prior = shares.share**_SHARP
        prior = np.concatenate([(1 - gain)[np.newaxis], gain * prior / prior.sum(0)])
        possible = np.concatenate([np.ones((1, *gain.shape), bool), shares.share > 0])
        ground = np.clip(1 - gain / _GROUND, 0, 1)[row, column]
        possible[0] = ground.mean() > _LEAST_GROUND
        seen = np.concatenate([own[:1], own])
        for _ in range(_ROUNDS):
            if possible[0].any():
                seen[0] = np.average(smooth.reshape(-1, sample.shape[2]), 0, ground.ravel())
                spread[0] = np.average(np.square(smooth - seen[0]).mean(-1), weights=ground) + 1e-5
            width = spread[:, np.newaxis, np.newaxis]
            fit = -np.square(smooth - seen).sum(-1) / (2 * width) - sample.shape[2] / 2 * np.log(width)
            chance = np.where(possible, np.maximum(prior, _SEEN), 0)[:, row, column]
            found = chance * np.exp(fit - fit.max(0))
            found /= found.sum(0)
            ground = found[0]
            tile = fold(np.moveaxis(found, 0, -1).astype(np.float32), elements.lattice, grid=gain.shape).values
            prior = np.moveaxis(scipy.ndimage.gaussian_filter(tile, (_SMOOTH, _SMOOTH, 0), mode="wrap"), -1, 0)
        table, residual = colors.of_sample(shape), sample - mean
        usual, moved = np.zeros((2, 4 * elements.count, *shape), np.float32)
        for at, share, label, cell in colors.shares.within(shape):
            usual[find_plane(label, cell), *np.nonzero(at)] += share
        for matte, (at, _, label, cell) in zip(found[1:], shares.within(shape), strict=True):
            moved[find_plane(label, cell), *np.nonzero(at)] += matte[at]
        moved = scipy.ndimage.gaussian_filter(moved, (0, _SOFTNESS, _SOFTNESS))
        outlines = cls(shares, usual, np.ones((*gain.shape, sample.shape[2]), np.float32))
        flat = outlines.lay(table)
        shown = prior[1:].sum(0)[..., np.newaxis]
        draw = float((residual - flat * shown[row, column]).var()) / _GAIN_SPREAD**2
        product, power = (fold(f.astype(np.float32), elements.lattice, grid=gain.shape) for f in (flat * residual, flat**2))
        count = power.counts[..., np.newaxis]
        fitted = (product.values * count + draw * shown) / (power.values * count + draw)
        fitted = np.clip(scipy.ndimage.gaussian_filter(fitted, (_SMOOTH, _SMOOTH, 0), mode="wrap"), 0, _MOST_GAIN)
        level = fitted.mean(-1, keepdims=True)
        balance = np.clip(fitted / np.maximum(level, 0.1), 0.5, 2).astype(np.float32)
        usual *= level[row, column, 0]
        moved *= np.clip(level / np.maximum(shown, _GROUND), 0, _MOST_GAIN)[row, column, 0]
        outlines = cls(shares, usual, balance)
        rest = residual - outlines.lay(table)
        step = replace(outlines, mattes=moved - usual).lay(table)
        gained, power = (
            fold(f.sum(-1, keepdims=True).astype(np.float32), elements.lattice, grid=gain.shape).values
            for f in (step * rest, step * step)
        )
        noise = 0.1 * float(np.mean(rest**2)) * sample.shape[2]
        trust = np.clip(scipy.ndimage.gaussian_filter(gained, (1,1,0), mode="wrap") / (scipy.ndimage.gaussian_filter(power, (1,1,0), mode="wrap") + noise), 0, 1)[row, column, 0]
        return replace(outlines, mattes=usual + trust * (moved - usual))

    def lay(self, table: Table) -> NDArray[np.float64]:
        """Return the color of the elements at each pixel of the sample, from a table of its instances."""
        shape = self.mattes.shape[1:]
        corner = self.shares.elements.cells(shape)[0, 0]
        laid = np.zeros((*shape, table.shape[-1]))
        for at, _, label, cell in self.shares.within(shape):
            i, j = (cell - corner).T
            laid[at] += self.mattes[find_plane(label, cell), *np.nonzero(at)][:, np.newaxis] * table[label, i, j]
        row, column, _ = self.shares.elements.places(shape)
        return np.asarray(laid * self.gain[row, column])

    def read(self, label: Numbers, cell: Numbers, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the mattes of n instances at one place (x, y) of the sample each, ``(n,)``."""
        planes, matte = find_plane(label, cell), np.empty(len(label))
        for plane in np.unique(planes):
            at = planes == plane
            x, y = places[at].T
            matte[at] = scipy.ndimage.map_coordinates(self.mattes[plane], [y, x], order=1, mode="mirror")
        return matte


def find_plane(label: Numbers, cell: Numbers) -> Numbers:
    """Return the plane of mattes that holds instances, from their elements ``(...)`` and their cells ``(..., 2)``."""
    return np.asarray(4 * label + 2 * (cell[..., 0] % 2) + cell[..., 1] % 2)


def _expect_colors(shares: ElementShares, mean: Values, core: NDArray[np.bool_], table: Table) -> NDArray[np.float64]:
    """Return the color inside the instance of each rank around each pixel, ``(R, H, W, C)``."""
    elements: ElementMap = shares.elements
    shape = mean.shape[:2]
    label, _ = elements.instances(shape)
    inside = [core & (label == k) for k in range(elements.count)]
    usual = np.stack([mean[at].mean(0) if at.any() else mean[label == k].mean(0) for k, at in enumerate(inside)])
    corner = elements.cells(shape)[0, 0]
    expected = np.zeros((len(shares.label), *mean.shape))
    for own, (at, _, k, cell) in zip(expected, shares.within(shape), strict=True):
        own[at] = usual[k] + table[k, *(cell - corner).T]
    return expected
