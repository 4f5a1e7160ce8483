"""A spline surface of correlations rates and fits lattices."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage

from nrbench.detectors.autocorrelation.lattice_evidence import PAD, REACH, LatticeEvidence, finer_bases, highest_added
from nrbench.detectors.autocorrelation.lattice_evidence_kernels import rate_added_points
from nrbench.detectors.autocorrelation.vector_pair_kernels import mean_correlations
from nrbench.detectors.candidate_search.sublattice_search import ridge_height
from nrbench.imaging.correlation import half_autocorrelation
from nrbench.lattice.geometry import Lattice, hermite_matrices


def waves(shape: tuple[int, int], basis: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return a smooth periodic image ``(H, W, 1)``: each generating vector's wave, and their product."""
    y, x = np.indices(shape)
    u, v = np.moveaxis(np.stack([x, y], -1) @ np.linalg.inv(basis), -1, 0)
    image = np.cos(2 * np.pi * u) + 0.7 * np.sin(2 * np.pi * v) + 0.5 * np.cos(2 * np.pi * (u + v))
    return (image[..., np.newaxis] / 5 + 0.5).astype(np.float32)


BASIS = np.array([[17.3, 2.1], [-4.4, 14.8]])


@pytest.fixture
def rng() -> np.random.Generator:
    """Return a generator of its own for each test."""
    return np.random.default_rng(7)


@pytest.fixture(scope="module")
def evidence() -> LatticeEvidence:
    """Return the evidence of a smooth periodic image."""
    return LatticeEvidence(half_autocorrelation(waves((130, 150), BASIS)))


def test_jets_read_the_spline(evidence: LatticeEvidence, rng: np.random.Generator) -> None:
    """Values equal scipy's cubic spline; derivatives equal differences of values."""
    lags = rng.uniform((-80, -80), (80, 80), (200, 2))
    found = evidence.jets(lags)
    turned = np.where(lags[:, :1] < 0, -lags, lags)
    padded = np.concatenate([evidence.gamma[::-1, PAD:0:-1], evidence.gamma], 1).astype(np.float64)
    there = turned.T[::-1] + np.array([[129], [PAD]])
    np.testing.assert_allclose(found[:, 0], ndimage.map_coordinates(padded, there, order=3), atol=1e-6)
    step = np.array([1e-4, 0])
    along = (evidence.jets(lags + step)[:, :3] - evidence.jets(lags - step)[:, :3]) / 2e-4
    np.testing.assert_allclose(along, found[:, [1, 3, 5]], atol=1e-4)
    along = (evidence.jets(lags + step[::-1])[:, :3] - evidence.jets(lags - step[::-1])[:, :3]) / 2e-4
    np.testing.assert_allclose(along, found[:, [2, 5, 4]], atol=1e-4)


def test_agreement_is_the_mean_over_multiples(evidence: LatticeEvidence) -> None:
    """The compiled mean and variance equal those over the listed multiples, weighted by overlaps."""
    lags = evidence.multiples(BASIS) @ BASIS
    values, weights = evidence.jets(lags)[:, 0], evidence.overlaps(lags)
    mean = np.average(values, weights=weights)
    found = evidence.agreement(BASIS)
    assert found.lags == len(lags)
    assert found.mean == pytest.approx(mean, abs=1e-9)
    assert found.variance == pytest.approx(np.average((values - mean) ** 2, weights=weights), abs=1e-9)


def test_a_split_is_the_difference_of_both_parts(evidence: LatticeEvidence) -> None:
    """The excess of supercells equals the agreement at their multiples less that at all others, in standard errors."""
    changes = np.concatenate([hermite_matrices(index) for index in (2, 3, 4)])
    for change, split in zip(changes, evidence.split(BASIS, changes), strict=True):
        own, others = evidence.agreement(change @ BASIS), evidence.agreement(BASIS, change @ BASIS)
        assert split.excess == pytest.approx(own.mean - others.mean, abs=1e-9)
        error = np.sqrt(own.variance / own.lags + others.variance / others.lags)
        assert abs(split.errors) <= abs(split.excess / error) + 1e-6


def test_a_sample_of_many_lags_has_their_mean(evidence: LatticeEvidence) -> None:
    """A sample of a tenth of the lags has nearly their mean, wherever the lags of the coarser lattice lie."""
    small, cells = BASIS / 4, np.linalg.inv(BASIS)
    for finer in np.concatenate([small[np.newaxis], finer_bases(small, (2, 3))]):
        one = finer[np.newaxis]
        whole, part = (
            rate_added_points(evidence._spline, one, cells, evidence._end, PAD, most)[0] for most in (0, 200)
        )
        assert 120 < part[2] < 300 < 1000 < whole[2]
        assert part[0] == pytest.approx(whole[0], abs=4 * np.sqrt(whole[1] / part[2]))
        assert part[1] == pytest.approx(whole[1], rel=0.3)


def test_few_of_many_multiples_fit_a_basis(monkeypatch: pytest.MonkeyPatch, evidence: LatticeEvidence) -> None:
    """The fit to a sample of the multiples ends within 0.01 px of the fit to all."""
    start, expected = BASIS + np.array([[0.6, -0.4], [0.3, 0.5]]), evidence.fit(BASIS)
    monkeypatch.setattr("nrbench.detectors.autocorrelation.lattice_evidence.MOST_FITTED", 20)
    monkeypatch.setattr("nrbench.detectors.autocorrelation.lattice_evidence.NEAREST", 2)
    np.testing.assert_allclose(evidence.fit(start), expected, atol=0.01)
    assert not np.array_equal(evidence.fit(start), expected)


