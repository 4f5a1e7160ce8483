import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from nrbench import texture
from nrbench.datasets_procedural.weave import Weave
from nrbench.detectors.autocorrelation.peak_kernels import highest_ridge
from nrbench.detectors.autocorrelation.vector_pair_kernels import best_pair
from nrbench.detectors.gncc import Gncc, find_ridge, remove_stripes
from nrbench.imaging.convert import quantize
from nrbench.imaging.correlation import half_autocorrelation
from nrbench.lattice.geometry import Lattice
from nrbench.lattice.relation import lattice_error
from nrbench.plugins.forms import NoLatticeFound

ROTATIONS = {"brick": 17.3, "weave": 31.7, "hexagon": 11.9}
FAST = Gncc(reject="none")
PAPER = Gncc(**Gncc.presets["paper"])
Y, X = np.indices((96, 96)).astype(np.float64)


def noise(sigma: float, seed: int) -> np.ndarray:
    """Return smoothed noise of correlated channels, 96 x 96, in [0, 1]."""
    rng = np.random.default_rng(seed)
    fields = gaussian_filter(rng.standard_normal((128, 128, 2)), (sigma, sigma, 0))[16:112, 16:112]
    values = fields @ rng.uniform(0.2, 1, (2, 3))
    return quantize((0.5 + 0.15 * (values - values.mean()) / values.std()).astype(np.float32))


@pytest.mark.parametrize("family", ROTATIONS)
def test_lattices_are_found_exactly(family: str) -> None:
    """For mild and middle departures, aligned and rotated, 95 % are exact, with a median error below 0.1 px."""
    errors = []
    for color, grain, rotated, seed in itertools.product((0.1, 0.3), (0.02, 0.1), (False, True), range(3)):
        rotation = ROTATIONS[family] * rotated
        sample = texture(family, seed=seed, rotation=rotation, color=color, noise=grain)
        found = FAST.detect(quantize(sample.image)).lattice
        errors.append(lattice_error(found, sample.lattice, (256, 256)))
    assert sum(error.relation == "exact" for error in errors) >= 0.95 * len(errors)
    assert np.median([error.vector for error in errors]) < 0.1


@pytest.mark.parametrize("family", ROTATIONS)
@pytest.mark.parametrize("rotated", [False, True])
def test_lattices_are_separated_from_chance(family: str, rotated: bool) -> None:
    """By default a regular texture is accepted, its goodness well above the surrogates', and the lattice is exact."""
    sample = texture(family, seed=5, rotation=ROTATIONS[family] * rotated, color=0.3, noise=0.1)
    found = Gncc().detect(quantize(sample.image))
    assert sample.lattice is not None and found.lattice.is_equivalent(sample.lattice, 0.5)
    assert found.diagnostics["tested_goodness"] > found.diagnostics["limit"] > 0
    assert len(found.diagnostics["surrogate_goodness"]) == 30


def test_a_lattice_commensurate_with_the_image_is_found() -> None:
    """A period of a quarter of the image, which copies on the image's own torus would share, is accepted."""
    sample = texture("brick", width=32, height=16, color=0.3, noise=0.1)
    assert Gncc().detect(quantize(sample.image)).lattice.is_equivalent(sample.lattice, 0.5)


def test_a_wide_gray_image_has_its_lattice() -> None:
    """One channel, and sides of different length, change nothing."""
    sample = texture("hexagon", (96, 170), 1, period=18.4)
    found = FAST.detect(quantize(sample.image)[..., 1:2]).lattice
    assert sample.lattice is not None and found.is_equivalent(sample.lattice, 0.5)


@pytest.mark.parametrize("sigma", [0.0, 1.0, 3.0])
def test_noise_has_no_lattice(sigma: float) -> None:
    """White and smooth noise are refused; the exception carries the best candidate and its goodness."""
    for seed in range(2):
        with pytest.raises(NoLatticeFound, match="no better than chance") as refusal:
            Gncc().detect(noise(sigma, seed))
        assert refusal.value.best.diagnostics["tested_goodness"] <= refusal.value.best.diagnostics["limit"]


def test_none_always_answers() -> None:
    """With reject none even noise gets a lattice, as in the paper, and its confidence is low."""
    regular, random = FAST.detect(quantize(texture("hexagon").image)), FAST.detect(noise(1.0, 0))
    assert 0 <= random.confidence < 0.3 < 0.6 < regular.confidence <= 1


def test_the_papers_own_choice_is_exact_on_whole_periods() -> None:
    """At whole pixels, with all local maxima as candidates, lattices of whole periods are exact."""
    sample = texture("brick", width=26, height=13, color=0.2)
    found = PAPER.detect(quantize(sample.image)).lattice
    assert sample.lattice is not None and found.is_equivalent(sample.lattice)


def test_the_papers_own_choice_loses_fractional_periods() -> None:
    """On five weaves of 12.3 x 13.9 px it finds (12, +-14) px; the default finds the lattice."""
    for seed in range(5):
        sample = Weave(color=0.14).render((128, 128), np.random.default_rng(seed))
        found = PAPER.detect(quantize(sample.image)).lattice
        assert found.is_equivalent(Lattice((12, 14), (12, -14))), seed
        assert FAST.detect(quantize(sample.image)).lattice.is_equivalent(sample.lattice, 0.1)


