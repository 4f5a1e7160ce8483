from functools import cache

import numpy as np
import pytest

import nrbench
from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Refused, Texture
from nrbench.spectra.harmonics import WaveAnalysis
from nrbench.synthesizers.masks.texture_mask import MaskParameters, TextureMask

STRENGTH = {"color": 0.3, "intensity": 0.2, "noise": 0.03}
Y, X = np.indices((128, 128))
find_mask = MaskParameters().find_mask


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Return the correlation of two pictures over all channels, each without its mean."""
    a, b = a - a.mean((0, 1)), b - b.mean((0, 1))
    return float((a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum()))


@cache
def draw_texture(model: str, seed: int, far: int = 1) -> tuple[Texture, Image]:
    """Return a texture of ``far`` times 128 px a side, and its first 128 x 128 px as a read-only sample."""
    texture = nrbench.texture(model, shape=(128 * far, 128 * far), seed=seed, **STRENGTH)
    sample = quantize(texture.image[:128, :128])
    sample.flags.writeable = False
    return texture, sample


@cache
def find_own_mask(model: str, seed: int) -> TextureMask:
    """Return the mask of :func:`draw_texture`'s sample, found without a lattice."""
    return find_mask(draw_texture(model, seed)[1])


def gray(values: np.ndarray, noise: float = 0.0) -> Image:
    """Return a gray sample of values, with white noise."""
    noisy = values + noise * np.random.default_rng(0).standard_normal(values.shape)
    return quantize(np.clip(noisy, 0, 1).astype(np.float32)[..., np.newaxis])


@pytest.mark.parametrize("model", ["brick", "weave", "hexagon"])
def test_the_mask_is_the_ideal_image_and_not_the_departures(model: str) -> None:
    """The mask correlates with the ideal image, in the sample and far away; the rest of the sample does not."""
    texture, sample = draw_texture(model, 21, far=8)
    mask = find_mask(sample)
    near, far = mask.draw((128, 128)), mask.draw((1024, 1024))
    assert correlation(near, texture.ideal[:128, :128]) > 0.97
    assert correlation(far, texture.ideal) > 0.95
    assert abs(correlation(sample - near, texture.ideal[:128, :128])) < 0.05
    assert mask.lattice is not None and mask.lattice.is_equivalent(texture.lattice, 0.05)
    assert mask.harmonics.groups == (2,)


def test_a_given_lattice_is_where_it_starts() -> None:
    """From a lattice with an error of 1.5 % and another basis, the search finds the same mask as without a lattice."""
    texture, sample = draw_texture("brick", 22)
    (a, b), stretch = texture.lattice.matrix, np.diag([1.015, 0.99])
    given = find_mask(sample, Lattice.from_basis(np.stack([a + b, b]) @ stretch))
    own = find_own_mask("brick", 22)
    assert given.lattice is not None and given.lattice.is_equivalent(texture.lattice, 0.02)
    np.testing.assert_allclose(given.draw((128, 128)), own.draw((128, 128)), atol=0.02)


def test_a_sample_without_waves_is_refused() -> None:
    """A constant image, and one of which no wave exceeds the threshold."""
    with pytest.raises(Refused):
        find_mask(np.full((64, 64, 3), 0.4, np.float32))
    with pytest.raises(Refused, match="exceeds its noise and the threshold of 100"):
        MaskParameters(threshold=100.0).find_mask(draw_texture("brick", 23)[1])


def test_windows_are_of_one_picture() -> None:
    """A window far away equals that part of a larger one, at the same offsets."""
    mask = find_own_mask("weave", 24)
    whole, part = mask.draw((90, 120), (-30.0, 7.0)), mask.draw((40, 50), (10.0, 27.0))
    np.testing.assert_allclose(whole[20:60, 40:90], part, atol=1e-6)


@pytest.mark.parametrize("spectrum", ["white", "pink", "brown", "blobs", "grass"])
@pytest.mark.parametrize("seed", range(3))
def test_noise_has_no_regular_part(spectrum: str, seed: int) -> None:
    """Textures without a lattice, whatever their spectrum, are refused."""
    with pytest.raises(Refused, match="no regular part"):
        find_mask(quantize(nrbench.texture("noise", seed=seed, spectrum=spectrum).image))


