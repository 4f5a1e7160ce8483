"""The waves of a picture are found, are sorted into groups of harmonics, and their regular part is kept."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import nrbench
from nrbench.datasets_procedural.brick import Brick
from nrbench.lattice.geometry import Lattice
from nrbench.spectra.harmonic_groups import (
    LEAST_DISTANCE,
    SpectrumPeaks,
    are_near,
    find_fundamentals,
    fold_frequencies,
    is_supercell,
    off_line_evidence,
    propose_basis,
    select_spaced,
)
from nrbench.spectra.harmonics import WaveAnalysis, find_channel_waves, find_free_waves, find_tied_waves, lowest_period
from nrbench.spectra.regular_part import line_floor
from nrbench.spectra.spectrum import Spectrum, dirichlet_sum, pair_kernels
from nrbench.spectra.wave_fit import FixedWaves, Waves
from nrbench.spectra.wave_search import analytic_signal, find_complex_waves, find_waves, noise_floor

SIDE = 128


def draw_waves(n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return frequencies (n, 2) at least two bins apart, amplitudes and phases (n,)."""
    f = np.zeros((0, 2))
    while len(f) < n:
        new = rng.uniform((0.01, -0.48), (0.48, 0.48))
        if not len(f) or np.abs(f - new).max(1).min() * SIDE > 2:
            f = np.concatenate([f, new[np.newaxis]])
    return f, rng.uniform(0.2, 1, n), rng.uniform(0, 2 * np.pi, n)


def picture(
    f: np.ndarray, amplitude: np.ndarray, phase: np.ndarray, shape: tuple[int, int] = (SIDE, SIDE)
) -> np.ndarray:
    """Return the sum of the waves, pixel by pixel, (H, W, 1)."""
    y, x = np.indices(shape)
    angles = 2 * np.pi * (f[:, 0, None, None] * x + f[:, 1, None, None] * y) + phase[:, None, None]
    return (amplitude[:, None, None] * np.cos(angles)).sum(0)[..., np.newaxis]


def grain(strength: float, seed: int = 1, side: int = SIDE) -> np.ndarray:
    """Return white noise, (side, side, 1)."""
    return strength * np.random.default_rng(seed).standard_normal((side, side, 1))


def test_the_lowest_wave_gives_the_tile_of_equation_7() -> None:
    """One over its components; where one is 0, the next wave that varies along this side; None if there is none."""
    bond = np.array([[2 / 27.3, 0], [1 / 27.3, -1 / 24.4], [0, 2 / 24.4]])
    assert lowest_period(bond, np.ones((3, 1)), (128, 128)) == pytest.approx((27.3, 24.4))
    upright = np.array([[0, 0.05], [0.1, 0.1], [0.001, 0.2]])
    assert lowest_period(upright, np.ones((3, 3)), (128, 100)) == pytest.approx((10, 20))
    assert lowest_period(np.array([[0.0, 0.05]]), np.ones((1, 1)), (128, 128)) == (None, 20.0)
    noisy = np.concatenate([bond, [[0.004, 0.003]]])
    assert lowest_period(noisy, np.array([[1.0], [0.3], [0.5], [0.24]]), (128, 128)) == pytest.approx((27.3, 24.4))
    assert lowest_period(np.zeros((0, 2)), np.zeros((0, 3)), (128, 128)) == (None, None)


def errors(found: WaveAnalysis, f: np.ndarray) -> np.ndarray:
    """Return how far, bins, each true frequency's nearest found one is, the larger component, (n,)."""
    apart = [np.abs(f[:, None] - sign * found.frequencies).max(2).min(1) for sign in (1, -1)]
    return np.asarray(np.minimum(*apart) * SIDE)


@pytest.mark.parametrize("n", range(1, 13))
def test_known_frequencies_are_found(n: int) -> None:
    """Of 1 to 12 pairs of real frequency, each is found within 1e-3 bin without noise, and nothing else."""
    f, amplitude, phase = draw_waves(n, np.random.default_rng([n, 0]))
    found = find_free_waves(picture(f, amplitude, phase))
    assert len(found.frequencies) == n
    assert errors(found, f).max() < 1e-3
    assert found.share == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("noise", [0.05, 0.2])
