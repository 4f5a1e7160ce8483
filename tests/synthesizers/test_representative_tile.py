import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from synthesis_cases import noise, waves

from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Synthesis, Task
from nrbench.synthesizers.representative_tile import RepresentativeTile, continuity, preselect, resemblance

TURN = math.radians(7)
TURNED = Lattice((21.37 * math.cos(TURN), 21.37 * math.sin(TURN)), (-18.81 * math.sin(TURN), 18.81 * math.cos(TURN)))
UPRIGHT = Lattice((21.37, 0), (0, 18.81))
BOND = Lattice((27.3, 0), (13.65, 12.2))
OBLIQUE = Lattice((21.37, 2.6), (-2.3, 18.81))


def synthesize(
    sample: Image, shape: tuple[int, int], lattice: Lattice | None, seed: int = 1, **parameters: Any
) -> Synthesis:
    """Run the method."""
    task = Task(sample, shape, lattice, np.random.default_rng(seed))
    return RepresentativeTile(**parameters).synthesize(task)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("shape", [(256, 256), (1, 300), (300, 1), (9, 5)])
@pytest.mark.parametrize("rescale", [True, False])
def test_a_whole_pixel_lattice_is_continued_exactly(shape: tuple[int, int], channels: int, rescale: bool) -> None:
    """On a perfectly periodic sample the output is the periodic continuation, phase included, to the bit."""
    picture = np.tile(noise(24, 30, channels), (13, 13, 1))
    made = synthesize(picture[:100, :128], shape, Lattice((30, 0), (0, 24)), rescale=rescale)
    np.testing.assert_array_equal(quantize(made.image), picture[: shape[0], : shape[1]])
    assert made.source is not None and (made.source[..., 2] == 1).all()
    assert made.extras["tile"].shape == (24, 30, channels)


@pytest.mark.parametrize("lattice", [UPRIGHT, TURNED, BOND, OBLIQUE, Lattice((20.3, 0), (6.1, 18.7))])
def test_a_fractional_lattice_neither_drifts_nor_blurs(lattice: Lattice) -> None:
    """Upright, turned, centred or oblique: over 1024 px the continuation comes back with a PSNR of over 35 dB."""
    sample, truth = quantize(waves((128, 128), lattice)), waves((200, 1024), lattice)
    made = synthesize(sample, (200, 1024), lattice)
    assert -10 * np.log10(((made.image - truth) ** 2).mean()) > 35
    corner = (made.image - truth)[-100:, -100:]
    assert -10 * np.log10((corner**2).mean()) > 35


@pytest.mark.parametrize("lattice", [UPRIGHT, TURNED, BOND, OBLIQUE])
def test_sources_stay_on_the_lattice(lattice: Lattice) -> None:
    """On a sample that does not repeat at all, every pixel of 1024 x 1024 comes from within a pixel of its equals."""
    made = synthesize(noise(128, 128), (1024, 1024), lattice)
    assert made.source is not None
    y, x = np.indices((1024, 1024))
    misplaced = lattice.wrap(made.source[::7, ::7, :2] - np.stack([x, y], -1)[::7, ::7])
    assert np.abs(misplaced).max() <= 0.5 + 1e-3 < 0.1 * lattice.s


def test_the_tile_is_the_best_of_all_by_brute_force() -> None:
    """No place has a smaller alpha h + SSDN than the tile's, and the tile is what lies there."""
    sample, lattice = noise(40, 50), Lattice((11, 0), (0, 9))
    for alpha in (1.0, 30.0, 0.0):
        made = synthesize(sample, (40, 50), lattice, continuity_weight=alpha)
        rating = alpha * continuity(sample, (9, 11)) + resemblance(sample, (9, 11))
        x, y, smooth, alike, total = made.extras["best"][0]
        assert (int(y), int(x)) == np.unravel_index(rating.argmin(), rating.shape)
        assert alpha * smooth + alike == pytest.approx(total) == pytest.approx(rating.min())
        np.testing.assert_array_equal(quantize(made.extras["tile"]), sample[int(y) :, int(x) :][:9, :11])


def test_the_output_shows_the_sample_where_the_tile_lies() -> None:
    """The tile stays in its place (figure 4), and is repeated around it."""
    sample = noise(40, 50)
    made = synthesize(sample, (40, 50), Lattice((11, 0), (0, 9)))
    x, y = made.extras["best"][0, :2].astype(int)
    np.testing.assert_array_equal(quantize(made.image)[y : y + 9, x : x + 11], sample[y : y + 9, x : x + 11])
    np.testing.assert_array_equal(made.image[9:], made.image[:-9])
    np.testing.assert_array_equal(made.image[:, 11:], made.image[:, :-11])


def test_the_tile_is_floored_and_scaled_down_and_the_output_is_not() -> None:
    """The period of 21.37 x 18.81 px becomes 21 x 18 (equation 4); the output keeps the sample's period by default."""
    sample = quantize(waves((128, 128), UPRIGHT))
    made = synthesize(sample, (300, 300), UPRIGHT)
    assert made.extras["tile"].shape == (18, 21, 3)
    np.testing.assert_allclose(made.extras["frame"][1:], [[21.37 / 21, 0], [0, 18.81 / 18]])
    paper = synthesize(sample, (300, 300), UPRIGHT, rescale=False)
    np.testing.assert_array_equal(paper.image[18:, 21:], paper.image[:-18, :-21])
    small = waves((300, 300), Lattice((21, 0), (0, 18)))
    assert -10 * np.log10(((paper.image - small) ** 2).mean()) > 35


