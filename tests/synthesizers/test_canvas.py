"""Claims about the canvas of blocks, and about the cuts that join a patch to it."""

from typing import get_args

import numpy as np
import pytest

from nrbench.imaging.convert import Image
from nrbench.synthesizers.gap_filling.blocks import BlockGrid
from nrbench.synthesizers.gap_filling.canvas import (
    BlockCanvas,
    PatchOverlap,
    SeamMethod,
    cut_graph,
)
from nrbench.synthesizers.sampling.patches import Patches
from nrbench.synthesizers.seams.minimum_cut import Links

SEAMS = get_args(SeamMethod)


def filled(seam: SeamMethod, shape: tuple[int, int], seed: int = 0, side: int = 60) -> BlockCanvas:
    """Return a canvas of random patches of 16 px with borders of 5 px, at fractional places."""
    rng = np.random.default_rng(seed)
    patches = Patches(rng.random((side, side, 3), np.float32))
    canvas = BlockCanvas(patches, BlockGrid(shape, 16, 5), seam)
    for block in canvas.grid.placed():
        canvas.place_block(block, rng.uniform(5, side - 21, 2))
    canvas.extend_placed()
    for gap in canvas.grid.gaps():
        canvas.fill_gap(gap, rng.uniform(0, side - 16, 2))
    return canvas


@pytest.mark.parametrize("seam", SEAMS)
@pytest.mark.parametrize("shape", [(64, 80), (1, 90), (70, 1), (17, 17), (5, 7)])
def test_every_pixel_is_filled_from_inside_the_sample(seam: SeamMethod, shape: tuple[int, int]) -> None:
    """For all seams and shapes every pixel is filled, and the map points into the sample."""
    canvas = filled(seam, shape)
    image, source = canvas.output()
    assert image.shape == (*shape, 3) and source.shape == (*shape, 3)
    assert canvas.known.all()
    assert ((source[..., :2] >= 0) & (source[..., :2] <= 59)).all()
    assert ((source[..., 2] > 0) & (source[..., 2] <= 1)).all()


@pytest.mark.parametrize("seam", SEAMS)
def test_patches_that_continue_each_other_leave_no_trace(seam: SeamMethod) -> None:
    """Patches between pixels that continue each other compose one image with all seams."""
    sample = np.random.default_rng(0).random((90, 110, 3), np.float32)
    canvas = BlockCanvas(Patches(sample), BlockGrid((49, 65), 16, 5), seam)
    for block in canvas.grid.placed():
        canvas.place_block(block, np.add(block.corner, (9.25, 8.5)))
    canvas.extend_placed()
    for gap in canvas.grid.gaps():
        canvas.fill_gap(gap, np.add(gap.corner, (9.25, 8.5)))
    whole, _ = Patches(sample).cut_patch(np.array([9.25, 8.5]), (49, 65))
    np.testing.assert_allclose(canvas.output()[0], whole, atol=1e-5)


def test_seams_mix_no_pixels() -> None:
    """With seams every pixel is a copy of the one that its map names."""
    rng = np.random.default_rng(3)
    patches = Patches(rng.random((60, 60, 1), np.float32))
    canvas = BlockCanvas(patches, BlockGrid((64, 64), 16, 5), "graphcut")
    for block in canvas.grid.placed():
        canvas.place_block(block, rng.integers(5, 39, 2).astype(float))
    canvas.extend_placed()
    for gap in canvas.grid.gaps():
        canvas.fill_gap(gap, rng.integers(0, 44, 2).astype(float))
    image, source = canvas.output()
    x, y, weight = np.moveaxis(source, -1, 0)
    assert (weight == 1).all()
    np.testing.assert_array_equal(image, patches.sample[y.astype(int), x.astype(int)])


def test_a_blended_patch_stays_in_its_gap_and_a_cut_one_does_not() -> None:
    """Blending leaves placed blocks unchanged; seams may run into them, but not beyond their middles."""
    changed = {}
    for seam in SEAMS:
        canvas = BlockCanvas(
            Patches(np.random.default_rng(0).random((60, 60, 3), np.float32)), BlockGrid((48, 48), 16, 5), seam
        )
        rng = np.random.default_rng(1)
        for block in canvas.grid.placed():
            canvas.place_block(block, rng.uniform(5, 39, 2))
        canvas.extend_placed()
        before = canvas.image.copy()
        for gap in canvas.grid.gaps():
            canvas.fill_gap(gap, rng.uniform(0, 44, 2))
        moved = (canvas.image != before).any(-1)
        changed[seam] = sum(int(moved[block.window()].sum()) for block in canvas.grid.placed())
        assert not moved[24, 24]
    assert changed["blend"] == 0
    assert changed["graphcut"] > 0