def test_noise_costs_no_more_than_it_must(noise: float) -> None:
    """In noise the median error of a pair is below twice its Cramer-Rao bound."""
    ratios = []
    for n in (1, 4, 8, 12):
        rng = np.random.default_rng([n, 7])
        f, amplitude, phase = draw_waves(n, rng)
        found = find_free_waves(picture(f, amplitude, phase) + noise * rng.standard_normal((SIDE, SIDE, 1)))
        ratios.extend(errors(found, f) / (np.sqrt(24) / (2 * np.pi) * noise / (amplitude * SIDE)))
    assert np.median(ratios) < 2


def test_amplitudes_and_phases_are_right() -> None:
    """What is analyzed at one place evaluates to the same picture anywhere, at any size and real offset."""
    f, amplitude, phase = draw_waves(6, np.random.default_rng(3))
    found = find_free_waves(picture(f, amplitude, phase, (90, 131)) + 0.4)
    known = picture(f, amplitude, phase + 2 * np.pi * f @ (-40.5, 200.25), (300, 70)) + 0.4
    np.testing.assert_allclose(found.evaluate((300, 70), (-40.5, 200.25)), known, atol=1e-4)


def test_channels_share_frequencies_or_not() -> None:
    """Joint waves have amplitudes in all channels; of channels analyzed each by itself, a wave has only its own."""
    one, two = (draw_waves(3, np.random.default_rng(seed)) for seed in (1, 2))
    planes = np.concatenate([picture(*one), picture(*two)], 2)
    joint, each = find_free_waves(planes), find_channel_waves(find_free_waves, planes)
    for found in (joint, each):
        assert len(found.frequencies) == 6 and max(errors(found, one[0]).max(), errors(found, two[0]).max()) < 1e-3
        np.testing.assert_allclose(found.evaluate((SIDE, SIDE)), planes, atol=1e-4)
    assert ((each.amplitudes > 0).sum(1) == 1).all()


def test_the_threshold_sets_how_many_waves() -> None:
    """A higher threshold, in units of 1/255, leaves fewer waves: exactly those whose amplitude exceeds it."""
    amplitude = np.array([0.5, 1.5, 3, 6, 12, 24]) / 255
    f, _, phase = draw_waves(6, np.random.default_rng(0))
    planes = picture(f, amplitude, phase)
    found = [find_free_waves(planes, threshold=t) for t in (0.4, 1, 2, 5, 10, 20, 50)]
    assert [len(waves.frequencies) for waves in found] == [6, 5, 4, 3, 2, 1, 0]


def test_noise_has_no_waves() -> None:
    """White noise yields a wave no more often than the false-alarm rate says (5 % of 40: more than 5 has odds 1 %)."""
    noise = np.random.default_rng(0).standard_normal((40, 48, 48, 3))
    alarms = [len(find_free_waves(planes, false_alarms=0.05).frequencies) > 0 for planes in noise]
    assert sum(alarms) <= 5


def test_the_floor_is_the_noise_in_spite_of_waves() -> None:
    """Under a dozen waves a hundred times as strong, the floor is the noise's own, and so is that of noise alone."""
    alone = noise_floor(np.abs(Spectrum(grain(0.01)).bins) ** 2)
    under = find_waves(Spectrum(grain(0.01) + picture(*draw_waves(12, np.random.default_rng(0)))), None, 0.01, 50).floor
    for floor in (alone, under):
        assert 0.95 < np.median(floor) / (0.01**2 * SIDE**2) < 1.3


