"""Integrity: whole and joined elements."""

from functools import partial

import numpy as np
import pytest
from cases import MODELS, Case, case, copy_cells, scored
from scipy.stats import spearmanr

from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.cans import Cans
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.imaging.convert import quantize
from nrbench.metrics.integrity import Integrity
from nrbench.metrics.judgment.element_kernels import compare_tones, sum_products
from nrbench.metrics.perception import limits
from nrbench.metrics.registration.coarse_plane import shift_plane
from nrbench.metrics.registration.lattice_net import split_cells
from nrbench.synthesizers.rsgf import Rsgf

integrity = partial(scored, Integrity)


def test_a_fresh_draw_is_whole(own: Case) -> None:
    """Fresh draws have hardly a broken tile, with the model and without, and joined elements would be detected."""
    for model in (True, False):
        found = [integrity(own.observe(own.fresh(k=k), model)).values for k in range(4)]
        assert min(values["score"] for values in found) >= 0.95
        assert max(values["broken_tiles"] for values in found) <= 1
    assert integrity(own.observe(own.fresh())).values["detection_power"] >= 0.7


def test_the_share_of_broken_tiles_grows_with_that_of_two_tone_ones(own: Case) -> None:
    """From 0 to 30 % of two-tone tiles the share grows in order; 3 % are found; at 30 % the mean is below 0.5."""
    sizes = (0.0, 0.03, 0.1, 0.2, 0.3)
    found = [[integrity(own.observe(own.planted("two-tone", size, k)[0])).values for k in range(3)] for size in sizes]
    shares = np.array([[values["broken_share"] for values in row] for row in found])
    scores = np.array([[values["score"] for values in row] for row in found])
    assert spearmanr(np.repeat(sizes, 3), shares.ravel()).statistic >= 0.95
    assert shares[1].min() > shares[0].max()
    assert scores[1].mean() < 0.96 and scores[2].max() < 0.9 and scores[4].mean() < 0.5


@pytest.mark.parametrize("model", [True, False])
def test_copies_of_cells_with_hard_edges_break_the_elements(own: Case, model: bool) -> None:
    """Cells that are copied at random join parts of different elements: the score is at most 0.2."""
    copies = copy_cells(own.task())
    assert integrity(own.observe(quantize(copies), model)).values["score"] <= 0.2


@pytest.mark.parametrize(
    ("kind", "size"), [("color-mean", 0.1), ("over-regular", 0.5), ("stretch", 0.01), ("blur", 1.0), ("warp", 0.1)]
)
def test_other_faults_break_no_element(own: Case, kind: str, size: float) -> None:
    """Tiles that are tinted, alike, stretched, blurred or a little bent stay whole."""
    assert integrity(own.observe(own.planted(kind, size, 2)[0])).values["score"] >= 0.85


def test_a_two_tone_element_is_shown_in_its_place() -> None:
    """A brick whose half has another one's color is the only broken tile, and the picture marks it."""
    own = case("brick")
    image = np.array(own.fresh(k=1))
    place = min(own.lattice.points((192, 192)), key=lambda point: float(np.hypot(*(point - 96))))
    y, x = np.indices((192, 192))
    along, across = np.array(own.lattice.t1) / np.hypot(*own.lattice.t1), np.stack([x, y], -1) - place
    half = (across @ along > 0) & (across @ along < 12) & (np.abs(across @ np.array([-along[1], along[0]])) < 4.5)
    image[half] = image[half][:, [2, 1, 0]]
    before = integrity(own.observe(own.fresh(k=1))).values
    score = integrity(own.observe(quantize(image)))
    more = (score.values["broken_share"] - before["broken_share"]) * score.records["cells"]
    assert 1 <= more <= 4
    marked = np.ptp(score.pictures["broken"], axis=-1) > 0.05
    assert marked[half].mean() > 0.5


@pytest.mark.parametrize("model", [True, False])
def test_a_method_that_cuts_bricks_breaks_them(model: bool) -> None:
    """Blended patches smaller than a brick break bricks, with or without the model."""
    own = case("brick")
    made = quantize(Rsgf(block=20, border=5, seam="blend", subpixel=False).synthesize(own.task()).image)
    values = integrity(own.observe(made, model)).values
    assert values["score"] < 0.9 if model else values["score"] is not None


