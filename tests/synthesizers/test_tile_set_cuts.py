"""Claims about the exact cuts of tile-set: they lead around elements, and their costs are recorded."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from nrbench.api import texture
from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Task
from nrbench.synthesizers.tile_laying.tile_shape import element_costs, element_weights, tile_shape
from nrbench.synthesizers.tile_set import LEAST_SIDE, TileLaying, TileSet

LATTICES = [Lattice((24.3, 0.0), (0.0, 21.7)), Lattice((14.2, 12.7), (14.2, -12.7)), Lattice((23.4, 5.1), (-5.1, 23.4))]


def discs(size: int, lattice: Lattice, seed: int = 0) -> tuple[Image, NDArray[np.float64], NDArray[np.bool_]]:
    """Return discs of one color each on a flat ground, each pixel's lattice point, and a mask of the discs."""
    y, x = np.indices((size, size))
    pixels = np.stack([x, y], -1)
    away = lattice.wrap(pixels - lattice.origin)
    middles = np.round(lattice.to_cell(pixels - away)).astype(int)
    colors = np.random.default_rng(seed).random((200, 200, 3))[middles[..., 0], middles[..., 1]]
    inside = np.hypot(*np.moveaxis(away, -1, 0)) < 0.48 * lattice.s
    return quantize(np.where(inside[..., np.newaxis], colors, 0.5).astype("f4")), middles, inside


def whole(made: Image, middles: NDArray[np.float64], inside: NDArray[np.bool_]) -> float:
    """Return the share of discs that are of one color."""
    keys = middles[..., 0] * 1000 + middles[..., 1]
    spreads = [np.ptp(made[inside & (keys == key)], axis=0).max() for key in np.unique(keys[20:-20, 20:-20])]
    return float(np.mean(np.array(spreads) < 0.02))


@pytest.mark.parametrize("lattice", LATTICES)
def test_elements_stay_whole(lattice: Lattice) -> None:
    """Nine of ten discs keep one color; with the paper's stitching less than half do."""
    sample, _, _ = discs(128, lattice)
    _, middles, inside = discs(200, Lattice(lattice.t1, lattice.t2))
    core = inside & (
        np.hypot(*np.moveaxis(lattice.wrap(np.stack(np.indices((200, 200))[::-1], -1)), -1, 0)) < 0.48 * lattice.s - 2
    )

    def made(**parameters: Any) -> Image:
        return TileSet(**parameters).synthesize(Task(sample, (200, 200), lattice, np.random.default_rng(1))).image

    assert whole(made(), middles, core) > 0.9
    assert whole(made(stitch="dynamic", anchor="quiet"), middles, core) < 0.5


@pytest.mark.parametrize("lattice", LATTICES)
def test_the_anchor_lies_in_the_middle_of_elements(lattice: Lattice) -> None:
    """With few tiles the anchor lies within 1.5 px of the discs' middles, wherever they are."""
    for seed, origin in enumerate([(0.0, 0.0), (5.5, 3.2), (-7.1, 9.9)]):
        moved = lattice.shifted(origin)
        costs, anchors = element_costs(discs(110, moved, seed)[0], lattice)
        assert np.hypot(*lattice.wrap(anchors[costs.argmin()] - origin)) < 1.5


def test_seams_are_recorded_only_where_tiles_meet() -> None:
    """Nearly all links between pixels of different tiles have a cost, and hardly any others."""
    lattice = LATTICES[0]
    sample = quantize(np.random.default_rng(0).random((120, 120, 3), np.float32))
    laying = TileLaying(TileSet(registration=0), Task(sample, (90, 90), lattice, np.random.default_rng(1)), lattice)
    laying.lay_tiles()
    canvas = laying.canvas
    x, y = canvas.margin
    window = np.s_[y : y + 90, x : x + 90]
    offsets = canvas.origins[window][..., :2] - np.stack(np.indices((90, 90))[::-1], -1)
    across = (offsets[:, 1:] != offsets[:, :-1]).any(-1)
    down = (offsets[1:] != offsets[:-1]).any(-1)
    seams = canvas.seams[window]
    assert (seams[:, :-1, 0][~across] > 0).mean() < 0.02 and (seams[:-1, :, 1][~down] > 0).mean() < 0.02
    assert (seams[:, :-1, 0][across] > 0).mean() > 0.95 and (seams[:-1, :, 1][down] > 0).mean() > 0.95


@pytest.mark.parametrize(("s", "cells"), [(6.3, 3), (10.7, 2), (15.9, 2), (16.0, 1), (40.0, 1)])
def test_small_cells_are_laid_several_at_a_time(s: float, cells: int) -> None:
    """By default tiles have the fewest cells that make s times the cells at least 16 px."""
    lattice = Lattice((s, 0.0), (0.0, 1.2 * s))
    sample = quantize(np.random.default_rng(0).random((200, 200, 1), np.float32))
    laying = TileLaying(TileSet(), Task(sample, (20, 20), lattice, np.random.default_rng(0)), lattice)
    np.testing.assert_allclose(laying.tile.steps, tile_shape(lattice, "cell", cells).steps)
    assert s * cells >= LEAST_SIDE > s * (cells - 1)


