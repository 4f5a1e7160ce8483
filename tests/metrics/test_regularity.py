from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice
from nrbench.metrics.regularity import Regularity
from nrbench.plugins.forms import Observation, Score, Texture

from .conftest import MODELS, Case

Cases = Callable[[str], Case]


def regularity(observation: Observation) -> Score:
    """Return the score, and check that every None has its reason."""
    score = Regularity().score(observation)
    assert set(score.values) == set(Regularity.columns)
    assert all(score.reasons.get(column) for column, value in score.values.items() if value is None)
    return score


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("model", [True, False])
def test_a_fresh_draw_is_preserved(case: Cases, name: str, model: bool) -> None:
    """A fresh draw is preserved with all tiles in place, with the model and with the lattice only."""
    values = regularity(case(name).observe(case(name).fresh(), model)).values
    assert values["preserved"] is True
    assert values["score"] == 1
    assert values["bad_tiles"] == 0
    assert values["misplacement_p95"] < 0.04
    assert values["structure"] == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("kind", ["phase-step", "off-lattice", "displaced-tile", "missing-tile"])
def test_planted_defects_are_lost(case: Cases, name: str, kind: str) -> None:
    """With each planted defect of 0.3 s, or an opaque cover of a tile, regularity is lost and the score is lower."""
    image, _ = case(name).planted(kind, 1.0 if kind == "missing-tile" else 0.3)
    score = regularity(case(name).observe(image))
    assert score.values["preserved"] is False
    assert score.values["score"] < 1
    assert score.records["faults"]


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize(("size", "model"), [(0.1, True), (0.2, True), (0.2, False), (0.35, True), (0.35, False)])
def test_a_phase_step_is_measured_in_px(case: Cases, name: str, size: float, model: bool) -> None:
    """Half of the windows have the planted displacement, to half a pixel, and the others none."""
    image, field = case(name).planted("phase-step", size)
    windows = case(name).verdict(image, model).output.windows  # type: ignore[union-attr]
    planted = np.hypot(*np.moveaxis(field, -1, 0)).max()
    assert np.quantile(windows.misplacement, 0.9) * windows.lattice.s == pytest.approx(planted, abs=0.5)
    assert np.quantile(windows.misplacement, 0.3) < 0.03


@pytest.mark.parametrize("kind", ["phase-step", "off-lattice"])
def test_the_response_grows_with_the_defect(case: Cases, kind: str) -> None:
    """The misplacement grows with the size of a defect, and the score falls if the tolerance is exceeded."""
    sizes = (0.0, 0.06, 0.12, 0.2, 0.3)
    values = [regularity(case("brick").observe(case("brick").planted(kind, size)[0])).values for size in sizes]
    for column in ("misplacement_p95", "worst_neighborhood"):
        assert np.all(np.diff([values[column] for values in values]) > 0), column
    scores = [values["score"] for values in values]
    assert scores[0] == 1
    assert max(scores[2:]) < 0.6


def test_one_displaced_tile_is_found_where_it_is(case: Cases) -> None:
    """One displaced tile is one bad tile, and the picture marks only pixels within a tile of its place."""
    image, field = case("hexagon").planted("displaced-tile", 0.35, seed=3)
    score = regularity(case("hexagon").observe(image))
    assert score.values["bad_tiles"] == 1
    y, x = np.nonzero(field.any(-1))
    center, s = np.array([x.mean(), y.mean()]), case("hexagon").texture.lattice.s  # type: ignore[union-attr]
    assert np.hypot(*(np.array(score.records["bad_places"][0]) - center)) < 0.6 * s
    marked = np.ptp(score.pictures["defects"], axis=-1) > 0.05
    y, x = np.nonzero(marked)
    assert len(x)
    assert np.hypot(x - center[0], y - center[1]).max() < 1.6 * s


