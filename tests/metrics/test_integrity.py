from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy import ndimage
from scipy.stats import spearmanr

from nrbench import metrics, plugins
from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.ceramic import Ceramic
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.datasets_procedural.weave import Weave
from nrbench.imaging.convert import quantize
from nrbench.lattice.geometry import Lattice, Points
from nrbench.metrics.integrity import LEAST_POWER, Integrity, learn_references
from nrbench.metrics.verdict.reference import Reference
from nrbench.metrics.whole_elements.elements import Cutter, find_elements
from nrbench.plugins.forms import Observation, Task, Texture
from nrbench.suites.suite import TextureRow, load_suite
from nrbench.synthesizers.planted import Planted
from nrbench.synthesizers.rsgf import Rsgf

from .conftest import MODELS, Case, case, copy_cells, scored


@pytest.fixture(autouse=True, scope="module")
def learned() -> Iterator[None]:
    """Learn from the references of each texture once, because they do not depend on the output."""
    kept: dict[Any, Any] = {}

    def learn_once(reference: Reference, observation: Observation, noise: Points) -> Any:
        key = id(reference), observation.output.shape
        if key not in kept:
            kept[key] = reference, learn_references(reference, observation, noise)
        return kept[key][1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(metrics.integrity, "learn_references", learn_once)
        yield


integrity = partial(scored, Integrity)


@pytest.mark.parametrize("name", MODELS)
def test_a_fresh_draw_is_whole(name: str) -> None:
    """Fresh draws have no broken tile, and evidence of about 1."""
    values = [integrity(case(name).observe(case(name).fresh(k=k))).values for k in range(3)]
    assert [one["broken_tiles"] for one in values] == [0, 0, 0]
    assert min(one["score"] for one in values) >= 0.95
    assert np.mean([one["evidence_p90"] for one in values]) == pytest.approx(1, abs=0.3)


@pytest.mark.parametrize(
    ("name", "sizes"),
    [("brick", (0.05, 0.2, 0.4, 0.7, 1.0)), ("weave", (0.02, 0.08, 0.2, 0.5)), ("hexagon", (0.05, 0.2, 0.4, 0.7, 1.0))],
)
def test_the_share_of_broken_tiles_grows_with_that_of_two_tone_ones(name: str, sizes: tuple[float, ...]) -> None:
    """Over single images the rank correlation is at least 0.95, up to where threads across tiles are whole again."""
    pairs = [(size, seed) for seed, size in enumerate(sizes)]
    images = [case(name).planted("two-tone", size, seed)[0] for size, seed in pairs]
    shares = [integrity(case(name).observe(image)).values["broken_share"] for image in images]
    assert spearmanr([size for size, _ in pairs], shares).statistic >= 0.95


@pytest.mark.parametrize("row", load_suite("core").texture, ids=lambda row: row.name)
def test_copies_of_cells_with_hard_edges_break_the_elements(row: TextureRow) -> None:
    """Cells that are copied at random join parts of different elements: the score is at most 0.2."""
    own = Case.of(plugins.build("datasets", row.dataset, row.parameters), 3)
    copies = copy_cells(Task(own.texture.image, (192, 192), own.lattice, np.random.default_rng(0)))
    value = integrity(own.observe(quantize(copies))).values["score"]
    assert value is not None
    assert value <= 0.2


@pytest.mark.parametrize(
    ("model", "sides", "kinds"),
    [
        (Brick(width=22.7, height=9.3, joint=1.8, small_every=6, color=0.15, intensity=0.2), (6.5, 20), 7),
        (Brick(color=0.2, noise=0.03, rotation=13.0), (10, 25), 1),
        (Weave(color=0.2, noise=0.03), (11, 47), 2),
    ],
    ids=("long cell", "running bond", "threads"),
)
def test_windows_have_the_extent_of_the_elements(model: Model, sides: tuple[float, float], kinds: int) -> None:
    """Windows are as long and broad as a brick, even if a cell holds seven; those of threads are longer than a cell."""
    draws = [model.render((256, 256), np.random.default_rng(k)) for k in range(3)]
    assert draws[0].lattice is not None
    lattices = [draw.lattice.canonical() for draw in draws if draw.lattice is not None]
    groups = find_elements([Cutter(quantize(one.image), lattice) for one, lattice in zip(draws, lattices, strict=True)])
    elements = [element for group in groups for element in group]
    assert len(elements) == kinds
    assert sorted(np.hypot(*elements[0].box.sides.T)) == pytest.approx(sides, rel=0.2)


@pytest.mark.parametrize("name", ["brick", "hexagon"])
def test_the_sample_alone_tells_whole_from_broken_elements(name: str) -> None:
    """Without a model a fresh draw has a score of at least 0.95, and copies of cells have at most 0.2."""
    own = case(name)
    copies = copy_cells(Task(own.texture.image, (192, 192), own.lattice, np.random.default_rng(0)))
    values = [integrity(own.observe(image, model=False)).values for image in (own.fresh(), quantize(copies))]
    assert None not in (values[0]["score"], values[1]["score"])
    assert values[0]["score"] >= 0.95
    assert values[1]["score"] <= 0.2


def test_windows_of_a_square_lattice_lie_at_the_same_places_in_sample_and_output() -> None:
    """Where two vectors are equally long, a small error of the output's lattice does not move or mirror the windows."""
    model = Ceramic(period=21.3, rotation=37.0, color=0.2, noise=0.03)
    own = Case.of(model, 0, 192)
    values = [integrity(own.observe(own.fresh(192, k), model=False)).values for k in range(3)]
    assert min(one["detection_power"] for one in values) > 0.6
    assert min(one["score"] for one in values) >= 0.95


@pytest.mark.parametrize("blur", [0.0, 2.0])
def test_the_sample_alone_shows_feathered_joints(blur: float) -> None:
    """Copies of cells have a score of at most 0.2 without a model, also if the joints alone are blurred by 2 px."""
    own = case("brick")
    task = Task(own.texture.image, (192, 192), own.lattice, np.random.default_rng(0))
    copies = copy_cells(task)
    assert task.lattice is not None
    y, x = np.indices(task.shape)
    uv = task.lattice.to_cell(np.stack([x, y], -1).astype(float))
    joints = np.abs(uv - np.rint(uv)).min(-1) < 0.15
    copies[joints] = ndimage.gaussian_filter(copies, (blur, blur, 0))[joints]
    score = integrity(own.observe(quantize(copies), model=False)).values["score"]
    assert score is not None and score <= 0.2


def test_few_elements_are_not_judged() -> None:
    """Without a model, an output of two dozen elements needs more power than one of many."""
    model = Hexagon(period=14.3, color=0.03, intensity=0.0, noise=0.06)
    own = Case.of(model, 0, 160)
    large, small = (integrity(own.observe(own.fresh()[:side, :side], model=False)) for side in (192, 90))
    assert large.values["score"] is not None
    assert small.values["score"] is None
    assert small.values["detection_power"] is not None and small.values["detection_power"] > LEAST_POWER
    assert small.reasons["score"].startswith("undecided: only")


def test_one_two_tone_brick_is_found_in_its_place() -> None:
    """A brick whose half has another one's color is the only broken tile."""
    texture, image = case("brick").texture, np.array(case("brick").fresh())
    assert texture.lattice is not None
    place = min(texture.lattice.points((192, 192)), key=lambda point: float(np.hypot(*(point - 96))))
    y, x = np.indices((192, 192))
    along, across = np.array(texture.lattice.t1) / np.hypot(*texture.lattice.t1), np.stack([x, y], -1) - place
    off = np.abs(across @ np.array([-along[1], along[0]]))
    half = (across @ along > 0) & (across @ along < 12) & (off < 4.5)
    image[half] = image[half][:, [2, 1, 0]]
    score = integrity(case("brick").observe(quantize(image)))
    assert score.values["broken_tiles"] == 1
    assert np.hypot(*(np.array(score.records["places"][0]) - place)) < texture.lattice.s


@pytest.mark.parametrize("model", [True, False])
def test_a_method_that_cuts_bricks_breaks_them(model: bool) -> None:
    """Blended patches smaller than a brick break more than a fifth of the bricks, with or without the model."""
    texture = case("brick").texture
    task = Task(texture.image, (192, 192), texture.lattice, np.random.default_rng(0))
    made = quantize(Rsgf(block=20, border=5, seam="blend", subpixel=False).synthesize(task).image)
    score = integrity(case("brick").observe(made, model))
    assert score.values["score"] < 0.8
    assert score.values["broken_share"] > 0.2
    assert score.pictures["broken"].shape == (192, 192, 3)
    assert score.pictures["worst"].ndim == 3


@pytest.mark.parametrize(
    ("kind", "size"),
    [
        ("color-mean", 0.1),
        ("over-regular", 0.5),
        ("blurred-band", 0.15),
        ("blurred-band", 1.0),
        ("seam", 0.1),
        ("warp", 0.1),
        ("stretch", 0.01),
    ],
)
@pytest.mark.parametrize("name", MODELS)
def test_other_defects_break_no_tile(name: str, kind: str, size: float) -> None:
    """At most 2 % of tiles that change alike, are blurred, lit or bent count as broken."""
    score = integrity(case(name).observe(case(name).planted(kind, size)[0]))
    assert score.values["broken_share"] is not None
    assert score.values["broken_share"] <= 0.02


def test_origin_and_basis_of_the_truth_do_not_matter() -> None:
    """Another basis leaves every score; another origin hardly changes them."""
    observation = case("brick").observe(case("brick").planted("two-tone", 0.3)[0])
    assert observation.truth is not None and observation.truth.lattice is not None
    t1, t2, origin = (
        np.array(part)
        for part in (observation.truth.lattice.t1, observation.truth.lattice.t2, observation.truth.lattice.origin)
    )
    own = integrity(observation).values
    sheared = Lattice(tuple(t1 + t2), tuple(t1 + 2 * t2), tuple(origin))
    assert integrity(replace(observation, truth=replace(observation.truth, lattice=sheared))).values == pytest.approx(
        own, abs=1e-6
    )
    shifted = Lattice(tuple(t1), tuple(t2), tuple(origin + 0.37 * t1 + 0.21 * t2))
    again = integrity(replace(observation, truth=replace(observation.truth, lattice=shifted))).values
    assert again["broken_share"] == pytest.approx(own["broken_share"], abs=0.06)


def test_the_phase_of_the_output_does_not_matter() -> None:
    """Cropping the output elsewhere changes the share only by the tiles at its border."""
    wide = case("brick").planted("two-tone", 0.4, side=230)[0]
    values = [integrity(case("brick").observe(wide[y : y + 200, x : x + 200])).values for x, y in ((0, 0), (9, 5))]
    assert values[0]["broken_share"] == pytest.approx(values[1]["broken_share"], abs=0.08)


def test_without_power_the_share_is_undecided() -> None:
    """If bricks have no tone of their own, joined bricks look whole, and the share is undecided."""
    model = Brick(color=0.0, intensity=0.0, noise=0.1)
    plain = Case.of(model)
    score = integrity(plain.observe(plain.fresh()))
    assert score.values["score"] is None
    assert score.values["broken_share"] is None
    assert score.values["detection_power"] is not None and score.values["detection_power"] < 0.1
    assert score.reasons["broken_share"].startswith("undecided: only")


def test_missing_scores_have_reasons() -> None:
    """With few tiles the scores are undecided."""
    small = integrity(case("brick").observe(case("brick").fresh()[:60, :60]))
    assert all(reason.startswith("undecided") for reason in small.reasons.values())


def test_elements_are_found_beneath_strong_grain() -> None:
    """Where grain is twice as strong as the tones of hexagons, fresh draws are whole and 30 % two-tone tiles show."""
    model = Hexagon(period=31.0, color=0.07, intensity=0.1, noise=0.055)
    texture = Case.of(model).texture

    def again(shape: tuple[int, int], k: int) -> Texture:
        return model.again(texture, shape, np.random.default_rng((k, 7)))

    task = Task(texture.image, (256, 256), texture.lattice, np.random.default_rng(1), again=again)
    images = again((256, 256), 0).image, Planted("two-tone", 0.3).synthesize(task).image
    fresh, broken = (
        integrity(Observation(texture.image, quantize(image), texture, again=again)).values for image in images
    )
    assert fresh["score"] > 0.95
    assert fresh["detection_power"] > 0.5
    assert broken["score"] == pytest.approx(0.7, abs=0.12)
