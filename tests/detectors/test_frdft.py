import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrbench import texture
from nrbench.detectors.frdft import Frdft, surplus
from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import NoLatticeFound
from nrbench.spectra.harmonic_groups import Basis, SpectrumPeaks, find_fundamental, find_fundamentals

FAST = Frdft(reject="none")


def waveset(places: np.ndarray, spread: float = 0.05) -> SpectrumPeaks:
    """Return waves of equal weight."""
    return SpectrumPeaks(places, np.full(len(places), spread), np.ones(len(places)))


@pytest.mark.parametrize("family", ["brick", "weave", "hexagon"])
@pytest.mark.parametrize("rotation", [0.0, 17.0])
def test_lattices_are_found_exactly(family: str, rotation: float) -> None:
    """At middle strengths, axis-aligned and rotated, the lattice is exact, its vectors within a quarter pixel."""
    sample = texture(family, color=0.3, noise=0.1, rotation=rotation)
    assert FAST.detect(quantize(sample.image)).lattice.is_equivalent(sample.lattice, 0.25)


def test_the_papers_own_choice_is_the_tile_of_the_lowest_wave() -> None:
    """On a running bond it is the upright rectangle of two bricks; on a turned wall it is no period at all."""
    paper = Frdft(**Frdft.presets["paper"])
    bond = texture("brick", color=0.14, width=27.3, height=12.2)
    found = paper.detect(quantize(bond.image))
    assert found.lattice.is_equivalent(Lattice((27.3, 0), (0, 24.4)), 0.3) and 0.5 < found.confidence < 1
    turned = texture("brick", color=0.14, width=27.3, height=12.2, rotation=17.0)
    wrong = paper.detect(quantize(turned.image)).lattice
    assert np.hypot(*turned.lattice.wrap(wrong.matrix).T).max() > 2
    with pytest.raises(NoLatticeFound, match="no wave of the image varies along"):
        paper.detect(np.tile(np.sin(np.arange(64) / 2).astype(np.float32)[:, None, None] * 0.4 + 0.5, (1, 64, 1)))


