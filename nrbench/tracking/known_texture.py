"""Follow the lattice of a known texture through an image, however much the image is bent."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.convert import Image, subtract_color
from nrbench.imaging.mean_tile import Values, interpolate
from nrbench.lattice.geometry import Points
from nrbench.tracking.growth import TRUNCATED, Window, spread_window
from nrbench.tracking.tracker import MeanTile, cell_covariance, correlation_surfaces, label_displacements

__all__ = ["FollowedImage", "follow_texture"]

_WIDTH = 1.1
"""Width in tiles of the window of a knot."""
_SAMPLES: Final = 120
"""Number of points of a window that are read, if it holds as many pixels."""
_SPREAD = 0.3
"""Standard deviation of a knot's departure from its prediction: of the place, in s, and of the affine map."""
_BLUR = 0.5
"""Standard deviation of the Gaussian that smooths the image, over the spacing of these points."""
_PHASES = 16
"""Number of phases of a knot along each vector of a cell; a knot lies at most a 32nd of a cell beside its node."""
_MOST_PLACES = 144
"""Largest number of places that are compared with the tile to find a start."""
_CANDIDATES, _STARTS = 8, 3
"""Number of places that are registered before one is chosen, and number of starts from which the image is followed."""
_STEP = 0.4
"""Distance of nodes, and of knots, over the width and the height of a tile."""
_BEYOND = 1.0
"""Width, in s, of the part of the plane beyond the image from which content may have moved into it."""
_LEAST_LEVEL = 0.2
"""Correlation of a start to which smaller ones are raised."""
_ENOUGH = 0.6
"""Share of the image that must be covered if no other start is tried."""
_NEIGHBORS = 4
"""Number of knots from which the displacement of a node is interpolated."""
_BESIDE = 1.2
"""Distance of a node from the nearest knot, over half of the diagonal between nodes, up to which it counts as found."""
_MARGIN = 0.1
"""Correlation above the level below which a knot is searched for in other places nearby."""
_LEVELS = (0.85, 0.7, 0.55)
"""Correlation from which a knot is known, over that of the start, in each round of the growth."""


@dataclass(frozen=True, eq=False)
class FollowedImage:
    """A known texture followed through an image.

    Parameters
    ----------
    image
        The image.
    nodes
        ``(rows, columns, 2)``: (x, y) px of an upright grid of nodes, from one corner of the image to the opposite one.
    displacement
        ``(rows, columns, 2)``: (x, y) px from the place on the undisturbed lattice's plane where the content at each
        node belongs to the node. Where no content was found nearby, that of the nearest content is continued.
    correlation
        ``(rows, columns)``: correlation of the content with the mean tile, 0 where it was not found.
    """

    image: Image
    nodes: Points
    displacement: Points
    correlation: NDArray[np.float64]


def follow_texture(image: Image, tile: MeanTile) -> FollowedImage:
    """Follow the lattice of a known texture through an image, from the place where it is bent least.

    Knots on the plane of the undisturbed lattice, 0.4 tiles apart, are registered with the mean tile one after another,
    each for its place and its affine distortion (:func:`~nrbench.tracking.growth_kernels.grow_knots`). The first one is
    where a window of the image correlates best with the tile as it is. Displacements are known up to a lattice vector,
    which is the same for the whole image. Time is linear in the number of pixels.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    tile
        The mean tile, see :meth:`~nrbench.tracking.tracker.MeanTile.of`. Its phase need not fit the image.

    Examples
    --------
    >>> import nrbench
    >>> from nrbench.tracking.known_texture import follow_texture
    >>> from nrbench.tracking.tracker import MeanTile
    >>> texture = nrbench.texture("weave", shape=(128, 128), seed=0, bend=0.5)
    >>> tile = MeanTile.of(texture.ideal, texture.lattice.reduced())
    >>> bool((follow_texture(texture.image, tile).correlation > 0.5).mean() > 0.8)
    True
    """
    return _Following.of(image, tile).follow()