@pytest.mark.parametrize("seed", [6, 8])
def test_less_than_a_tile_has_no_regular_part(seed: int) -> None:
    """Pieces nearly as large as the sample do not repeat; waves of an edge and one other wave are no lattice."""
    known = {"width": 127.3, "height": 117.1, "gap": 3.1, "color": 0.2, "intensity": 0.15, "noise": 0.03}
    texture = nrbench.texture("jigsaw", (160, 160), seed, **known)
    with pytest.raises(Refused, match="no regular part"):
        find_mask(quantize(texture.image))


def test_a_single_wave_makes_a_mask() -> None:
    """One cosine, noisy, is one group of one wave; it has no lattice, and a tile for stripes at a slant."""
    mask = find_mask(gray(0.5 + 0.2 * np.cos(2 * np.pi * (0.0625 * X + 0.025 * Y)), 0.1))
    assert mask.harmonics.groups == (1,) and mask.lattice is None
    np.testing.assert_allclose(np.abs(mask.harmonics.frequencies), [[0.0625, 0.025]], atol=2e-4)
    assert mask.find_period(0.3) == (16, 40)


def test_two_gratings_have_a_lattice() -> None:
    """Two crossed cosines are two groups, and their lattice is dual to both."""
    mask = find_mask(gray(0.5 + 0.1 * np.cos(2 * np.pi * X / 14.3) + 0.1 * np.cos(2 * np.pi * Y / 20.7), 0.02))
    assert mask.lattice is not None and mask.lattice.is_equivalent(Lattice((14.3, 0.0), (0.0, 20.7)), 0.01)


@pytest.mark.parametrize("period", [17.7, 31.3])
def test_pinstripes_are_one_group(period: float) -> None:
    """Lines 1.5 px wide and far apart are one fundamental with many harmonics; their tile is free along them."""
    lines = np.mean([(X + step) % period < 1.5 for step in np.linspace(-0.5, 0.5, 21)], 0)
    mask = find_mask(gray(0.3 + 0.3 * lines, 0.03))
    assert mask.harmonics.groups == (1,) and len(mask.harmonics.frequencies) > 8
    assert 1 / np.abs(mask.harmonics.fundamentals).max() == pytest.approx(period, abs=0.1)
    tile = mask.find_period(0.5)
    assert tile is not None and tile[0] == tile[1] and abs(tile[0] - period) < 0.6


def test_two_lattices_have_a_common_tile() -> None:
    """Squares over hexagons are two groups of two; the tile of both is five squares wide, beyond the sample."""
    texture = nrbench.texture("overlap", shape=(160, 160), seed=5, period=36.6, color=0.15, intensity=0.1, noise=0.02)
    mask = find_mask(quantize(texture.image))
    assert mask.harmonics.groups[:2] == (2, 2)
    tile = mask.find_period(1.0)
    assert tile is not None and np.abs(np.subtract(tile, 183)).max() <= 1


@pytest.mark.parametrize("levels", [(0.5, None, None), (None, 0.25, 0.75), (0.0, None, 1.0)])
def test_channels_that_show_nothing_change_nothing(levels: tuple[float | None, ...]) -> None:
    """The lattice is that of the channels that vary, whatever the rest is, black and white too."""
    texture, sample = draw_texture("brick", 23)
    sample = sample.copy()
    for channel, level in enumerate(levels):
        if level is not None:
            sample[..., channel] = level
    mask = find_mask(quantize(sample))
    assert mask.lattice.is_equivalent(texture.lattice, 0.1)


def test_gray_stored_as_color_has_the_mask_of_gray() -> None:
    """The mask of three equal channels is the mask of one channel, three times."""
    sample = draw_texture("brick", 23)[1][:96, :96].mean(2, keepdims=True)
    single = find_mask(quantize(sample)).draw((64, 64))
    triple = find_mask(quantize(np.repeat(sample, 3, 2))).draw((64, 64))
    np.testing.assert_allclose(triple, np.repeat(single, 3, 2), atol=2e-3)


@pytest.mark.parametrize("side", [1.0, 2.0, 100.0, 4000.0])
def test_a_lattice_that_the_sample_does_not_show_is_left_aside(side: float) -> None:
    """A lattice that is too fine for pixels, or is repeated less than twice, is ignored."""
    sample = draw_texture("brick", 24)[1]
    given = find_mask(sample, Lattice((side, 0), (0, side)))
    np.testing.assert_array_equal(given.draw((40, 40)), find_own_mask("brick", 24).draw((40, 40)))