ALL = (True, True, True, True)


def joint(old: Image, new: Image, sides: tuple[bool, bool, bool, bool] = ALL, depth: int = 16) -> PatchOverlap:
    """Lay a patch over a gap of 24 px, 8 px of border inside it and 8 px beyond on the sides that have neighbors."""
    height, width = old.shape[:2]
    left, top, right, bottom = (depth if there else 0 for there in sides)
    known = np.ones((height, width), np.bool_)
    known[top : height - bottom, left : width - right] = False
    box = (-8 if sides[1] else 0, 24 + (8 if sides[3] else 0), -8 if sides[0] else 0, 24 + (8 if sides[2] else 0))
    hole = (8 if sides[1] else 0, 16 if sides[3] else 24, 8 if sides[0] else 0, 16 if sides[2] else 24)
    return PatchOverlap(old, new, known, box, hole, sides)


def nothing(shape: tuple[int, ...]) -> Links:
    """Return the seams of a picture that has none."""
    return Links(np.zeros((shape[0], shape[1] - 1)), np.zeros((shape[0] - 1, shape[1])))


SIDES = [ALL, (False, True, True, False), (True, False, False, False), (False, False, True, True)]


@pytest.mark.parametrize("sides", SIDES)
def test_the_hole_is_new_and_the_edge_beside_a_neighbor_old(sides: tuple[bool, bool, bool, bool]) -> None:
    """Everything unknown becomes new, and a graph cut leaves the box's edge beside a neighbor old."""
    height, width = 24 + 8 * (sides[1] + sides[3]), 24 + 8 * (sides[0] + sides[2])
    old, new = np.random.default_rng(0).random((2, height, width, 3)).astype(np.float32)
    one = joint(old, new, sides)
    mask = cut_graph(one, nothing(old.shape))
    assert mask[~one.known].all()
    assert not mask[one.fixed_old()].any()
    assert not mask.all()


def bricks(rng: np.random.Generator) -> Image:
    """Return bricks of 10 x 6 px with different tones, joints of 2 px, and weak noise."""
    y, x = np.indices((40, 40))
    row = y // 8
    column = (x + 6 * (row % 2)) // 12
    tones = 0.4 + 0.2 * rng.random((6, 6, 1))
    joints = (y % 8 < 2) | ((x + 6 * (row % 2)) % 12 < 2)
    picture = np.where(joints[..., np.newaxis], 0.9, tones[row, column]) + 0.01 * rng.standard_normal((40, 40, 1))
    return picture.astype(np.float32)


def test_a_graph_cut_runs_around_bricks() -> None:
    """A graph cut between two walls with equal bricks of different tones leaves no brick two-toned."""
    rng = np.random.default_rng(3)
    for _ in range(5):
        old, new = bricks(rng), bricks(rng)
        one = joint(old, new)
        mask = cut_graph(one, nothing(old.shape))
        y, x = np.indices((40, 40))
        row = y // 8
        brick = row * 10 + (x + 6 * (row % 2)) // 12
        inside = (y % 8 >= 2) & ((x + 6 * (row % 2)) % 12 >= 2)
        shares = np.array([mask[inside & (brick == which)].mean() for which in np.unique(brick[inside])])
        assert (np.minimum(shares, 1 - shares) < 0.1).all()


def test_recorded_seams_follow_the_cut() -> None:
    """After a cut the recorded seams are those of the joined picture."""
    old, new = np.random.default_rng(1).random((2, 40, 40, 3)).astype(np.float32)
    one, seams = joint(old, new), nothing(old.shape)
    seams.across[20, 19] = 5.0
    seams.across[1, 1] = 3.0
    mask = cut_graph(one, seams)
    changes = mask[:, 1:] != mask[:, :-1]
    assert seams.across[20, 19] == 0
    assert (seams.across[changes] > 0).all()
    rest = seams.across[~changes]
    assert rest.sum() in (0.0, 3.0)