@dataclass(frozen=True)
class _Following:
    """All that does not depend on the start.

    Parameters
    ----------
    image, tile
        As for :func:`follow_texture`.
    planes
        ``(H, W, c)``: the smoothed image in the colors of the tile.
    nodes
        ``(rows, columns, 2)``: (x, y) px of the nodes in the image.
    points, phases
        ``(r, c, 2)`` and ``(r, c)``: (x, y) px of the knots on the plane, which reaches beyond the image, and the
        number of the phase of each.
    window
        The window of a knot.
    """

    image: Image
    planes: Values
    tile: MeanTile
    nodes: Points
    points: Points
    phases: NDArray[np.int64]
    window: Window

    @classmethod
    def of(cls, image: Image, tile: MeanTile) -> _Following:
        lattice = tile.harmonics.lattice
        size = np.array(image.shape[1::-1])
        covariance = cell_covariance(lattice)
        spread = _WIDTH**2 * covariance
        area = math.pi * TRUNCATED**2 * math.sqrt(float(np.linalg.det(spread)))
        spacing = max(math.sqrt(area / _SAMPLES), 1.0)
        offsets, weights = spread_window(spread, spacing)
        planes = subtract_color(image, image.mean((0, 1), dtype=np.float64).astype(np.float32)) @ tile.colors
        blur = _BLUR * spacing
        planes = scipy.ndimage.gaussian_filter(planes, (blur, blur, 0), mode="nearest")
        # An even number of steps, so that every second node is the start of a grid that reaches all borders, too.
        counts = 2 * np.maximum(np.ceil((size - 1) / (2 * _STEP * np.sqrt(12 * np.diag(covariance)))), 1)
        step = (size - 1) / counts
        # The displacement of the first knot is at most half of each vector of the lattice.
        beyond = np.ceil((np.abs(lattice.matrix).sum(0) / 2 + _BEYOND * lattice.s) / step)
        knots = _grid(-beyond, counts + beyond) * step
        labels = np.rint(lattice.to_cell(knots) * _PHASES)
        used, phases = np.unique((labels % _PHASES).astype(np.int64).reshape(-1, 2) @ (1, _PHASES), return_inverse=True)
        cells = np.stack([used % _PHASES, used // _PHASES], -1) / _PHASES
        tiles = _read_tile(tile, lattice.from_cell(cells), offsets, blur)
        return cls(
            image,
            planes,
            tile,
            _grid(np.zeros(2), counts) * step,
            lattice.from_cell(labels / _PHASES),
            phases.reshape(knots.shape[:2]),
            Window.of(offsets, weights, tiles, lattice.s, _SPREAD),
        )

    def follow(self) -> FollowedImage:
        best, most = np.zeros((*self.phases.shape, 7)), -1.0
        for start in self._starts():
            found = self._grow(start)
            worth = float(found[..., 6].sum())
            if worth > most:
                best, most = found, worth
            area = np.abs(best[..., 2] * best[..., 5] - best[..., 3] * best[..., 4])[best[..., 6] > 0].sum()
            if area * np.prod(self._step) >= _ENOUGH * self.planes.shape[0] * self.planes.shape[1]:
                break
        return self._complete(best)

    @property
    def _step(self) -> Points:
        """Distances of the nodes along x and y, px."""
        return np.asarray(self.nodes[1, 1])

    def _grow(self, start: tuple[tuple[int, int], Points]) -> NDArray[np.float64]:
        """Return place, affine map and correlation of each knot, ``(rows, columns, 7)``."""
        seed, state = start
        states, correlation = np.zeros((*self.phases.shape, 6)), np.zeros(self.phases.shape)
        states[seed] = state[:6]
        levels = tuple(level * max(float(state[6]), _LEAST_LEVEL) for level in _LEVELS)
        self.window.grow(self.planes, self.phases, self.points, states, correlation, np.array(seed), levels, _MARGIN)
        return np.concatenate([states, correlation[..., np.newaxis]], -1)

    def _starts(self) -> list[tuple[tuple[int, int], Points]]:
        """Return seeds, the best first: the row and column of a node; its state, and the correlation."""
        lattice, (offsets, weights, reach) = self.tile.harmonics.lattice, self.window.points
        size = np.array(self.planes.shape[1::-1])
        middles = self._middles(size, reach, 1.5 * lattice.s)
        read = interpolate(self.planes, middles[:, np.newaxis] + offsets)
        read -= np.tensordot(read, weights, (1, 0))[:, np.newaxis]
        strength = np.sqrt(
            np.maximum(np.tensordot(read**2, weights, (1, 0)).sum(1), 1e-12) * max(self.tile.power, 1e-12)
        )
        waves = np.exp(-2j * math.pi * offsets @ self.tile.harmonics.frequencies.T) * weights[:, np.newaxis]
        coefficients = np.einsum("pnc,nk->kcp", read, waves.astype(np.complex64), optimize=True)
        turn = np.exp(-2j * math.pi * self.tile.harmonics.frequencies @ middles.T)
        product = self.tile.unweighted().product(coefficients[..., np.newaxis])[..., 0] * turn
        surfaces = correlation_surfaces(product[..., np.newaxis], self.tile.harmonics)[:, 0]
        surfaces = surfaces.reshape(len(middles), -1) / strength[:, np.newaxis]
        highest = surfaces.max(1)
        displacements = label_displacements(lattice).reshape(-1, 2)[surfaces.argmax(1)]
        found = []
        for k in np.argsort(-highest, kind="stable")[:_CANDIDATES]:
            at = middles[k] - displacements[k]
            apart = ((self.points - at) ** 2).sum(-1)
            seed = np.unravel_index(apart.argmin(), apart.shape)
            state = np.array([*(self.points[seed] + displacements[k]), 1.0, 0.0, 0.0, 1.0])
            value = self.window.register(self.planes, int(self.phases[seed]), state)
            found.append(((int(seed[0]), int(seed[1])), np.append(state, value)))
        found.sort(key=lambda seed_and_state: -seed_and_state[1][6])
        return found[:_STARTS]

    def _middles(self, size: Points, reach: Points, step: float) -> Points:
        """Return places (x, y) px at which the whole window lies in the image, spread evenly; at least one."""
        room = np.maximum(size - 1 - 2 * reach, 0)
        step = max(step, math.sqrt(float(np.prod(room + step)) / _MOST_PLACES))
        sides = [
            np.linspace(low, low + length, 1 + int(length / step))
            for low, length in zip((size - 1 - room) / 2, room, strict=True)
        ]
        return np.stack(np.meshgrid(*sides), -1).reshape(-1, 2)

    def _complete(self, found: NDArray[np.float64]) -> FollowedImage:
        """Return the displacements at the nodes of the image, given the knots, ``(rows, columns, 7)``.

        The place where the content of a node belongs is predicted by the affine maps of the nearest knots.
        """
        known, nodes = found[..., 6] > 0, self.nodes
        if not known.any():
            return FollowedImage(self.image, nodes, np.zeros_like(nodes), np.zeros(nodes.shape[:2]))
        places, points, weights = found[known][:, :2], self.points[known], found[known][:, 6]
        inverse = np.linalg.inv(found[known][:, 2:6].reshape(-1, 2, 2))
        _, nearest = scipy.spatial.cKDTree(places).query(nodes, range(1, min(_NEIGHBORS, len(places)) + 1))
        distance = np.hypot(*np.moveaxis(nodes[:, :, np.newaxis] - places[nearest], -1, 0))
        steps = np.einsum("yxkab,yxkb->yxka", inverse[nearest], nodes[:, :, np.newaxis] - places[nearest])
        reach = float(np.hypot(*self._step)) / 2
        share = weights[nearest] ** 2 / (distance**2 + (reach / 2) ** 2)
        share /= share.sum(-1, keepdims=True)
        belongs = (share[..., np.newaxis] * (points[nearest] + steps)).sum(2)
        apart = np.hypot(*np.moveaxis(steps[:, :, 0], -1, 0))
        correlation = np.where(apart <= _BESIDE * reach, (share * weights[nearest]).sum(-1), 0.0)
        return FollowedImage(self.image, nodes, nodes - belongs, correlation)


def _grid(first: Points, last: Points) -> Points:
    """Return the pairs of whole numbers (x, y) from ``first`` to ``last``, ``(rows, columns, 2)``."""
    return np.stack(np.meshgrid(*(np.arange(low, high + 1) for low, high in zip(first, last, strict=True))), -1)


def _read_tile(tile: MeanTile, middles: Points, offsets: Points, blur: float) -> tuple[Values, Values, Values]:
    """Return the smoothed tile around places of its plane, ``(p, n, C)``, and its slopes along x and y."""
    waves = 2 * math.pi * tile.harmonics.frequencies
    gain = np.exp(-(blur**2) * (waves**2).sum(1) / 2)
    values = 2 * tile.values * gain[:, np.newaxis]
    there, beside = np.exp(1j * middles @ waves.T), np.exp(1j * waves @ offsets.T)
    across, down = 1j * waves[:, :1] * values, 1j * waves[:, 1:] * values

    def read(terms: NDArray[np.complex128]) -> Values:
        planes = [((there * term) @ beside).real for term in terms.T]
        return np.asarray(np.stack(planes, -1), np.float32)

    return read(values), read(across), read(down)
