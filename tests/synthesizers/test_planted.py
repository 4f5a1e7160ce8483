from dataclasses import replace

import numpy as np
import pytest

from nrbench.datasets_procedural.brick import Brick
from nrbench.errors import BadInput
from nrbench.streams import stream
from nrbench.synthesis import Again, Refused, Synthesis, Task
from nrbench.synthesizers.planted import FAULTS, Planted
from nrbench.texture import Shape, Texture

MODEL = Brick(color=0.2, noise=0.02)
TEXTURE = MODEL.render((128, 128), np.random.default_rng(0))
S = TEXTURE.lattice.s  # type: ignore[union-attr]


def draws(shape: Shape, k: int) -> Texture | None:
    """Return fresh draws of the texture."""
    return MODEL.again(TEXTURE, shape, stream("again", k))


def plant(kind: str, size: float, seed: int = 0, again: Again | None = draws, shape: Shape = (150, 180)) -> Synthesis:
    """Run the method."""
    return Planted(kind, size).synthesize(Task(TEXTURE.image, shape, None, np.random.default_rng(seed), again=again))


@pytest.mark.parametrize("kind", FAULTS)
@pytest.mark.parametrize("shape", [(150, 180), (40, 33), (8, 8)])
def test_every_kind_fits_every_shape(kind: str, shape: Shape) -> None:
    """The output has the shape asked for, its values are an image's, and its note names the defect."""
    made = plant(kind, 0.4, shape=shape)
    assert made.image.shape == (*shape, 3)
    assert made.image.dtype == np.float32
    assert 0 <= made.image.min() <= made.image.max() <= 1
    assert kind in made.note


@pytest.mark.parametrize("kind", ["phase-step", "displaced-tile", "off-lattice"])
@pytest.mark.parametrize("size", [0.15, 0.3, 0.5])
def test_content_moves_as_far_as_told(kind: str, size: float) -> None:
    """The largest displacement is the size wanted to within a pixel's rounding, and the note says it."""
    made = plant(kind, size)
    distance = np.hypot(*np.moveaxis(made.extras["displacement"], -1, 0)).max()
    assert distance == pytest.approx(size * S, abs=0.6)
    assert f"({distance:.1f} px)" in made.note


def test_moved_content_is_the_draw_itself() -> None:
    """Each pixel is, to the bit, the pixel of one wider fresh draw that its displacement points at."""
    seen = []

    def watched(shape: Shape, k: int) -> Texture | None:
        drawn = draws(shape, k)
        seen.append(drawn)
        return drawn

    made = plant("off-lattice", 0.3, again=watched)
    field = made.extras["displacement"].astype(int)
    margin = (seen[-1].image.shape[0] - 150) // 2
    y, x = np.indices((150, 180)) + margin
    np.testing.assert_array_equal(made.image, seen[-1].image[y - field[..., 1], x - field[..., 0]])


def test_a_phase_step_moves_one_half() -> None:
    """Half of the pixels move, all alike."""
    field = plant("phase-step", 0.3).extras["displacement"].reshape(-1, 2)
    assert len(np.unique(field, axis=0)) == 2
    assert field.any(1).mean() == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("seed", range(5))
def test_one_tile_is_one_cell_inside(seed: int) -> None:
    """The displaced and the missing tile have a cell's area and lie whole within the output."""
    moved = plant("displaced-tile", 0.3, seed).extras["displacement"].any(-1)
    covered = plant("missing-tile", 1.0, seed).extras["covered"] > 0
    for tile in (moved, covered):
        assert tile.sum() == pytest.approx(TEXTURE.lattice.area, rel=0.1)  # type: ignore[union-attr]
        assert not (tile[0].any() or tile[-1].any() or tile[:, 0].any() or tile[:, -1].any())


def test_a_covered_tile_is_flat() -> None:
    """Full opacity leaves one color; half of it leaves half the contrast."""
    full, half, none = (plant("missing-tile", size) for size in (1.0, 0.5, 0.0))
    tile = full.extras["covered"] > 0
    assert full.image[tile].std(0).max() < 1e-6
    np.testing.assert_allclose(half.image[tile].std(0), none.image[tile].std(0) / 2, rtol=1e-4)
    np.testing.assert_array_equal(full.image[~tile], none.image[~tile])


def test_size_zero_is_a_fresh_draw() -> None:
    """Nothing moves at size 0, nor with kind none at any size."""
    for kind, size in (("phase-step", 0.0), ("none", 0.7)):
        assert not plant(kind, size).extras["displacement"].any()


def test_equal_seeds_give_equal_bytes() -> None:
    """The task's generator decides everything."""
    np.testing.assert_array_equal(plant("off-lattice", 0.3, 4).image, plant("off-lattice", 0.3, 4).image)
    assert (plant("off-lattice", 0.3, 4).image != plant("off-lattice", 0.3, 5).image).any()


def test_wrong_parameters_say_what_to_do() -> None:
    """An unknown kind and a size out of range are bad input."""
    with pytest.raises(BadInput, match="kind 'crack' is unknown; choose one of none, phase-step"):
        Planted("crack")
    with pytest.raises(BadInput, match=r"size 1.5 is outside \[0, 1\]"):
        Planted("phase-step", 1.5)


def test_without_fresh_draws_or_lattice_it_refuses() -> None:
    """A photograph, and a texture without a lattice, are refused."""
    with pytest.raises(Refused, match="no fresh draws"):
        plant("none", 0, again=None)
    with pytest.raises(Refused, match="no lattice"):
        plant("none", 0, again=lambda shape, k: replace(TEXTURE, lattice=None))