def test_tied_masks_hold_far_from_the_sample() -> None:
    """At four times the sample's size a tied mask still fits the ideal brick wall; a free one has drifted."""
    model = Brick(color=0.3, noise=0.1)
    whole = model.render((4 * SIDE, 4 * SIDE), np.random.default_rng(0))
    sample = whole.image[:SIDE, :SIDE].astype(np.float64)
    masks = (find(sample).evaluate((4 * SIDE, 4 * SIDE)) for find in (find_free_waves, find_tied_waves))
    free, tied = (np.corrcoef(mask.ravel(), whole.ideal.ravel())[0, 1] for mask in masks)
    assert tied > 0.95 > free


def test_two_overlapping_lattices_are_two_groups() -> None:
    """Harmonics of two incommensurate lattices are tied to two pairs of fundamentals, and all are found."""
    first, second = np.array([[0.0512, 0.0031], [-0.0107, 0.0733]]), np.array([[0.0431, 0.0411], [0.0383, -0.0571]])
    orders = np.array([(1, 0), (0, 1), (1, 1), (1, -1), (2, 0), (0, 2), (2, 1), (3, 1), (1, 2)])
    f = np.concatenate([orders @ first, orders @ second])
    amplitude = np.concatenate([strength / (1 + np.abs(orders).sum(1)) for strength in (1.0, 0.7)])
    found = find_tied_waves(picture(f, amplitude, np.random.default_rng(0).uniform(0, 6, len(f))) + grain(0.05))
    assert found.groups[:2] == (2, 2)
    np.testing.assert_allclose(found.frequencies, found.orders @ found.fundamentals, atol=1e-12)
    assert errors(found, f).max() < 0.02


def test_pinstripes_are_a_group_of_one_fundamental() -> None:
    """Narrow stripes, many harmonics along one direction, are one group, whose fundamental is their own."""
    step = np.array([0.0371, 0.0113])
    f = np.arange(1, 9)[:, None] * step
    found = find_tied_waves(picture(f, np.full(8, 0.1), np.zeros(8)) + grain(0.05))
    assert found.groups == (1,) and len(found.frequencies) >= 8
    np.testing.assert_allclose(np.abs(found.fundamentals), step[np.newaxis], atol=1e-4)


def test_a_constant_channel_has_amplitude_zero() -> None:
    """A constant channel stays constant, and a constant picture has no waves."""
    f, amplitude, phase = draw_waves(3, np.random.default_rng(0))
    planes = np.concatenate([picture(f, amplitude, phase), np.full((SIDE, SIDE, 1), 0.5)], 2)
    found = find_free_waves(planes)
    np.testing.assert_allclose(found.evaluate((50, 50))[..., 1], 0.5, atol=1e-6)
    assert len(find_free_waves(np.full((16, 16, 3), 0.3)).frequencies) == 0


@pytest.mark.parametrize("shape", [(31, 40), (30, 40), (9, 17)])
def test_the_analytic_signal_has_half_the_plane(shape: tuple[int, int]) -> None:
    """Its real part is the picture less its mean, and of each pair f, -f below Nyquist one is 0."""
    planes = np.random.default_rng(0).standard_normal((*shape, 2))
    signal = analytic_signal(planes)
    np.testing.assert_allclose(signal.real, planes - planes.mean((0, 1)), atol=1e-12)
    power = np.abs(np.fft.fft2(signal, axes=(0, 1))) ** 2
    mirror = power[-np.arange(shape[0]) % shape[0]][:, -np.arange(shape[1]) % shape[1]]
    y, x = (np.arange(n)[k] for n, k in zip(shape, np.ix_(*map(np.arange, shape)), strict=True))
    own = (2 * x == shape[1]) | ((2 * y) % shape[0] + x == 0)
    assert np.minimum(power, mirror)[~own].max() < 1e-15 * power.max()


def test_the_analytic_search_finds_known_frequencies() -> None:
    """In noise, waves away from the border are found by the paper's search as well as by ours."""
    for n in (1, 8, 12):
        f, amplitude, phase = draw_waves(n, np.random.default_rng([n, 0]))
        found = find_free_waves(picture(f, amplitude, phase) + grain(0.02, 5), signal="analytic")
        assert len(found.frequencies) == n and errors(found, f).max() < 2e-3


