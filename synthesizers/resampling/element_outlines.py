"""The outlines of a sample's elements: which pixels take the color of which instance."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.mean_tile import Values, fold

from .element_colors import MOST_GAIN, ElementColors, Table, fit_gain
from .element_map import ElementMap, ElementShares, Numbers

OUTLINE_REACH = 0.05
"""Standard deviation, in s, of the Gaussian that spreads an element to where its outline may lie."""
_SHARP = 6.0
"""Exponent of the shares that are the first probabilities of elements."""
_ROUNDS = 4
"""Rounds of expectation and maximization."""
_SMOOTH = 0.7
"""px, standard deviation of the Gaussian that smooths colors before they are compared, and probabilities of places."""
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
_GAIN_SPREAD = 0.25
"""Standard deviation of gains around the share of the cells in which an element is shown."""
_DOUBT = 0.1
"""Weight of the rest by which outlines of colors are doubted, where they and those of the mean tile are mixed."""


@dataclass(frozen=True, eq=False)
class ElementOutlines:
    """The mattes of a sample's instances, and how much of their color they take.

    The color of a pixel p is gain(p) * sum over the instances around p of matte(p) * color, and the rest.

    Parameters
    ----------
    shares
        The elements around each place of the cell.
    mattes
        ``float32 (4 E, H, W)``: 1 inside an instance, 0 outside, and less than 1 in dark paint. There is one plane for
        each element and each parity of the cell of its instance, so that the instances in a plane are apart.
    gain
        ``float32 (V, U, C)``: the gains of the channels at each place of the cell, over their mean.
    """

    shares: ElementShares
    mattes: Values
    gain: Values

    @classmethod
    def fit(cls, sample: Values, mean: Values, colors: ElementColors) -> ElementOutlines:
        """Return the outlines of a sample.

        A pixel shows one of the elements around it, or the ground between them (:func:`_find_elements`). So a joint
        that lies elsewhere than in the mean tile is found where it lies, if its color differs from the elements'.
        Such outlines, and those of the mean tile, are mixed at each place of the cell as they explain its pixels best.

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
        row, column, _ = elements.places(shape)
        shares = ElementShares.of(elements, OUTLINE_REACH * elements.lattice.s)
        found, shown, shown_colors = _find_elements(sample, mean, colors, shares)
        usual, moved = np.zeros((2, 4 * elements.count, *shape), np.float32)
        for at, share, label, cell in colors.shares.within(shape):
            usual[find_plane(label, cell), *np.nonzero(at)] += share
        for matte, (at, _, label, cell) in zip(found, shares.within(shape), strict=True):
            moved[find_plane(label, cell), *np.nonzero(at)] += matte[at]
        moved = scipy.ndimage.gaussian_filter(moved, (0, _SOFTNESS, _SOFTNESS))
        outlines = cls(shares, usual, np.ones((*shown.shape, sample.shape[2]), np.float32))
        table, residual = colors.of_sample(shape), (sample - mean).astype(np.float64)
        flat = outlines.lay(table)
        doubt = float((residual - flat * shown[row, column, np.newaxis]).var()) / _GAIN_SPREAD**2
        gain = fit_gain(residual, flat, elements, shown[..., np.newaxis], doubt)
        gain = np.clip(gain, 0, MOST_GAIN).astype(np.float32)
        level = gain.mean(-1)
        usual *= level[row, column]
        moved *= np.clip(level / np.maximum(shown, _GROUND), 0, MOST_GAIN)[row, column]
        outlines = cls(
            shares, usual, np.clip(gain / np.maximum(level, 0.1)[..., np.newaxis], 0.5, 2).astype(np.float32)
        )
        rest = residual - outlines.lay(table)
        step = shown_colors - sample + rest
        gained, power = (
            scipy.ndimage.gaussian_filter(_fold(f.sum(-1), elements), 1, mode="wrap") for f in (step * rest, step**2)
        )
        moved_share = np.clip(gained / (power + _DOUBT * np.square(rest).sum(-1).mean() + 1e-12), 0, 1)[row, column]
        return replace(outlines, mattes=(usual + moved_share * (moved - usual)).astype(np.float32))

    def lay(self, table: Table) -> NDArray[np.float64]:
        """Return the color of the elements at each pixel of the sample, from a table of its instances."""
        shape = self.mattes.shape[1:]
        corner = self.shares.elements.cells(shape)[0, 0]
        laid = np.zeros((*shape, table.shape[-1]))
        for at, _, label, cell in self.shares.within(shape):
            i, j = (cell - corner).T
            laid[at] += self.mattes[find_plane(label, cell), *np.nonzero(at)][:, np.newaxis] * table[label, i, j]
        row, column, _ = self.shares.elements.places(shape)
        return np.asarray(laid * self.gain[row, column], np.float64)

    def read(self, label: Numbers, cell: Numbers, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the mattes of n instances at one place (x, y) of the sample each, ``(n,)``."""
        planes, matte = find_plane(label, cell), np.empty(len(label))
        for plane in np.flatnonzero(np.bincount(planes)):
            at = planes == plane
            x, y = places[at].T
            matte[at] = scipy.ndimage.map_coordinates(self.mattes[plane], [y, x], order=1, mode="mirror")
        return matte


def find_plane(label: Numbers, cell: Numbers) -> Numbers:
    """Return the plane of mattes that holds instances, from their elements ``(...)`` and their cells ``(..., 2)``."""
    return np.asarray(4 * label + 2 * (cell[..., 0] % 2) + cell[..., 1] % 2)


def _find_elements(
    sample: Values, mean: Values, colors: ElementColors, shares: ElementShares
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the probability that a pixel shows each element around it, ``(R, H, W)``, and that a place shows any.

    The third value is the color that is expected at each pixel, ``(H, W, C)``.

    Elements and the ground each have a normal distribution of colors, and a probability at each place of the cell.
    These probabilities, and those of pixels given their colors, are estimated in turn (expectation and maximization;
    Dempster, Laird and Rubin 1977).
    """
    elements, shape, channels = shares.elements, sample.shape[:2], sample.shape[2]
    row, column, _ = elements.places(shape)
    smooth = scipy.ndimage.gaussian_filter(sample.astype(np.float64), (_SMOOTH, _SMOOTH, 0))
    core = (shares.share[0] > _CORE)[row, column]
    own = _expect_colors(shares, mean, core, colors.of_sample(shape))
    expected = np.concatenate([own[:1], own])
    spread = np.full(len(expected), np.square(smooth - own[0])[core].mean() + 1e-5)
    gain = np.clip(colors.gain.mean(-1).astype(np.float64), 0, 1)
    chance = shares.share**_SHARP
    chance = np.concatenate([(1 - gain)[np.newaxis], gain * chance / chance.sum(0)])
    possible = np.concatenate([np.ones((1, *gain.shape), bool), shares.share > 0])
    ground = np.clip(1 - gain / _GROUND, 0, 1)[row, column]
    possible[0] = ground.mean() > _LEAST_GROUND
    for _ in range(_ROUNDS):
        if possible[0].any():
            expected[0] = np.average(smooth.reshape(-1, channels), 0, ground.ravel())
            spread[0] = np.average(np.square(smooth - expected[0]).mean(-1), weights=ground) + 1e-5
        width = spread[:, np.newaxis, np.newaxis]
        fit = -np.square(smooth - expected).sum(-1) / (2 * width) - channels / 2 * np.log(width)
        fit = np.where(possible[:, row, column], fit, -np.inf)
        found = np.maximum(chance, _SEEN)[:, row, column] * np.exp(fit - fit.max(0))
        found /= found.sum(0)
        ground = found[0] + 1e-9
        chance = np.stack([_fold(one, elements) for one in found])
        chance = scipy.ndimage.gaussian_filter(chance, (0, _SMOOTH, _SMOOTH), mode="wrap")
    return found[1:], chance[1:].sum(0), (found[..., np.newaxis] * expected).sum(0)


def _fold(values: NDArray[np.float64], elements: ElementMap) -> NDArray[np.float64]:
    """Return the mean of values ``(H, W)`` over all cells, on the grid of elements."""
    tile = fold(values[..., np.newaxis].astype(np.float32), elements.lattice, grid=elements.label.shape)
    return tile.values[..., 0].astype(np.float64)


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