def test_content_cut_off_its_phase_is_fine(case: Cases) -> None:
    """The phase of the output is free: an output of another phase has the same scores."""
    wide = case("brick").fresh(220)
    values = [
        regularity(case("brick").observe(wide[y : y + 192, x : x + 192])).values for x, y in ((0, 0), (7, 11), (20, 3))
    ]
    for one in values:
        assert one["preserved"] is True
        assert one["misplacement_median"] == pytest.approx(values[0]["misplacement_median"], abs=0.003)


def test_basis_and_origin_do_not_matter(case: Cases) -> None:
    """Another basis of the same lattice, and another of its points as origin, do not change the scores."""
    image, _ = case("weave").planted("phase-step", 0.2)
    plain = case("weave").observe(image)
    lattice = plain.truth.lattice  # type: ignore[union-attr]
    (a, b), (c, d) = lattice.t1, lattice.t2
    other = Lattice((a + 2 * c, b + 2 * d), (a + c, b + d), (lattice.origin[0] + 3 * a, lattice.origin[1] + 3 * b))
    truth = replace(plain.truth, lattice=other)  # type: ignore[type-var]
    before, after = regularity(plain).values, regularity(replace(plain, truth=truth)).values
    for column in ("score", "misplacement_p95", "worst_neighborhood", "structure"):
        assert after[column] == pytest.approx(before[column], abs=0.01), column


def test_scattered_patches_are_lost(case: Cases) -> None:
    """With patches from random places few tiles are in place, and the structure is low."""
    draw, rng = case("brick").fresh(300), np.random.default_rng(1)
    output = np.zeros((192, 192, 3), np.float32)
    for y in range(0, 192, 24):
        for x in range(0, 192, 24):
            at = rng.integers(0, 270, 2)
            output[y : y + 24, x : x + 24] = draw[at[0] : at[0] + 24, at[1] : at[1] + 24]
    values = regularity(case("brick").observe(output)).values
    assert values["preserved"] is False
    assert values["score"] < 0.3
    assert values["structure"] < 0.8


@pytest.mark.parametrize("output", ["constant", "noise"])
def test_an_output_without_the_texture_is_lost(case: Cases, output: str) -> None:
    """A flat image and white noise have no lattice."""
    image = np.full((192, 192, 3), 0.5, np.float32)
    if output == "noise":
        image = np.random.default_rng(0).random((192, 192, 3), np.float32)
    values = regularity(case("hexagon").observe(image)).values
    assert values["preserved"] is False
    assert values["score"] < 0.3


def test_drift_of_a_photograph_is_reported_and_left_out(case: Cases) -> None:
    """With the lattice only, a stretch of 1 % is drift and no misplacement; with the model it is a fault."""
    from scipy import ndimage

    wide = case("brick").fresh(240)
    at = np.indices((192, 192)) / 1.01
    stretched = np.stack([ndimage.map_coordinates(wide[..., c], at, order=3) for c in range(3)], -1)
    image: Image = np.clip(stretched, 0, 1).astype(np.float32)
    free, held = (regularity(case("brick").observe(image, model)).values for model in (False, True))
    assert free["drift"] == pytest.approx(1, abs=0.15)
    assert free["preserved"] is True
    assert free["misplacement_p95"] < 0.05
    assert held["misplacement_p95"] > 2 * free["misplacement_p95"]


def test_the_drift_of_a_photograph_is_allowed_once(case: Cases) -> None:
    """The uncertainty of 2 % includes the fit of the lattice to the sample; the output has only the rest."""
    from scipy import ndimage

    from nrbench.lattice.geometry import Lattice

    one, true = case("brick"), case("brick").texture.lattice
    assert true is not None
    given = Lattice(*((x / 1.015, y / 1.015) for x, y in (true.t1, true.t2)), true.origin)
    at = np.indices((192, 192)) / 1.015
    wide = one.fresh(240)
    stretched = np.stack([ndimage.map_coordinates(wide[..., c], at, order=3) for c in range(3)], -1)
    image: Image = np.clip(stretched, 0, 1).astype(np.float32)
    truth = Texture(one.texture.image, given)
    fresh = regularity(Observation(one.texture.image, one.fresh(), truth)).values
    beyond = regularity(Observation(one.texture.image, image, truth)).values
    assert fresh["preserved"] is True
    assert beyond["drift"] == pytest.approx(1.5, abs=0.3)
    assert beyond["misplacement_p95"] > 3 * fresh["misplacement_p95"]


