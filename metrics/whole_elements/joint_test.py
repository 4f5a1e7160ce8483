"""Find elements that are joined along a cut, by statistics that a few whole elements suffice to learn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from nrbench.imaging.fold import Values
from nrbench.lattice.geometry import Points

from .composite_tiles import Levels, Rows
from .elements import Box

Covariances = NDArray[np.float64]
"""``(k, C, C)``: one covariance of colors for each cut."""
_DIRECTIONS, _OFFSETS = 8, (-0.5, -0.25, 0.0, 0.25, 0.5)
"""Number of directions of the cuts, and their distances from the middle, over half of the width of the window."""
_LEAST_SIDE = 0.08
"""Least share of a window on each side of a cut."""
_GAP, _HALF_WIDTH = 0.5, 0.8
"""Distance from a cut, in samples, from which samples belong to a side, and up to which they lie at the cut."""
_MOST_SAMPLES = 2304
"""Largest number of samples of a window. Their distance is a pixel in windows of up to 48 x 48 px."""
_ROUNDING = 0.5 / 255
"""Standard deviation of the means of a side and of gradients that is due to rounding, in values."""
_EDGE_VARIANCE = 0.01
"""Least variance of the logarithm of the energy at a cut."""
_LIGHT = 0.15
"""Standard deviation of a step of uneven light between the sides of a cut, in values."""


@dataclass(frozen=True)
class Cuts:
    """Straight cuts through a window.

    Parameters
    ----------
    box
        The shape of the window.
    sides
        ``(2, p, k)``: weights of its p samples in the mean of the first and the second side of each of k cuts.
    along
        ``(p, k)``: weights of the samples in the mean along each cut.
    normals
        ``(k, 2)``: unit vectors (x, y) across the cuts.
    """

    box: Box
    sides: Values
    along: Values
    normals: Points

    @classmethod
    def through(cls, box: Box) -> Cuts:
        """Return cuts in eight directions and at five distances from the middle of a window with about one sample a px.

        Cuts that leave less than a twelfth of the window on one side are left out.

        Parameters
        ----------
        box
            A window; its number of samples does not matter.
        """
        lengths = np.hypot(*box.sides.T)
        step = max(float(np.sqrt(lengths.prod() / _MOST_SAMPLES)), 1.0)
        first, second = (max(round(float(length / step)), 4) for length in lengths)
        fine = Box(box.sides, (first, second))
        xy, angles = fine.offsets().reshape(-1, 2), np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
        normals = np.repeat(np.stack([np.cos(angles), np.sin(angles)], -1), len(_OFFSETS), 0)
        offsets = np.tile(_OFFSETS, _DIRECTIONS) * np.abs(fine.sides @ normals.T).sum(0) / 2
        beyond = (xy @ normals.T - offsets) / fine.step
        sides, along = np.stack([beyond > _GAP, beyond < -_GAP]), np.abs(beyond) < _HALF_WIDTH
        keep = (sides.mean(1) >= _LEAST_SIDE).all(0) & along.any(0)
        sides, along = sides[..., keep], along[:, keep]
        return cls(fine, *(_weights(mask) for mask in (sides, along)), normals[keep])

    def side_means(self, values: Values) -> NDArray[np.float64]:
        """Return the mean colors of both sides of windows ``(n, p, C)``, ``(2, n, k, C)``."""
        return np.einsum("npc,spk->snkc", values, self.sides, optimize=True).astype(np.float64)

    def edges(self, values: Values) -> Levels:
        """Return the logarithm of the mean squared derivative across each cut of windows ``(n, p, C)``, ``(n, k)``."""
        gradients = self._gradients(values)
        energies = np.empty((len(values), len(self.normals)))
        for normal in np.unique(self.normals, axis=0):
            cuts = np.flatnonzero((self.normals == normal).all(1))
            energies[:, cuts] = ((gradients @ normal.astype(np.float32)) ** 2).sum(-1) @ self.along[:, cuts]
        return np.asarray(np.log(energies + _ROUNDING**2))

    def joined_edges(self, values: Values) -> Levels:
        """Return the same at each cut, if the second side of the cut shows another window, ``(n, k)``."""
        others = _partners(values)
        energies = np.empty((len(values), len(self.normals)))
        for cut, normal in enumerate(self.normals):
            joined = np.where((self.sides[1, :, cut] > 0)[:, np.newaxis], others, values)
            gradients = self._gradients(joined)[:, self.along[:, cut] > 0]
            energies[:, cut] = ((gradients @ normal.astype(np.float32)) ** 2).sum(-1).mean(1)
        return np.asarray(np.log(energies + _ROUNDING**2))

    def _gradients(self, values: Values) -> Values:
        """Return the derivatives along x and y, a px, of windows ``(n, p, C)``, ``(n, p, C, 2)``."""
        grid = values.reshape(len(values), *self.box.samples[::-1], values.shape[-1])
        across, along = np.gradient(grid, axis=(1, 2))
        steps = self.box.sides / np.array(self.box.samples)[:, np.newaxis]
        return np.asarray(np.stack([along, across], -1) @ np.linalg.inv(steps).T.astype(np.float32)).reshape(
            *values.shape, 2
        )


def _weights(masks: NDArray[np.bool_]) -> Values:
    return np.asarray(masks / np.maximum(masks.sum(-2, keepdims=True), 1), np.float32)


@dataclass(frozen=True)
class CutWindows:
    """What n whole windows show at k cuts.

    Parameters
    ----------
    means
        ``(2, n, k, C)``: mean colors of both sides.
    edges, joined_edges
        ``(n, k)``: energy at the cuts, of the windows and of windows joined along each cut, from :class:`Cuts`.
    levels
        ``(2, n)``: mean of the edges of the whole windows over the cuts, and that of the windows and of those that they
        are joined to.
    """

    means: NDArray[np.float64]
    edges: Levels
    joined_edges: Levels
    levels: NDArray[np.float64]

    @classmethod
    def measure(cls, cuts: Cuts, rows: Rows) -> CutWindows:
        """Measure windows ``(n, p C)`` less their mean window."""
        values = _values(cuts, rows)
        edges, joined = cuts.edges(values), cuts.joined_edges(values)
        level = edges.mean(1)
        return cls(cuts.side_means(values), edges, joined, np.stack([level, (level + _partners(level)) / 2]))

    @classmethod
    def join(cls, parts: list[CutWindows]) -> CutWindows:
        """Return the windows of several parts together."""
        return cls(
            np.concatenate([one.means for one in parts], 1),
            np.concatenate([one.edges for one in parts]),
            np.concatenate([one.joined_edges for one in parts]),
            np.concatenate([one.levels for one in parts], 1),
        )


@dataclass(frozen=True)
class JointTest:
    """A likelihood ratio of joined to whole for each cut through a window.

    The evidence is ``2 log(1 + r)`` with the mean r of the ratios over the cuts.

    *Tone.* Let a and b be the mean colors of the two sides of a cut, less their means over the windows. If the element
    has a tone of its own, a and b go together, and a - b has a small covariance W over whole elements. If the sides
    belong to two elements, a and b are independent, and a - b has the covariance C = cov a + cov b. The statistic is
    twice the log-likelihood ratio of both Gaussians. Where joints run or elements have no tone, W is near C, and the
    cut gives no evidence. So the outline of the elements need not be known.

    *Edge.* Along a hard cut the derivative across it is larger than anywhere inside whole elements. The logarithm of
    its energy has a mean and a variance over whole elements, and others over elements joined along this very cut. The
    mean over all cuts of the window is subtracted, or that of whole elements if it is larger: more contrast or less
    sharpness of the window as a whole is no evidence. The statistic is twice the
    log-likelihood ratio. A feathered joint has no edge, so the edge is used only where tones have too little power.

    Each cut has few parameters, which two dozen windows determine.
    :class:`~.composite_tiles.Discriminant`, which learns a covariance of all samples of a window, needs hundreds.

    Parameters
    ----------
    cuts
        The cuts.
    precision
        ``(k, C, C)``: W^-1 - C^-1.
    offset
        ``(k,)``: log det C - log det W.
    edges
        ``(4, k)``: mean and variance of the edge of whole and of joined windows; None: edges are not used.
    level
        Usual mean of the energies of a window over the cuts.
    """

    cuts: Cuts
    precision: Covariances
    offset: Levels
    edges: NDArray[np.float64] | None
    level: float

    @classmethod
    def fit(cls, cuts: Cuts, windows: CutWindows, light: Levels | None, edges: bool) -> JointTest:
        """Fit the test to whole windows.

        Parameters
        ----------
        cuts
            The cuts.
        windows
            At least two windows.
        light
            ``(C,)``: a step of one gray level along each axis of color: steps of light are no evidence. None: they are.
        edges
            Whether edges are evidence.
        """
        first, second = windows.means
        least = np.eye(first.shape[-1]) * 2 * _ROUNDING**2
        if light is not None:
            least = least + _LIGHT**2 * np.outer(light, light)
        whole = _covariances(first - second) + least
        joined = _covariances(first) + _covariances(second) + least
        offset = np.linalg.slogdet(joined)[1] - np.linalg.slogdet(whole)[1]
        moments, level = None, float(windows.levels[0].mean())
        if edges:
            own, other = np.maximum(windows.levels, level)[..., np.newaxis]
            pairs = (windows.edges - own, windows.joined_edges - other)
            moments = np.stack([part for one in pairs for part in (one.mean(0), one.var(0, ddof=1) + _EDGE_VARIANCE)])
        return cls(cuts, np.linalg.inv(whole) - np.linalg.inv(joined), offset, moments, level)

    def evidence(self, tiles: Rows) -> Levels:
        """Return the evidence of each window ``(n, p C)``, ``(n,)``: positive."""
        values = _values(self.cuts, tiles)
        first, second = self.cuts.side_means(values)
        away = first - second
        ratio = np.einsum("nkc,kcd,nkd->nk", away, self.precision, away, optimize=True) - self.offset
        if self.edges is not None:
            own, (usual, variance, joined, spread) = self.cuts.edges(values), self.edges
            own = np.maximum(own - np.maximum(own.mean(1, keepdims=True), self.level), usual)
            ratio += (own - usual) ** 2 / variance - (own - joined) ** 2 / spread - np.log(spread / variance)
        return np.asarray(2 * np.logaddexp(0, logsumexp(ratio / 2, axis=1) - np.log(ratio.shape[1])))


def _partners(windows: Values | Levels) -> Values | Levels:
    """Return for each window the one that it is joined to: a third of all windows away."""
    return np.roll(windows, 1 + len(windows) // 3, 0)


def _values(cuts: Cuts, rows: Rows) -> Values:
    first, second = cuts.box.samples
    return np.asarray(rows.reshape(len(rows), first * second, -1), np.float32)


def _covariances(colors: NDArray[np.float64]) -> Covariances:
    """Return the covariances of ``(n, k, C)`` with mean 0 over n windows."""
    return np.asarray(np.einsum("nkc,nkd->kcd", colors, colors, optimize=True) / max(len(colors) - 1, 1))