def test_the_papers_own_choice_pairs_every_maximum() -> None:
    """A long period under strong noise is found among thousands of maxima, and not among the 200 shortest."""
    rng = np.random.default_rng(0)
    tile = gaussian_filter(rng.random((96, 96, 3)), (2, 2, 0), mode="wrap")
    tile = np.tile(0.5 + 0.1 * (tile - tile.mean()) / tile.std(), (3, 3, 1))[:256, :256]
    image = quantize(np.clip(tile + rng.normal(0, 0.3, tile.shape), 0, 1).astype(np.float32))
    square = Lattice((96, 0), (0, 96))
    assert PAPER.detect(image).lattice.is_equivalent(square)
    assert not replace(PAPER, peaks=200).detect(image).lattice.is_equivalent(square)


def test_the_goodness_is_that_of_the_paper() -> None:
    """For one pair it is the sum over the valid multiples, raised to alpha, over their number: by brute force."""
    rng = np.random.default_rng(0)
    height, width, alpha, overlap = 40, 52, 1.12, 0.85
    surface = rng.integers(-200, 1000, (2 * height - 1, width), np.int32)
    pair = np.array([[6.3, -4.1], [5.2, 8.8]])
    box_w, box_h = np.abs(pair).sum(0)
    total, count = 0, 0
    for a, b in itertools.product(range(-30, 31), repeat=2):
        x, y = a * pair[0] + b * pair[1]
        covered = min(width - abs(x), box_w) * min(height - abs(y), box_h) if abs(x) < width and abs(y) < height else 0
        if x > 0 and covered >= overlap * box_w * box_h:
            total += int(surface[round(y) + height - 1, round(x)])
            count += 1
    goodness, *vectors, multiples = best_pair(surface, pair, 1000.0, alpha, overlap)
    assert multiples == count and goodness == pytest.approx((total / 1000) ** alpha / count)
    assert vectors == pair.ravel().tolist()


def test_equivalent_pairs_are_rated_alike() -> None:
    """The second vector is reduced first: adding the first to it any number of times changes nothing."""
    surface = np.random.default_rng(0).integers(0, 1000, (99, 60), np.int32)
    near, far = np.array([[7.0, 2.0], [-3.0, 9.0]]), np.array([[7.0, 2.0], [25.0, 17.0]])
    near[1] *= -1
    first, second = (best_pair(surface, pair, 1000.0, 1.12, 0.85) for pair in (near, far))
    assert first[0] > 0 and first[0] == second[0] and first[5] == second[5]


def test_vectors_without_a_valid_multiple_have_no_goodness() -> None:
    """A pair whose second vector is longer than the image allows gets 0."""
    surface = np.full((79, 40), 1000, np.int32)
    assert best_pair(surface, np.array([[6.0, 0.0], [0.0, 30.0]]), 1000.0, 1.12, 0.85)[0] == 0


def stripes(angle: float, period: float = 11.0) -> np.ndarray:
    """Return stripes whose normal points along ``angle`` (radians), in [0.3, 0.7]."""
    phase = 2 * math.pi * (X * math.cos(angle) + Y * math.sin(angle)) / period
    return (0.5 + 0.2 * np.tanh(3 * np.sin(phase)))[..., np.newaxis].astype(np.float32)


def test_separate_peaks_stand_out_fully() -> None:
    """The correlation of a product of two waves has no ridge between its peaks: relief 1 or more."""
    waves = 0.5 + 0.4 * np.cos(2 * math.pi * X / 12) * np.cos(2 * math.pi * Y / 14)
    gamma = half_autocorrelation(waves[..., np.newaxis].astype(np.float32))
    assert find_ridge(gamma, Lattice((6.0, 7.0), (6.0, -7.0)), (50, 50)).relief >= 0.95


@pytest.mark.parametrize("angle", [0.0, 0.5, math.pi / 2, 2.2])
def test_stripes_are_a_ridge_along_themselves(angle: float) -> None:
    """Vectors that end on the ridges of a grating are joined by them, in the stripes' direction, however oblique."""
    normal, along = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
    t1, t2 = 11 * normal + 5 * along, 22 * normal - 9 * along
    ridge = find_ridge(half_autocorrelation(stripes(angle)), Lattice(tuple(t1), tuple(t2)), (50, 50))
    assert ridge.relief < 0.15
    assert abs(np.array(ridge.direction) @ normal) < 0.05 * math.hypot(*ridge.direction)


@pytest.mark.parametrize("angle", [0.0, 0.5, math.pi / 2, 2.2])
def test_stripes_are_taken_out(angle: float) -> None:
    """Less than 1 % of a grating's variance remains; of stripes across it, more than 95 %."""
    image = stripes(angle)
    along = (-math.sin(angle), math.cos(angle))
    assert remove_stripes(image, along).var() < 0.01 * image.var()
    assert remove_stripes(image, (math.cos(angle), math.sin(angle))).var() > 0.95 * image.var()


def test_the_highest_ridge_of_a_known_tile() -> None:
    """A wall of 0.8 with a gap of 0.5 along u, and one of 0.4 along v: the ridge runs along u at 0.5."""
    tile = np.zeros((9, 12), np.float32)
    tile[0, :], tile[:, 0] = 0.8, 0.4
    tile[0, 5] = 0.5
    tile[0, 0] = 1
    level, along, across = highest_ridge(tile, np.argsort(-tile.ravel(), kind="stable"))
    assert level == pytest.approx(0.5) and abs(along) == 1 and across == 0


def test_a_ridge_may_pass_several_tiles() -> None:
    """A diagonal that closes only after two turns along u and one along v is followed to its end."""
    tile = np.zeros((8, 8), np.float32)
    for step in range(16):
        tile[step // 2 % 8, step % 8] = 0.7
    tile[0, 0] = 1
    level, along, across = highest_ridge(tile, np.argsort(-tile.ravel(), kind="stable"))
    assert level == pytest.approx(0.7) and (abs(along), abs(across)) == (2, 1)