def test_the_outputs_own_lattice_is_compared(case: Cases) -> None:
    """The own lattice of a fresh draw is the true one to a tenth of a pixel; that of a stretched one is stretched."""
    values = regularity(case("hexagon").observe(case("hexagon").fresh(256))).values
    assert values["lattice_exact"] is True
    assert values["lattice_vector_error"] < 0.1
    assert values["lattice_area_ratio"] == pytest.approx(1, abs=0.01)
    image, _ = case("hexagon").planted("stretch", 0.04, side=256)
    assert regularity(case("hexagon").observe(image)).values["lattice_area_ratio"] == pytest.approx(1.04, abs=0.01)


def test_too_much_regularity_is_no_lost_lattice(case: Cases) -> None:
    """One tile repeated keeps the lattice. Patches off the lattice widen the range of the windows' correlations."""
    image, _ = case("hexagon").planted("over-regular", 1.0, side=256)
    values = regularity(case("hexagon").observe(image)).values
    assert values["preserved"] is True and values["score"] == 1
    torn, _ = case("hexagon").planted("off-lattice", 0.3, side=256)
    assert regularity(case("hexagon").observe(torn)).values["structure_spread"] > 2


def test_blur_is_no_lost_lattice(case: Cases) -> None:
    """A blurred fresh draw keeps its lattice, because all tiles have the same low contrast."""
    from scipy import ndimage

    blurred = ndimage.gaussian_filter(case("hexagon").fresh(256), (1.5, 1.5, 0))
    values = regularity(case("hexagon").observe(blurred)).values
    assert values["preserved"] is True and values["score"] == 1


def test_no_lattice_is_not_applicable(case: Cases) -> None:
    """Without a lattice in the truth every column is None, with that reason."""
    observation = replace(case("brick").observe(case("brick").fresh()), truth=Texture(case("brick").texture.image))
    score = regularity(observation)
    assert set(score.values.values()) == {None}
    assert set(score.reasons.values()) == {"not applicable: no lattice in the truth"}


@pytest.mark.parametrize("side", [8, 24, 60])
def test_a_small_output_is_undecided(case: Cases, side: int) -> None:
    """An output of few windows is undecided, never preserved."""
    score = regularity(case("brick").observe(case("brick").fresh()[:side, :side]))
    assert score.values["preserved"] is None
    assert score.reasons["preserved"].startswith("undecided: ")


def test_a_texture_of_little_regularity_is_undecided() -> None:
    """If departures hide the lattice, a fresh draw is undecided, not preserved."""
    from nrbench.datasets_procedural.weave import Weave

    model = Weave(color=1.0, intensity=1.0, noise=0.3)
    faint = Case(model, model.render((128, 128), np.random.default_rng(0)))
    assert model.regular_share < 0.1
    score = regularity(faint.observe(faint.fresh()))
    assert score.values["preserved"] is None and "undecided" in score.reasons["preserved"]


def test_gray_pictures_are_scored(case: Cases) -> None:
    """Gray images are scored."""
    one = case("brick")
    sample, output = one.texture.image[..., :1], one.fresh()[..., :1]
    truth = Texture(sample, one.texture.lattice)
    assert regularity(Observation(sample, output, truth)).values["preserved"] is True


def test_equal_observations_give_equal_scores(case: Cases) -> None:
    """Equal observations have equal scores."""
    image, _ = case("weave").planted("off-lattice", 0.2)
    first = regularity(case("weave").observe(image)).values
    case("brick").verdict(case("brick").fresh())
    assert regularity(case("weave").observe(image.copy())).values == first