def test_the_lattice_is_that_of_the_strongest_group() -> None:
    """A given lattice that explains little of the sample comes after the one that explains most."""
    texture, sample = draw_texture("brick", 24)
    mask = find_mask(sample, Lattice((13.3, 2.1), (-4.0, 17.7)))
    assert mask.lattice.is_equivalent(texture.lattice, 0.3)


@pytest.mark.parametrize("shape", [(8, 8), (8, 200), (9, 13)])
@pytest.mark.parametrize("kind", ["noise", "stripes", "checks", "dot", "step"])
def test_small_and_odd_samples_are_refused_or_masked(shape: tuple[int, int], kind: str) -> None:
    """Every sample gives a finite mask of any size, or is refused."""
    y, x = np.indices(shape)
    values = {
        "noise": np.random.default_rng(1).random(shape),
        "stripes": 0.5 + 0.4 * np.cos(2 * np.pi * x / 4.3),
        "checks": ((x + y) % 4 < 2).astype(float),
        "dot": ((x - 4) ** 2 + (y - 4) ** 2 < 6).astype(float),
        "step": (x > 3).astype(float),
    }[kind]
    try:
        mask = find_mask(gray(values))
    except Refused:
        return
    assert np.isfinite(mask.draw((50, 70), (1e4, -1e4))).all()


@pytest.mark.parametrize(("color", "seed"), [(0.14, 56), (0.3, 57)])
def test_what_threads_have_in_common_by_chance_is_no_larger_tile(color: float, seed: int) -> None:
    """The lattice is the weave's, though some of its threads' colors nearly repeat after five rows."""
    texture = nrbench.texture("weave", shape=(128, 128), seed=seed, color=color, intensity=color / 2, noise=0.03)
    mask = find_mask(quantize(texture.image))
    assert mask.lattice.is_equivalent(texture.lattice, 0.1)


def test_free_masks_have_no_tile() -> None:
    """Free waves have no common period: no lattice and no tile."""
    mask = MaskParameters(threshold=8.0, harmonics="free").find_mask(draw_texture("brick", 25)[1])
    assert isinstance(mask, TextureMask) and mask.lattice is None and mask.find_period(0.5) is None


def mask_of(*bases: list[tuple[float, float]]) -> TextureMask:
    """Return a mask of one wave for each fundamental of some lattices, or of stripes at a distance (x, y)."""
    groups = [np.linalg.pinv(np.array(basis, np.float64)).T for basis in bases]
    fundamentals = np.concatenate(groups)
    count = len(fundamentals)
    waves = WaveAnalysis(
        fundamentals, np.ones((count, 1)), np.zeros((count, 1)), np.zeros(1),
        fundamentals, np.eye(count, dtype=np.int64), tuple(len(group) for group in groups), 1.0,
    )  # fmt: skip
    return TextureMask(waves)


def test_rectangles_of_a_lattice_and_of_stripes() -> None:
    """That of a running bond is one brick by two courses, up to rounding; along stripes any length is a period."""
    assert mask_of([(27.3, 0.0), (13.65, 12.2)]).find_period() == (27, 24)
    assert mask_of([(0.0, 16.2)]).find_period() == (16, 16)


def test_several_groups_share_a_period() -> None:
    """Periods of 6 and 10 px across, of two lattices, are both periods of 30; without one within the limit, None."""
    mask = mask_of([(6.0, 0.0), (0.0, 5.0)], [(10.0, 0.0), (0.0, 7.0)])
    assert mask.find_period(0.1) == (30, 35)
    assert mask.find_period(0.1, 29) is None


def test_its_sides_are_lattice_vectors() -> None:
    """Whatever the lattice, both sides are within the tolerance of lattice vectors."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        basis = rng.uniform(6, 20, (2, 2)) * [[1, 0.3], [-0.2, 1]]
        found = mask_of(basis.tolist()).find_period()
        if found is not None:
            assert np.hypot(*Lattice.from_basis(basis).wrap(np.diag(found)).T).max() <= 0.5