def test_a_margin_lengthens_tiles_and_leaves_steps() -> None:
    """Each side is longer by twice the margin in its own direction."""
    plain, wide = (tile_shape(LATTICES[2], "lattice", 1, margin) for margin in (0.0, 3.0))
    np.testing.assert_allclose(np.hypot(*wide.sides.T), np.hypot(*plain.sides.T) + 6)
    np.testing.assert_allclose(wide.steps, plain.steps)


def test_a_sample_too_small_for_margins_is_laid_without() -> None:
    """If tiles just fit into the sample, they have no margin by default."""
    lattice = Lattice((40, 0), (0, 40), (20, 20))
    sample = quantize(np.random.default_rng(0).random((82, 82, 1), np.float32))
    task = Task(sample, (50, 50), lattice, np.random.default_rng(0))
    np.testing.assert_allclose(np.abs(TileLaying(TileSet(anchor="given"), task, lattice).tile.sides).sum(0), 40)


@pytest.mark.parametrize("color", [0.05, 0.1, 0.14, 0.3])
@pytest.mark.parametrize(("model", "most"), [("brick", 2.0), ("hexagon", 1.5)])
def test_elements_of_slight_departures_are_found(model: str, most: float, color: float) -> None:
    """On eight draws, of the vectors alone, the best anchor is the middle of a brick or hexagon, to that many px."""
    for seed in range(300, 308):
        drawn = texture(model, (128, 128), seed, color=color)
        assert drawn.lattice is not None
        costs, anchors = element_costs(quantize(drawn.image), Lattice(drawn.lattice.t1, drawn.lattice.t2))
        off = drawn.lattice.wrap(anchors[costs.argmin()] - drawn.lattice.origin)
        assert np.hypot(*off) < most, (seed, off)


def joined_bricks(seed: int, shape: tuple[int, int], size: tuple[int, int], method: TileSet, **wall: float) -> float:
    """Return the share of the bricks in the output 5 % of which or more come from a second brick of the sample."""
    wall = {"width": 27.3, "height": 12.2, "joint": 2.2, **wall}
    drawn = texture("brick", shape, seed, **wall)
    assert drawn.lattice is not None
    lattice = Lattice(drawn.lattice.t1, drawn.lattice.t2)
    source = method.synthesize(Task(quantize(drawn.image), size, lattice, np.random.default_rng(seed))).source
    assert source is not None

    def bricks(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        x, y = x - drawn.lattice.origin[0], y - drawn.lattice.origin[1]
        row = np.rint(y / wall["height"])
        small = row % wall["small_every"] == 0 if "small_every" in wall else np.zeros(row.shape, np.bool_)
        width = np.where(small, wall["width"] / 2, wall["width"])
        x = x - row * wall["width"] / 2
        column = np.rint(x / width)
        inside = (np.abs(x - column * width) < width / 2 - wall["joint"] / 2 - 1) & (
            np.abs(y - row * wall["height"]) < (wall["height"] - wall["joint"]) / 2 - 1
        )
        return ((row + 500) * 1000 + column + 500).astype(np.int64), inside

    y, x = np.indices(size).astype(np.float64)
    places, inside = bricks(x, y)
    origins = bricks(*np.moveaxis(source[..., :2].astype(np.float64), -1, 0))[0]
    joined = []
    for place in np.unique(places[12:-12, 16:-16]):
        counts = np.unique(origins[inside & (places == place)], return_counts=True)[1]
        if counts.sum() > 40:
            joined.append(counts.max() < 0.95 * counts.sum())
    return float(np.mean(joined))


@pytest.mark.parametrize("color", [0.05, 0.3])
def test_seams_follow_joints_between_like_bricks(color: float) -> None:
    """On mild walls at most one brick in 200 is joined of two."""
    joined = [joined_bricks(seed, (128, 128), (256, 256), TileSet(), color=color) for seed in range(700, 703)]
    assert np.mean(joined) <= 0.005


def test_bricks_as_wide_as_the_cell_stay_whole() -> None:
    """Where a cell is one brick wide and six courses high, automatic tiles join few bricks; one cell joins more."""
    wall = {"width": 22.7, "height": 9.3, "joint": 1.8, "small_every": 6, "color": 0.15, "intensity": 0.2}
    automatic, cell = (
        np.mean([joined_bricks(seed, (192, 192), (240, 240), method, **wall) for seed in (3, 4)])
        for method in (TileSet(), TileSet(tile="cell"))
    )
    assert automatic <= 0.04
    assert cell > 2 * automatic


def test_element_weights_are_least_at_joints() -> None:
    """The weight in the middle of a brick is at least three times that at the joint between two."""
    drawn = texture("brick", (160, 160), 5, width=27.3, height=12.2, joint=2.2, color=0.1)
    assert drawn.lattice is not None

    def at(x: float, y: float) -> float:
        return float(
            element_weights(quantize(drawn.image), drawn.lattice, np.add(drawn.lattice.origin, (x, y)), (1, 1))[0, 0]
        )

    assert at(0, 0) > 3 * at(27.3 / 2, 0)
    assert at(0, 0) > 3 * at(0, 12.2 / 2)
