"""Find elements that are joined along a cut, by statistics that a few whole elements suffice to learn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from nrbench.imaging.mean_tile import Values

from .composite_tiles import Levels, Rows
from .elements import Box

Colors = NDArray[np.float64]
"""``(n, k, C)``: one color for each of n windows and k cuts."""
Covariances = NDArray[np.float64]
"""``(k, C, C)``: one covariance of colors for each cut."""
_DIRECTIONS, _OFFSETS = 8, (-0.5, -0.25, 0.0, 0.25, 0.5)
"""Number of directions of the cuts, and their distances from the middle, over half of the width of the window."""
_LEAST_SIDE, _GAP = 0.08, 0.5
"""Least share of a window on each side of a cut; distance from the cut, in samples, from which samples belong to a
side."""
_MOST_SAMPLES = 2304
"""Largest number of samples of a window. Their distance is a pixel in windows of up to 48 x 48 px."""
_ROUNDING = 0.5 / 255
"""Standard deviation of the mean of a side that is due to rounding and resampling, in values."""
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
    """

    box: Box
    sides: Values

    @classmethod
    def through(cls, box: Box) -> Cuts:
        """Return cuts in eight directions and at five distances from the middle of a window with about one sample a px.

        Cuts that leave less than 8 % of the window on one side are left out.

        Parameters
        ----------
        box
            A window; its number of samples does not matter.
        """
        lengths = np.hypot(*box.sides.T)
        step = max(float(np.sqrt(lengths.prod() / _MOST_SAMPLES)), 1.0)
        first, second = (max(round(float(length / step)), 4) for length in lengths)
        fine = Box(box.sides, (first, second))
        angles = np.repeat(np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS, len(_OFFSETS))
        normals = np.stack([np.cos(angles), np.sin(angles)])
        distances = np.tile(_OFFSETS, _DIRECTIONS) * np.abs(fine.sides @ normals).sum(0) / 2
        beyond = (fine.offsets().reshape(-1, 2) @ normals - distances) / fine.step
        sides = np.stack([beyond > _GAP, beyond < -_GAP])
        sides = sides[..., (sides.mean(1) >= _LEAST_SIDE).all(0)]
        return cls(fine, np.asarray(sides / sides.sum(1, keepdims=True), np.float32))

    def side_means(self, rows: Rows) -> tuple[Colors, Colors]:
        """Return the mean colors of both sides of windows ``(n, p C)``."""
        values = rows.reshape(len(rows), self.box.samples[0] * self.box.samples[1], -1).astype(np.float32)
        first, second = np.einsum("npc,spk->snkc", values, self.sides, optimize=True).astype(np.float64)
        return first, second


@dataclass(frozen=True)
class JointTest:
    """Likelihood ratios of joined to whole, one for each cut through a window.

    Let a and b be the mean colors of the two sides of a cut, less their means over the windows. If the element has a
    tone of its own, a and b go together, and a - b has a small covariance W over whole elements. If the sides belong to
    two elements, a and b are independent, and a - b has the covariance C = cov a + cov b. The ratio is that of both
    Gaussians. Where joints run or elements have no tone, W is near C, and the cut gives no evidence. So the outline of
    the elements need not be known. The sides are means of many pixels, so a feathered or blurred joint is as visible as
    a hard one.

    The evidence is ``2 log(1 + r)`` with the mean r of the ratios over the cuts. Each cut has few parameters, which two
    dozen windows determine. :class:`~.composite_tiles.Discriminant`, which learns a covariance of all samples of a
    window, needs hundreds.

    Parameters
    ----------
    cuts
        The cuts.
    precision
        ``(k, C, C)``: W^-1 - C^-1.
    offset
        ``(k,)``: log det C - log det W.
    """

    cuts: Cuts
    precision: Covariances
    offset: Levels

    @classmethod
    def fit(cls, cuts: Cuts, rows: Rows, light: Levels | None) -> JointTest:
        """Fit the test to whole windows.

        Parameters
        ----------
        cuts
            The cuts.
        rows
            ``(n, p C)``: at least two windows, less their mean.
        light
            ``(C,)``: a step of one gray level along each axis of color: steps of light are no evidence. None: they are.
        """
        first, second = cuts.side_means(rows)
        least = np.eye(first.shape[-1]) * 2 * _ROUNDING**2
        if light is not None:
            least = least + _LIGHT**2 * np.outer(light, light)
        joined = _covariances(first) + _covariances(second) + least
        whole = _covariances(first - second) + least
        offset = np.linalg.slogdet(joined)[1] - np.linalg.slogdet(whole)[1]
        return cls(cuts, np.linalg.inv(whole) - np.linalg.inv(joined), offset)

    def evidence(self, rows: Rows) -> Levels:
        """Return the evidence of each window ``(n, p C)``, ``(n,)``: positive."""
        first, second = self.cuts.side_means(rows)
        away = first - second
        ratios = np.einsum("nkc,kcd,nkd->nk", away, self.precision, away, optimize=True) - self.offset
        return np.asarray(2 * np.logaddexp(0, logsumexp(ratios / 2, axis=1) - np.log(ratios.shape[1])))


def _covariances(colors: Colors) -> Covariances:
    """Return the covariances of colors with mean 0."""
    return np.asarray(np.einsum("nkc,nkd->kcd", colors, colors, optimize=True) / max(len(colors) - 1, 1))
