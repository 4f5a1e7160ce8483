from typing import Any

import numpy as np
import pytest
from synthesis_cases import waves

from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Refused, Synthesis, Task
from nrbench.synthesizers.baselines.voronoi_cell import half_extent
from nrbench.synthesizers.tiling import Tiling

OBLIQUE = Lattice((21.37, 2.6), (-2.3, 18.81))


def tile(sample: Image, shape: tuple[int, int], lattice: Lattice | None, seed: int = 0) -> Synthesis:
    """Run the method."""
    return Tiling().synthesize(Task(sample, shape, lattice, np.random.default_rng(seed)))


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("shape", [(256, 256), (1, 300), (9, 5)])
def test_a_whole_pixel_lattice_is_continued_exactly(shape: tuple[int, int], channels: int) -> None:
    """On a perfectly periodic sample the output is the periodic continuation, phase included, to the bit."""
    motif = np.random.default_rng(0).random((24, 30, channels), np.float32)
    picture = quantize(np.tile(motif, (20, 20, 1)))
    made = tile(picture[:100, :128], shape, Lattice((30, 0), (0, 24)))
    np.testing.assert_array_equal(quantize(made.image), picture[: shape[0], : shape[1]])
    assert made.source is not None
    assert (made.source[..., 2] == 1).all()


def test_every_tile_is_the_same() -> None:
    """On a random sample with a whole-pixel lattice the output repeats exactly, whatever the sample does."""
    sample = quantize(np.random.default_rng(0).random((70, 80, 3), np.float32))
    made = tile(sample, (120, 120), Lattice((20, 4), (-3, 16))).image
    np.testing.assert_allclose(made[4:, 20:], made[:-4, :-20], atol=1e-6)
    np.testing.assert_allclose(made[16:, :-3], made[:-16, 3:], atol=1e-6)


def test_the_map_points_at_what_was_copied() -> None:
    """Pixels of weight 1 are the sample's; all lie inside it, within one tile."""
    sample = quantize(np.random.default_rng(0).random((70, 80, 3), np.float32))
    lattice = Lattice((20, 4), (-3, 16))
    made = tile(sample, (120, 120), lattice)
    assert made.source is not None
    x, y, weight = np.moveaxis(made.source, -1, 0)
    assert (weight == 1).all()
    np.testing.assert_allclose(made.image, sample[y.astype(int), x.astype(int)], atol=1e-6)
    assert len(np.unique(made.source[..., :2].reshape(-1, 2), axis=0)) == lattice.area


def test_the_half_extent_is_that_of_the_voronoi_cell() -> None:
    """Rectangles reach half their sides; a running bond of squares, half its longer vector."""
    assert half_extent(Lattice((30, 0), (0, 24))) == pytest.approx((15, 12))
    assert half_extent(Lattice((40, 0), (20, 20))) == pytest.approx((20, 20))


def test_a_sample_without_a_whole_tile_is_refused() -> None:
    """The refusal gives the tile's size and the sample's."""
    with pytest.raises(Refused, match="60x50 px, the sample is 55x90 px"):
        tile(np.zeros((90, 55, 1), np.float32), (64, 64), Lattice((60, 0), (0, 50)))


def test_the_typical_tile_is_the_one_nearest_to_the_mean() -> None:
    """Of tiles of which all but one are odd, the one that is like the mean tile is repeated, at any seed."""
    rng = np.random.default_rng(4)
    motif = rng.random((20, 20, 3), np.float32) * 0.4 + 0.3
    sample = np.tile(motif, (5, 5, 1)) + 0.2 * rng.choice([-1.0, 1.0], (100, 100, 1)).astype(np.float32)
    sample[38:62, 38:62] = np.tile(motif, (5, 5, 1))[38:62, 38:62]
    made = [tile(quantize(sample), (60, 60), Lattice((20, 0), (0, 20)), seed) for seed in (0, 1)]
    np.testing.assert_array_equal(made[0].image, made[1].image)
    assert np.abs(made[0].image - np.tile(motif, (3, 3, 1))).max() < 1 / 255


def test_a_random_tile_is_drawn_from_the_stream() -> None:
    """With ``tile="random"`` another seed repeats another tile."""
    sample = quantize(np.random.default_rng(0).random((70, 80, 3), np.float32))
    lattice = Lattice((20, 0), (0, 20))
    tasks = [Task(sample, (40, 40), lattice, np.random.default_rng(seed)) for seed in (0, 1)]
    first, second = (Tiling(tile="random").synthesize(task).image for task in tasks)
    assert not np.array_equal(first, second)


@pytest.mark.parametrize("tile", ["typical", "random"])
def test_every_tile_continues_a_fractional_lattice(tile: Any) -> None:
    """From any tile, 800 px away an oblique lattice is continued within a gray level (rms)."""
    sample = quantize(waves((90, 90), OBLIQUE))
    made = Tiling(tile=tile).synthesize(Task(sample, (800, 800), OBLIQUE, np.random.default_rng(3)))
    error = (made.image - waves((800, 800), OBLIQUE))[-100:, -100:]
    assert np.sqrt((error**2).mean()) < 1 / 255