def test_the_analytic_signal_is_inexact_near_its_border() -> None:
    """One real wave of f_x within a bin of 0 is several complex ones, misplaced; ours, or a joint fit, sees one."""
    limit = np.full((1, SIDE, SIDE // 2 + 1), (0.05 * SIDE * SIDE / 2) ** 2)
    misplaced = {}
    for f_x in (0.3, 30.3):
        f = np.array([[f_x, 5.4]]) / SIDE
        planes = picture(f, np.ones(1), np.ones(1))
        first = find_complex_waves(Spectrum(planes), limit, 50)
        misplaced[f_x] = np.abs(first[0] - f[0]).max() * SIDE
        assert (len(first) > 1) == (f_x < 1)
        for signal in ("real", "analytic"):
            found = find_free_waves(planes, threshold=0.05 * 255, signal=signal)
            assert len(found.frequencies) == 1 and errors(found, f).max() < 1e-3
    assert misplaced[0.3] > 0.03 and misplaced[30.3] < 0.005


@pytest.mark.parametrize("shape", [(31, 40), (9, 8), (64, 17)])
def test_the_spectrum_is_the_sum_over_pixels(shape: tuple[int, int]) -> None:
    """At any real frequency the transform and its moments equal the sums over all pixels."""
    rng = np.random.default_rng(0)
    planes, f = rng.standard_normal((*shape, 2)), rng.uniform(-0.5, 0.5, (30, 2))
    spectrum = Spectrum(planes)
    v, u = (np.arange(n) - (n - 1) / 2 for n in shape)
    turns = np.exp(-2j * np.pi * (f[:, 0, None, None] * u + f[:, 1, None, None] * v[:, None]))
    sums = [np.einsum("nyx,yxc->nc", turns * w, planes - planes.mean((0, 1))) for w in (1, u, v[:, None])]
    value, moments = spectrum.values_and_moments(f)
    np.testing.assert_allclose(value, sums[0], atol=1e-6)
    np.testing.assert_allclose(moments, sums[1:], atol=1e-4)
    np.testing.assert_allclose(spectrum.values(f), value, atol=1e-9)
    f[:, 0], offsets = np.abs(f[:, 0]), np.linspace(-0.75, 0.75, 4)
    fan = np.stack(np.meshgrid(offsets, offsets), -1) / spectrum.size
    near = spectrum.values((f[:, None, None] + fan).reshape(-1, 2)).reshape(30, 4, 4, 2)
    np.testing.assert_allclose(spectrum.around(f, offsets), near, atol=1e-6)


@given(st.floats(-1.2, 1.2), st.integers(2, 300))
@settings(max_examples=60)
def test_dirichlet_sums_are_sums(frequency: float, length: int) -> None:
    """The closed form equals the sum, near the poles and away from them."""
    u = np.arange(length) - (length - 1) / 2
    known = np.cos(2 * np.pi * frequency * u).sum()
    assert dirichlet_sum(np.array([frequency]), length)[0] == pytest.approx(known, abs=1e-6 * length)


def test_kernels_of_pairs_are_sums_over_the_picture() -> None:
    """At differences and sums of frequencies they equal sums over the pixels, with their slopes and curvatures."""
    f, (height, width) = np.random.default_rng(0).uniform(-0.9, 0.9, (5, 2)), (7, 10)
    y, x = (np.arange(n) - (n - 1) / 2 for n in (height, width))
    r = 2 * np.pi * np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    for sign, kernel in zip((-1, 1), pair_kernels(f, (height, width)), strict=True):
        phase = (f[:, np.newaxis] + sign * f) @ r.T
        np.testing.assert_allclose(kernel.value, np.cos(phase).sum(2), atol=1e-9)
        np.testing.assert_allclose(kernel.slope, -np.einsum("ijp,pa->aij", np.sin(phase), r), atol=1e-7)
        curvature = -np.einsum("ijp,pa,pb->abij", np.cos(phase), r, r)
        np.testing.assert_allclose(kernel.curvature, curvature, atol=1e-5)


def test_waves_of_fixed_frequencies_have_the_amplitudes_of_others() -> None:
    """Also where frequencies share a component, or are nearly mirror images across the Nyquist frequency."""
    rng = np.random.default_rng(3)
    f = np.array([(0.1, 0.2), (0.1, 0.3), (0.1 + 1e-9, -0.2), (0.0, 0.25), (0.493, 0.493), (0.493, -0.494)])
    f = np.concatenate([f, draw_waves(90, rng)[0]])
    spectrum = Spectrum(rng.random((60, 71, 2)))
    fixed = FixedWaves(spectrum, f, spectrum.values(f))
    for found, expected in zip(fixed.origin_amplitudes(), Waves(spectrum, f).origin_amplitudes(), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-8)


def test_what_waves_leave_is_alike_on_grids_and_one_by_one() -> None:
    """The waves' transform on small grids equals that at each frequency."""
    rng = np.random.default_rng(0)
    waves = Waves(Spectrum(rng.standard_normal((24, 31, 3))), rng.uniform(-0.4, 0.4, (6, 2)))
    f, offsets = rng.uniform(-0.4, 0.4, (4, 2)), np.array([-0.5, 0.25, 0.75])
    fan = f[:, np.newaxis, np.newaxis] + np.stack(np.meshgrid(offsets, offsets), -1) / waves.spectrum.size
    known = waves.transform_at(fan.reshape(-1, 2)).reshape(4, 3, 3, 3)
    np.testing.assert_allclose(waves.transform_around(f, offsets), known, atol=1e-9)


def test_the_normal_equations_hold_the_gradient() -> None:
    """The right side is half the slope of the explained energy by each frequency."""
    rng = np.random.default_rng(0)
    f, amplitude, phase = draw_waves(4, rng)
    spectrum = Spectrum(picture(f, amplitude, phase) + grain(1))
    start, step = f + 0.2 / SIDE, 1e-7
    right = Waves(spectrum, start).normal_equations()[1]
    for k, a in np.ndindex(4, 2):
        move = np.zeros((4, 2))
        move[k, a] = step
        rise = Waves(spectrum, start + move).explained - Waves(spectrum, start - move).explained
        assert rise.sum() / (4 * step) == pytest.approx(right[k, a], rel=1e-3)


CLOTH, THREAD, INDEX = 144, 12, 3
LATTICE = np.array([(1 / THREAD, 0.0), (0.0, 1 / THREAD)])
WAVES = np.array([(k / (INDEX * THREAD), 0.0) for k in (1, 2, 4, 5, 7)])


def threads(colors: np.ndarray) -> Spectrum:
    """Return the spectrum of upright threads of the same profile, each with a color of its own."""
    profile = np.hanning(THREAD + 2)[1:-1]
    row = (colors[:, np.newaxis] * profile).ravel()
    return Spectrum(np.tile(row, (CLOTH, 1))[..., np.newaxis])


@pytest.mark.parametrize("strength", [0.5, 0.1])
def test_a_larger_tile_is_believed(strength: float) -> None:
    """Every third thread is another, and chance adds little to it."""
    chance = 0.05 * strength * np.random.default_rng(0).standard_normal(CLOTH // THREAD)
    assert is_supercell(threads(strength * np.tile([1.0, 0.0, 0.0], 4) + chance), WAVES, LATTICE)


def test_random_colors_are_no_larger_tile() -> None:
    """Though each offset shows in many waves: hardly one of two hundred draws passes."""
    draws = (np.random.default_rng(seed).standard_normal(CLOTH // THREAD) for seed in range(200))
    assert sum(is_supercell(threads(colors - colors.mean()), WAVES, LATTICE) for colors in draws) <= 2


def test_too_little_beside_is_believed() -> None:
    """A tile repeated twice leaves no room between the places of its waves to compare them with."""
    assert is_supercell(Spectrum(grain(1, side=24)), np.array([(1 / 24, 0.0), (3 / 24, 0.0)]), np.eye(2) / 12)


def test_stripes_and_one_more_wave_are_no_lattice() -> None:
    """Harmonics of one fundamental with a wave off their line give one; with two more waves of a lattice, two."""
    places = [(0.0, 4.3 * k) for k in range(1, 7)] + [(9.1, 0.2), (2.0, 1.1)]
    stripes = SpectrumPeaks(np.array(places), np.full(8, 0.05), np.ones(8))
    pair = find_fundamentals(stripes)
    assert off_line_evidence(pair, stripes.weights) == 0 and len(propose_basis(stripes).vectors) == 1
    more = SpectrumPeaks(np.array([*places, (18.2, 4.7), (9.1, 4.5)]), np.full(10, 0.05), np.ones(10))
    assert len(propose_basis(more).vectors) == 2


def test_waves_along_one_line_do_not_lengthen_the_other_vector() -> None:
    """Of waves along one line, the vector beside the line stays as short as the places that were paired."""
    places = [(10.8, 1.5), (32.4, 4.5), (32.3, 4.4), (32.5, 4.6), (1.0, -26.4)]
    pair = find_fundamentals(SpectrumPeaks(np.array(places), np.full(5, 0.05), np.array([1.0, 0.4, 0.4, 0.4, 0.01])))
    assert pair is not None and np.abs(pair.vectors).max() < 1000
    assert np.linalg.matrix_rank(pair.orders[pair.explained]) == 1


def test_the_first_of_near_places_stays() -> None:
    """Of places that pixels cannot tell apart that of highest priority is kept, across the spectrum's border too."""
    f = np.array([(0.1, 0.2), (0.1, 0.203), (-0.1, -0.2), (0.4995, 0.1), (-0.4995, 0.1), (0.3, 0.3)])
    size = np.full(2, 128.0)
    kept = select_spaced(f, np.array([1.0, 3, 2, 5, 4, 6]), size)
    assert kept.tolist() == [5, 3, 1]
    assert are_near(f[:2], np.array([(-0.1, -0.2)]), size).all() and not are_near(f[5:], f[:5], size).any()


def test_weak_signs_of_a_larger_tile_count() -> None:
    """English bond, whose courses differ little, has its own lattice, not the four times finer one of its headers."""
    texture = nrbench.texture("brick", shape=(160, 160), seed=3, bond="english", color=0.18, intensity=0.25, noise=0.04)
    found = find_tied_waves(texture.image.astype(np.float64))
    assert texture.lattice is not None and found.groups == (2,)
    assert Lattice.from_basis(np.linalg.inv(found.fundamentals).T).is_equivalent(texture.lattice, 0.05)


def test_no_two_waves_of_a_mask_are_near() -> None:
    """Not even those that pixels fold back from beyond Nyquist: each is 3/4 bin from all others and their mirrors."""
    texture = nrbench.texture("weave", seed=4, color=0.3, intensity=0.2, noise=0.03)
    seen = fold_frequencies(find_tied_waves(texture.image.astype(np.float64)).frequencies)
    both = np.concatenate([seen, -seen])
    apart = np.hypot(*np.moveaxis(fold_frequencies(both[:, np.newaxis] - both) * 128, 2, 0)) + 9 * np.eye(len(both))
    assert len(seen) > 100 and apart.min() >= LEAST_DISTANCE


def test_the_floor_of_a_line_is_its_own() -> None:
    """On a line of the spectrum where rows vary at random the floor is that of the rows; beside it, of the noise."""
    rows = np.tile(np.random.default_rng(0).standard_normal((128, 1, 1)), (1, 128, 1)) + grain(0.01)
    power = np.abs(Spectrum(rows).bins) ** 2
    on, beside = line_floor(power, (128, 128), np.array([(0.0, 0.2), (0.2, 0.2)]), np.zeros((0, 2)))[:, 0]
    assert 0.3 < on / 128**3 < 3 and 0.3 < beside / (0.01**2 * 128**2) < 3