@given(st.integers(0, 10_000), st.booleans())
@settings(max_examples=12)
def test_fundamentals_are_recovered_without_the_lowest_waves(seed: int, sparse: bool) -> None:
    """From shifted places and strays, the fundamentals' own places left out, the lattice is the true one."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0, np.pi)
    basis = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]) @ [[5.3, 0.4], [0.9, 6.8]]
    orders = np.array([(a, b) for a in range(4) for b in range(-3, 4) if (a, b) > (0, 0) and abs(a) + abs(b) > sparse])
    strays = rng.uniform(-25, 25, (3, 2))
    places = np.concatenate([orders @ basis + 0.03 * rng.standard_normal(orders.shape), strays])
    found = find_fundamentals(waveset(places[rng.permutation(len(places))]))
    dual = Lattice(tuple(basis[0]), tuple(basis[1]))
    assert Lattice(tuple(found.vectors[0]), tuple(found.vectors[1])).is_equivalent(dual, 0.1)


def test_one_fundamental_is_the_greatest_common_divisor() -> None:
    """Of multiples 2, 3, 5 of a step the step is found; a lone wave is its own."""
    step = np.array([3.1, 1.7])
    found = find_fundamental(waveset(np.array([2, 3, 5])[:, None] * step))
    np.testing.assert_allclose(found.vectors, step[np.newaxis], atol=1e-6)
    np.testing.assert_array_equal(found.orders[:, 0], (2, 3, 5))
    np.testing.assert_allclose(find_fundamental(waveset(step[np.newaxis] * 4)).vectors[0], 4 * step)


def test_lattices_are_told_from_chance() -> None:
    """By default a regular texture is accepted, its evidence above the limit of the copies."""
    sample = texture("hexagon", seed=1, color=0.3, noise=0.1)
    found = Frdft(surrogates=4).detect(quantize(sample.image))
    assert sample.lattice is not None and found.lattice.is_equivalent(sample.lattice, 0.25)
    assert found.diagnostics["tested_surplus"] > found.diagnostics["limit"]
    assert len(found.diagnostics["surrogate_surplus"]) == 4


def test_bands_of_noise_are_refused_by_the_test_alone() -> None:
    """Narrow bands of noise at places of no lattice have waves, an answer without the test and none with it."""
    rng = np.random.default_rng(2)
    y, x = np.indices((128, 128))
    turns = rng.uniform(-0.2, 0.2, (12, 2)) @ np.stack([x.ravel(), y.ravel()]) + rng.random((12, 1))
    image = 0.5 + 0.03 * np.cos(2 * np.pi * turns).sum(0).reshape(x.shape) + 0.03 * rng.standard_normal(x.shape)
    picture = np.clip(image, 0, 1)[..., np.newaxis].astype(np.float32)
    assert FAST.detect(picture).lattice.area > 0
    with pytest.raises(NoLatticeFound, match="chance") as refusal:
        Frdft(surrogates=4).detect(picture)
    best = refusal.value.best
    assert best is not None and best.diagnostics["tested_surplus"] <= best.diagnostics["limit"]


def basis(orders: list[tuple[int, int]], evidence: list[float]) -> Basis:
    """Return a basis with waves of given orders and evidence."""
    values = np.array(evidence)
    return Basis(np.eye(2) * 5, np.array(orders, np.float64), values > 0, values)


def test_unexplained_waves_do_not_change_the_evidence() -> None:
    """A wave near frequency 0, of order (0, 0), or anywhere else off the lattice, leaves the surplus as it is."""
    orders, evidence = [(1, 0), (0, 1), (1, 1), (2, 1)], [4.0, 3.0, 2.0, 5.0]
    known = surplus(basis(orders, evidence), np.ones(4))
    for stray in [(0, 0), (3, 0), (1, 1)]:
        assert surplus(basis([*orders, stray], [*evidence, -2.3]), np.ones(5)) == known == 5.0


def test_the_evidence_needs_two_directions() -> None:
    """A grating has none, however many its harmonics, nor with one stray wave; two waves have none; weights cancel."""
    line = [(1, 0), (2, 0), (3, 0), (4, 0)]
    assert surplus(basis(line, [5.0] * 4), np.ones(4)) == 0
    assert surplus(basis([*line, (1, 1)], [5.0] * 5), np.ones(5)) == 0
    assert surplus(basis([(1, 0), (0, 1)], [5.0] * 2), np.ones(2)) == 0
    weights = np.array([1.0, 0.5, 0.25, 0.1, 0.01])
    assert surplus(basis([*line, (1, 1)][::-1], list(5 * weights)), weights) == 0
    both = [*line, (0, 1), (1, 1)]
    weights = np.linspace(1, 0.1, 6)
    assert surplus(basis(both, list(5 * weights)), weights) == pytest.approx(5)


@pytest.mark.parametrize("shape", [(96, 170), (1100, 300)])
def test_any_shape_works(shape: tuple[int, int]) -> None:
    """One channel, sides of different length, and sides beyond the window change nothing."""
    sample = texture("hexagon", shape, 1, period=18.4, noise=0.1)
    found = FAST.detect(quantize(sample.image)[..., 1:2]).lattice
    assert sample.lattice is not None and found.is_equivalent(sample.lattice, 0.3)


def crossed_waves(truth: Lattice, shape: tuple[int, int]) -> Image:
    """Return two crossed waves with harmonics, whose crests are the points of a lattice, in faint noise."""
    u, v = np.moveaxis(truth.to_cell(np.moveaxis(np.indices(shape, np.float32)[::-1], 0, -1)), -1, 0)
    waves = sum(0.06 * np.cos(2 * np.pi * (a * u + b * v)) for a, b in ((1, 0), (0, 1), (1, 1), (1, -1), (2, 1)))
    noise = 0.02 * np.random.default_rng(0).standard_normal(shape)
    return np.clip(0.5 + waves + noise, 0, 1)[..., np.newaxis].astype(np.float32)


def test_large_images_are_judged_by_their_middle() -> None:
    """Of an image beyond the window only its middle is analyzed, and the origin is still the image's own."""
    truth = Lattice((31.3, 2.1), (-3.4, 37.9), (5.2, 9.7))
    found = FAST.detect(crossed_waves(truth, (1500, 1100)))
    assert found.diagnostics["spectrum"].values.shape == (1024, 1024)
    assert found.lattice.is_equivalent(truth, 0.01)
    off = truth.wrap(np.subtract(found.lattice.origin, truth.origin))
    assert np.abs(off).max() < 0.3


def test_the_origin_is_a_crest() -> None:
    """Where the texture is two crossed waves with harmonics, the origin is where both have their crest."""
    truth = Lattice((17.3, 2.1), (-3.4, 21.9), (5.2, 9.7))
    image = crossed_waves(truth, (128, 150))
    detection = FAST.detect(image)
    found = detection.lattice
    assert found.is_equivalent(truth, 0.05)
    assert np.abs(truth.wrap(np.subtract(found.origin, truth.origin))).max() < 0.3
    assert detection.has_origin and not Frdft(reject="none", tile="lowest").detect(image).has_origin