def test_no_multiples() -> None:
    """Where a lattice has no multiple within reach, the mean is -1 and the count 0."""
    spline = np.zeros((15, 8 + PAD))
    found = rate_added_points(spline, 90 * np.eye(2)[np.newaxis], np.zeros((2, 2)), np.full(2, 5.0), PAD, 0)
    np.testing.assert_array_equal(found, [[-1, 0, 0]])


@settings(max_examples=40)
@given(st.integers(-3, 3), st.integers(-3, 3), st.booleans())
def test_any_basis_has_the_same_evidence(a: int, b: int, flip: bool) -> None:
    """A change of basis by an integer matrix of determinant +-1 changes neither mean nor count."""
    seen = LatticeEvidence(half_autocorrelation(waves((64, 72), BASIS)))
    change = np.array([[1, a], [b, 1 + a * b]]) * (np.array([[-1], [1]]) if flip else 1)
    found, expected = seen.agreement(change @ BASIS), seen.agreement(BASIS)
    assert found.lags == expected.lags
    assert found.mean == pytest.approx(expected.mean, abs=1e-9)


@settings(max_examples=25)
@given(st.tuples(*[st.floats(-1.2, 1.2)] * 4))
def test_fit_finds_the_vectors(offsets: tuple[float, ...]) -> None:
    """From within a pixel of the true vectors, the fit ends within 0.01 px of them."""
    seen = LatticeEvidence(half_autocorrelation(waves((130, 150), BASIS)))
    fitted = seen.fit(BASIS + np.reshape(offsets, (2, 2)))
    expected = Lattice((BASIS[0, 0], BASIS[0, 1]), (BASIS[1, 0], BASIS[1, 1])).reduced().matrix
    np.testing.assert_allclose(fitted, expected, atol=0.01)


def test_the_explained_variance_is_that_of_leave_one_out(rng: np.random.Generator) -> None:
    """Predicting each tile by the mean of all others explains the share of ``explained_variance_loo``."""
    tile, tiles = rng.normal(size=(16, 16)), 64
    stack = tile + 0.8 * rng.normal(size=(tiles, 16, 16))
    image = stack.reshape(8, 8, 16, 16).transpose(0, 2, 1, 3).reshape(128, 128, 1).astype(np.float32)
    others = (stack.sum(0) - stack) / (tiles - 1)
    explained = 1 - ((stack - others) ** 2).mean() / stack.var()
    seen = LatticeEvidence(half_autocorrelation(image))
    assert seen.explained_variance_loo(16 * np.eye(2)) == pytest.approx(explained, abs=0.02)


def test_sigmas_are_standard_deviations(rng: np.random.Generator) -> None:
    """On white and on smooth noise, a random lattice deviates by one sigma in the mean square."""
    for smoothness in (0.0, 1.5):
        found = [
            LatticeEvidence(
                half_autocorrelation(
                    ndimage.gaussian_filter(rng.normal(size=(96, 96, 1)), (smoothness, smoothness, 0)).astype(
                        np.float32
                    )
                )
            ).sigmas(np.array([[19.0, 3.0], [-2.0, 22.0]]))
            for _ in range(60)
        ]
        assert 0.5 < np.sqrt(np.mean(np.square(found))) < 1.4


def test_pairs_are_rated_by_their_multiples(rng: np.random.Generator) -> None:
    """The compiled rating of a pair equals the mean, weighted by overlap, of the surface at its whole multiples."""
    surface = rng.integers(-1000, 1000, (79, 50)).astype(np.int32)
    pair = np.array([[7.0, 2.0], [-3.0, 9.0]])
    (x1, y1, x2, y2, rated), *rest = mean_correlations(surface, pair, 1000.0, REACH)
    assert not rest
    assert (x1, y1, x2, y2) == (7, 2, -3, 9)
    numbers = [(a, b) for b in range(20) for a in range(-20, 21) if b > 0 or a > 0]
    lags = np.array(numbers) @ pair.astype(int)
    lags = lags[(np.abs(lags) <= REACH * np.array([49, 39])).all(1)]
    lags = np.where(lags[:, :1] < 0, -lags, lags)
    weights = (50 - lags[:, 0]) * (40 - np.abs(lags[:, 1]))
    assert rated == pytest.approx(np.average(surface[39 + lags[:, 1], lags[:, 0]], weights=weights) / 1000)


def test_lags_on_one_line_tell_nothing_of_the_other_vector(evidence: LatticeEvidence) -> None:
    """If no multiple of the second vector is within reach, the multiples do not span the plane."""
    height, width = evidence.shape
    assert evidence.spans_plane(np.array([[9.0, 1.0], [-2.0, 11.0]]))
    assert not evidence.spans_plane(np.array([[9.0, 0.0], [1.0, 0.8 * height]]))
    assert not evidence.spans_plane(np.array([[0.8 * width, 0.0], [0.0, 0.8 * height]]))


def test_a_ridge_has_agreement_at_every_index() -> None:
    """On stripes any vector along them agrees; if every second tile is similar, only lattices of even index do."""
    motif, other = np.random.default_rng(1).normal(size=(2, 12, 16))
    halves = np.tile(np.concatenate([motif, motif + 0.1 * other], 1), (8, 3))
    stripes = np.tile(np.sin(2 * np.pi * np.arange(96) / 16), (96, 1))
    basis = np.array([[0.0, 12.0], [32.0, 0.0]])
    for image, low, high in ((stripes, 0.95, 1.05), (halves, -0.3, 0.5)):
        known = LatticeEvidence(half_autocorrelation(image[..., np.newaxis].astype(np.float32)))
        assert low < ridge_height(known, basis) / known.repeated(basis) < high
        assert highest_added(known, basis) > 0.95 * known.repeated(basis)