def test_p_takes_the_smoothest_places_first() -> None:
    """With p only the share of places of least h is rated; with a small one the tile is the smoothest of all."""
    sample, lattice = noise(40, 50), Lattice((11, 0), (0, 9))
    smooth = continuity(sample, (9, 11))
    kept = preselect(smooth, 0.05 * smooth.size)
    assert kept.sum() == round(0.05 * smooth.size) and smooth[kept].max() <= smooth[~kept].min()
    first = synthesize(sample, (9, 9), lattice, rated_share=1e-4).extras["best"][0]
    assert first[2] == pytest.approx(smooth.min())
    alike = np.where(kept, smooth + resemblance(sample, (9, 11)), np.inf)
    assert synthesize(sample, (9, 9), lattice, rated_share=0.05).extras["best"][0, 4] == pytest.approx(alike.min())


def test_of_the_m_best_each_is_drawn_equally_often() -> None:
    """The tile is one of the m best, uniformly, and the m best are kept in order, with their pictures."""
    sample, lattice = noise(20, 24, 1), Lattice((6, 0), (0, 5))
    made = [synthesize(sample, (2, 2), lattice, seed, best_tiles=5) for seed in range(600)]
    best = made[0].extras["best"]
    assert best.shape == (5, 5) and (np.diff(best[:, 4]) >= 0).all()
    pictures = [made[0].extras[f"best-{k:02d}"].tobytes() for k in range(1, 6)]
    counts = [sum(one.extras["tile"].tobytes() == picture for one in made) for picture in pictures]
    assert sum(counts) == 600 and stats.chisquare(counts).pvalue > 1e-3


def test_a_turned_rectangle_is_cut_upright() -> None:
    """Of a lattice turned by 7 degrees the tile stands upright: it is that of the lattice before the turn."""
    made = synthesize(quantize(waves((128, 128), TURNED)), (64, 64), TURNED)
    tile = made.extras["tile"]
    assert tile.shape == (18, 21, 3)
    steps = made.extras["frame"][1:]
    np.testing.assert_allclose(np.degrees(np.arctan2(*steps[:, ::-1].T)), [7, 97], atol=1e-6)
    upright = waves((18, 21), Lattice((21, 0), (0, 18), tuple(-TURNED.to_cell(made.extras["frame"][0]) * (21, 18))))
    assert np.sqrt(((tile - upright) ** 2).mean()) < 0.01


def test_a_centred_lattice_gets_a_rectangle_of_two_cells() -> None:
    """A running bond is tiled by two bricks, and the note says so."""
    made = synthesize(quantize(waves((128, 128), BOND)), (64, 64), BOND)
    assert made.extras["tile"].shape == (24, 27, 3) and "2 cells" in made.note


def test_a_turned_tile_stands_back_behind_an_upright_one_unless_that_is_large() -> None:
    """Squares turned by 45 degrees get an upright tile of two; turned by that of a 3-4-5 triangle, a turned one."""
    for lattice, shape in ((Lattice((14, 14), (-14, 14)), (28, 28)), (Lattice((16, 12), (-12, 16)), (20, 20))):
        made = synthesize(quantize(waves((128, 128), lattice)), (16, 16), lattice)
        assert made.extras["tile"].shape[:2] == shape


def test_any_basis_of_the_lattice_gives_the_same_bytes() -> None:
    """Long, skewed generating vectors of the same lattice change nothing."""
    sample = noise(128, 128)
    one = synthesize(sample, (100, 100), Lattice((20, 0), (10, 12)))
    other = synthesize(sample, (100, 100), Lattice((30, 12), (10, 12)))
    np.testing.assert_array_equal(one.image, other.image)


@settings(max_examples=25)
@given(
    st.tuples(st.integers(1, 70), st.integers(1, 70)),
    st.sampled_from([UPRIGHT, TURNED, BOND, Lattice((12, 0), (0, 9)), Lattice((10, 10), (-10, 10))]),
    st.sampled_from([1, 3]),
    st.booleans(),
)
def test_what_the_source_map_calls_a_copy_is_one(
    shape: tuple[int, int], lattice: Lattice, channels: int, rescale: bool
) -> None:
    """Whatever the lattice and the shape: pixels of weight 1 are the sample's, all lie inside it."""
    sample = noise(80, 90, channels)
    made = synthesize(sample, shape, lattice, rescale=rescale)
    assert made.image.shape == (*shape, channels) and made.source is not None
    x, y, weight = np.moveaxis(made.source, -1, 0)
    assert ((x >= 0) & (x <= 89) & (y >= 0) & (y <= 79) & (weight > 0) & (weight <= 1)).all()
    copied = weight == 1
    expected = sample[y[copied].astype(int), x[copied].astype(int)]
    np.testing.assert_allclose(made.image[copied], expected, atol=1e-5)
    assert ((made.image >= 0) & (made.image <= 1)).all()
