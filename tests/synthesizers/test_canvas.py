from typing import get_args

import numpy as np
import pytest

from nrbench.synthesizers.gap_filling.blocks import BlockGrid
from nrbench.synthesizers.gap_filling.canvas import BlockCanvas, SeamMethod
from nrbench.synthesizers.sampling.patches import Patches

SEAMS = get_args(SeamMethod)


def filled(seam: SeamMethod, shape: tuple[int, int], seed: int = 0, side: int = 60) -> BlockCanvas:
    """Return a canvas of random patches of 16 px with borders of 5 px, at fractional places."""
    rng = np.random.default_rng(seed)
    patches = Patches(rng.random((side, side, 3), np.float32))
    canvas = BlockCanvas(patches, BlockGrid(shape, 16, 5), seam)
    for row, column in canvas.grid.placed():
        canvas.place_block(row, column, rng.uniform(5, side - 21, 2))
    canvas.extend_placed()
    for row, column in canvas.grid.gaps():
        canvas.fill_gap(row, column, rng.uniform(0, side - 16, 2))
    return canvas


@pytest.mark.parametrize("seam", SEAMS)
@pytest.mark.parametrize("shape", [(64, 80), (1, 90), (70, 1), (17, 17), (5, 7)])
def test_every_pixel_is_filled_from_inside_the_sample(seam: SeamMethod, shape: tuple[int, int]) -> None:
    """Whatever the joints and the shape, nothing stays unknown, and the map points into the sample."""
    canvas = filled(seam, shape)
    image, source = canvas.output()
    assert image.shape == (*shape, 3) and source.shape == (*shape, 3)
    assert canvas.known.all()
    assert ((source[..., :2] >= 0) & (source[..., :2] <= 59)).all()
    assert ((source[..., 2] > 0) & (source[..., 2] <= 1)).all()


@pytest.mark.parametrize("seam", SEAMS)
def test_patches_that_continue_each_other_leave_no_trace(seam: SeamMethod) -> None:
    """Places that all continue one image, between pixels, give that image back whatever the joints."""
    sample = np.random.default_rng(0).random((90, 110, 3), np.float32)
    canvas = BlockCanvas(Patches(sample), BlockGrid((49, 65), 16, 5), seam)
    for blocks in (canvas.grid.placed(), canvas.grid.gaps()):
        for row, column in blocks:
            place = np.array([column * 16 + 9.25, row * 16 + 8.5])
            if (row + column) % 2:
                canvas.fill_gap(row, column, place)
            else:
                canvas.place_block(row, column, place)
        if not canvas.known.all():
            canvas.extend_placed()
    whole, _ = Patches(sample).cut(np.array([9.25, 8.5]), (49, 65))
    np.testing.assert_allclose(canvas.output()[0], whole, atol=1e-5)


@pytest.mark.parametrize("seam", ["dynamic", "graphcut"])
def test_seams_mix_no_pixels(seam: SeamMethod) -> None:
    """Every pixel is that of one patch: the image is what its map says, interpolated at one fraction."""
    rng = np.random.default_rng(3)
    patches = Patches(rng.random((60, 60, 1), np.float32))
    canvas = BlockCanvas(patches, BlockGrid((64, 64), 16, 5), seam)
    for row, column in canvas.grid.placed():
        canvas.place_block(row, column, rng.integers(5, 39, 2).astype(float))
    canvas.extend_placed()
    for row, column in canvas.grid.gaps():
        canvas.fill_gap(row, column, rng.integers(0, 44, 2).astype(float))
    image, source = canvas.output()
    x, y, weight = np.moveaxis(source, -1, 0)
    assert (weight == 1).all()
    np.testing.assert_array_equal(image, patches.sample[y.astype(int), x.astype(int)])


def test_a_blended_patch_stays_in_its_gap_and_a_cut_one_does_not() -> None:
    """Placed squares are untouched by blending; seams may run into them, but not past their middles."""
    changed = {}
    for seam in SEAMS:
        canvas = BlockCanvas(
            Patches(np.random.default_rng(0).random((60, 60, 3), np.float32)), BlockGrid((48, 48), 16, 5), seam
        )
        rng = np.random.default_rng(1)
        for row, column in canvas.grid.placed():
            canvas.place_block(row, column, rng.uniform(5, 39, 2))
        canvas.extend_placed()
        before = canvas.image.copy()
        for row, column in canvas.grid.gaps():
            canvas.fill_gap(row, column, rng.uniform(0, 44, 2))
        moved = (canvas.image != before).any(-1)
        changed[seam] = sum(int(moved[canvas.window(row, column)].sum()) for row, column in canvas.grid.placed())
        assert not moved[24, 24]
    assert changed["blend"] == 0
    assert changed["graphcut"] > 0 and changed["dynamic"] > 0