def test_without_power_the_score_is_none() -> None:
    """If bricks have no tone of their own joined bricks look whole: no score, its reason, and the power."""
    own = Case.of(Brick(color=0.0, intensity=0.0, noise=0.1))
    score = integrity(own.observe(own.fresh()))
    assert score.values["score"] is None and score.values["broken_share"] is None
    assert score.values["detection_power"] < 0.3
    assert score.reasons["score"].startswith("not measured")


def test_few_tiles_are_undecided() -> None:
    """An output with hardly a whole tile has no score."""
    small = integrity(case("brick").observe(case("brick").fresh()[:30, :30]))
    assert small.values["score"] is None and small.reasons["score"].startswith(("undecided", "not"))


def test_elements_are_found_beneath_strong_grain() -> None:
    """Where grain is nearly as strong as the tones of hexagons, fresh draws are whole and 30 % two-tone tiles show."""
    own = Case.of(Hexagon(period=26.0, color=0.07, intensity=0.1, noise=0.05), 2)
    fresh, broken = (integrity(own.observe(image)).values for image in (own.fresh(), own.planted("two-tone", 0.3)[0]))
    assert fresh["score"] > 0.95 and fresh["detection_power"] > 0.3
    assert broken["score"] < 0.75


def test_the_phase_of_the_output_does_not_matter() -> None:
    """Cropping the output elsewhere changes the share only by the tiles at its border."""
    for name in MODELS:
        wide = case(name).planted("two-tone", 0.3, side=230)[0]
        crops = (wide[:192, :192], wide[5:197, 9:201])
        shares = [integrity(case(name).observe(crop)).values["broken_share"] for crop in crops]
        assert shares[0] == pytest.approx(shares[1], abs=0.1)


@pytest.mark.parametrize("model", [True, False])
def test_joined_cans_are_found(model: bool) -> None:
    """Fresh cans are whole, with and without the model, and copied cells with hard edges have at most 0.4."""
    own = Case.of(Cans(color=0.2, noise=0.03), 1, side=192)
    copies = copy_cells(own.task())
    assert min(integrity(own.observe(own.fresh(k=k), model)).values["score"] for k in (0, 1)) >= 0.8
    assert integrity(own.observe(quantize(copies), model)).values["score"] <= 0.4


def test_alike_elements_are_torn_where_their_parts_are_moved() -> None:
    """Alike cans cannot be joined visibly: no peril. Strips of half a can that are moved by s / 7 tear them."""
    own = Case.of(Cans(color=0.02, intensity=0.02, noise=0.02, packing="square"), 1, side=192)
    whole = own.fresh()
    torn = np.where((np.arange(192) // 14 % 2 == 0)[:, np.newaxis, np.newaxis], np.roll(whole, 4, 1), whole)
    fresh, broken = (integrity(own.observe(image, False)) for image in (whole, torn))
    assert fresh.values["score"] is None and fresh.reasons["score"].startswith("not applicable")
    assert broken.values["score"] <= 0.4 and broken.records["test"] == "torn"


def test_pairs_of_tones_are_compared_at_their_places() -> None:
    """The kernels of pairs give the ratio of quadratic forms, and the sums of products, that numpy does."""
    rng, lag, p = np.random.default_rng(0), (2, -3), limits.PLACES
    values, known = rng.normal(0, 5, (3 * p, 4 * p, 3)).astype(np.float32), rng.random((3 * p, 4 * p)) < 0.8
    whole, unrelated = (a @ a.swapaxes(2, 3) for a in rng.random((2, p, p, 3, 3)).astype(np.float32))
    other, both = shift_plane(values, known, lag)
    away = np.where(both[..., np.newaxis], values - other, 0)
    forms = [np.einsum("yxi,yxij,yxj->yx", away, np.tile(m, (3, 4, 1, 1)), away) for m in (whole, unrelated)]
    ratio, pairs = compare_tones(values, known, *lag, whole, unrelated, 5.0)
    np.testing.assert_array_equal(pairs, both)
    np.testing.assert_allclose(ratio, (5 + forms[0]) / (5 + forms[1]), rtol=1e-4)
    sums, count = sum_products(values, known, *lag, p)
    np.testing.assert_array_equal(count, split_cells(both, (p, p)).sum((0, 1)))
    cells = split_cells(away, (p, p))
    expected = np.einsum("klpqi,klpqj->pqij", cells, cells)
    np.testing.assert_allclose(sums[0].reshape(expected.shape), expected, rtol=1e-4, atol=1e-2)
