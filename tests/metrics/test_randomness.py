from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy import ndimage
from scipy.stats import spearmanr

from nrbench.datasets_procedural.brick import Brick
from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.metrics.randomness import Randomness, score_repetition
from nrbench.metrics.residual_tiles import tiles
from nrbench.metrics.residual_tiles.repetition import Share, Twins, count_sources
from nrbench.metrics.residual_tiles.tiles import TileSet
from nrbench.metrics.verdict.verdict import Verdict
from nrbench.plugins.forms import Observation, Task, Texture
from nrbench.synthesizers.supertile import Supertile

from .conftest import MODELS, Case, case, scored


@pytest.fixture(autouse=True, scope="module")
def fresh_tiles() -> Iterator[None]:
    """Cut the fresh draws of each texture and size once, because they do not depend on the output."""
    cut, kept = tiles._cut_fresh, {}

    def cut_once(observation: Observation, verdict: Verdict, grid: tuple[int, int]) -> tuple[TileSet, ...]:
        key = id(verdict.reference), observation.output.shape[:2]
        if key not in kept:
            kept[key] = verdict.reference, cut(observation, verdict, grid)
        return kept[key][1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tiles, "_cut_fresh", cut_once)
        yield


randomness = partial(scored, Randomness)


def one_tile_repeated(case: Case, side: int = 160) -> Image:
    """Repeat the cell around the sample's middle, resampled by splines."""
    lattice, sample = case.lattice, case.texture.image
    y, x = np.indices((side, side))
    at = np.array([64.0, 64.0]) + lattice.wrap(np.stack([x, y], -1) - [64.0, 64.0])
    planes = [ndimage.map_coordinates(sample[..., c], np.moveaxis(at, -1, 0)[::-1], order=5) for c in range(3)]
    return quantize(np.stack(planes, -1))


def copier(case: Case, side: int = 160, seed: int = 0) -> Image:
    """Fill every cell with a random cell of the sample, resampled at the exact place: the best possible copier."""
    lattice, sample = case.lattice, case.texture.image
    lattice = lattice.reduced()
    reach = np.abs(lattice.matrix).sum(0) / 2 + 1
    places = lattice.points(sample.shape[:2])
    places = places[((places >= reach) & (places <= np.array(sample.shape[1::-1]) - 1 - reach)).all(1)]
    y, x = np.indices((side, side))
    xy = np.stack([x, y], -1).astype(float)
    cell = np.floor(lattice.to_cell(xy) + 0.5).astype(int)
    cell_index = cell - cell.reshape(-1, 2).min(0)
    chosen = np.random.default_rng(seed).integers(len(places), size=cell_index.reshape(-1, 2).max(0) + 1)
    at = xy - lattice.from_cell(cell) + places[chosen[cell_index[..., 0], cell_index[..., 1]]]
    planes = [ndimage.map_coordinates(sample[..., c], np.moveaxis(at, -1, 0)[::-1], order=5) for c in range(3)]
    return quantize(np.stack(planes, -1))


@pytest.mark.parametrize("name", MODELS)
def test_a_fresh_draw_varies_like_itself_and_repeats_nothing(name: str) -> None:
    """Fresh draws have a variation of about 1 and a repetition of about 0."""
    values = [randomness(case(name).observe(case(name).fresh(160, k))).values for k in range(3)]
    assert np.mean([one["variation"] for one in values]) == pytest.approx(1, abs=0.12)
    assert np.mean([one["repetition"] for one in values]) == pytest.approx(0, abs=0.15)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("model", [True, False])
def test_one_tile_repeated_hardly_varies_and_repeats_all(name: str, model: bool) -> None:
    """One tile repeated has a variation of about 0, and a repetition of about the number of sources."""
    score = randomness(case(name).observe(one_tile_repeated(case(name)), model))
    assert score.values["variation"] < 0.1
    assert score.values["repetition"] > 0.8 * score.records["sources"]
    assert score.values["score"] < 0.1


@pytest.mark.parametrize("name", MODELS)
def test_the_best_copier_scores_about_one(name: str) -> None:
    """A uniform choice among the sample's tiles has a variation and a repetition of about 1."""
    values = [randomness(case(name).observe(copier(case(name), seed=seed))).values for seed in range(3)]
    assert 0.6 < np.mean([one["variation"] for one in values]) < 1.3
    assert 0.5 < np.mean([one["repetition"] for one in values]) < 2


@pytest.mark.parametrize("name", MODELS)
def test_a_crop_repeated_scores_worse_than_the_best_copier(name: str) -> None:
    """The largest commensurate crop repeated has no more twins than the best copier, but a larger repetition."""
    sample = case(name).texture
    task = Task(sample.image, (192, 192), sample.lattice, np.random.default_rng(0))
    score = randomness(case(name).observe(quantize(Supertile().synthesize(task).image)))
    assert score.records["twins"]["1"] * score.records["sources"] < 1.5
    assert 2 < score.values["repetition"] < score.records["sources"] / 3
    assert score.values["score"] < 0.3


@pytest.mark.parametrize(
    ("kind", "most", "columns"),
    [("over-regular", 0.8, {"variation": -1, "distance": 1}), ("verbatim", 0.5, {"repetition": 1})],
)
def test_each_score_follows_its_own_defect(kind: str, most: float, columns: dict[str, int]) -> None:
    """Over single images of 8 sizes, the rank correlation of a defect with its own scores is at least 0.95."""
    cells = [(size, seed) for size in most * np.arange(1, 9) / 8 for seed in range(2)]
    images = [case("hexagon").planted(kind, float(size), seed, 208)[0] for size, seed in cells]
    rows = [randomness(case("hexagon").observe(image)).values for image in images]
    for column, sign in columns.items():
        found = spearmanr([size for size, _ in cells], [row[column] for row in rows]).statistic
        assert sign * found >= 0.95, (column, found)


def blur(strength: float, case: Case, image: Image) -> Image:
    """Blur an image."""
    return np.asarray(ndimage.gaussian_filter(image, (strength, strength, 0)), np.float32)


def lower_contrast(strength: float, case: Case, image: Image) -> Image:
    """Move all values towards their mean."""
    return np.asarray(image + strength * (image.mean((0, 1)) - image), np.float32)


def replace_texture(strength: float, case: Case, image: Image) -> Image:
    """Mix the fine texture, below a Gaussian of 4 px, with white noise of the same variance."""
    drawn = case.again(image.shape[:2], 0)
    assert drawn is not None and drawn.ideal is not None
    rest = image - drawn.ideal
    fine = rest - ndimage.gaussian_filter(rest, (4, 4, 0))
    noise = np.random.default_rng(0).standard_normal(image.shape) * fine.std((0, 1))
    return np.asarray(image + (np.sqrt(1 - strength) - 1) * fine + np.sqrt(strength) * noise, np.float32)


@pytest.mark.parametrize("change", [blur, lower_contrast, replace_texture])
def test_changes_inside_tiles_are_detected(change: Callable[[float, Case, Image], Image]) -> None:
    """Blur, a loss of contrast and noise in place of the texture move every image beyond all fresh draws, by degrees.

    The strengths end at a blur of 1 px, a contrast of 0.8 and noise alone.
    """
    largest = {blur: 1.0, lower_contrast: 0.2, replace_texture: 1.0}[change]
    for name in ("brick", "weave"):
        images = [case(name).fresh(192, k) for k in range(3)]
        usual = max(randomness(case(name).observe(image)).values["distance"] for image in images)
        image = images[0]
        found = [
            randomness(case(name).observe(quantize(np.clip(change(share * largest, case(name), image), 0, 1)))).values
            for share in (0.25, 0.5, 0.75, 1.0)
        ]
        far = [one["distance"] for one in found]
        assert far == sorted(far)
        assert far[-1] > max(5 * usual, 0.3)
        assert found[-1]["score"] < 0.7


def test_variation_measures_how_far_tiles_depart() -> None:
    """Departures of half the strength have a quarter of the energy."""
    strong, weak = Brick(color=0.4, intensity=0.0, noise=0.0), Brick(color=0.2, intensity=0.0, noise=0.0)
    one = Case.of(strong)
    other = Case(weak, one.texture)
    values = [randomness(one.observe(other.fresh(k=k))).values for k in range(3)]
    assert np.mean([value["variation"] for value in values]) == pytest.approx(0.25, abs=0.05)


@pytest.mark.parametrize(("sources", "tiles"), [(30, 200), (6, 2000)])
def test_the_score_of_repetition(sources: int, tiles: int) -> None:
    """It is 1 without twins, 0 if all are twins or the sample is repeated, and log M / log L for the best copier."""

    def twins(share: float, by_lag: float = 0.0) -> list[Twins]:
        return [Twins(1.0, Share(share, by_lag), Share(0.0, 0.0), sources)]

    assert score_repetition(twins(0.0), tiles) == 1
    assert score_repetition(twins(1.0), tiles) == 0
    assert score_repetition(twins(1 / sources, sources**-0.5), tiles) == pytest.approx(0)
    expected = np.log(sources) / np.log(min(tiles, 5 * sources))
    assert score_repetition(twins(1 / sources), tiles) == pytest.approx(expected)


def test_tiles_laid_in_another_order_vary_as_they_did() -> None:
    """Tiles cut in their joints and laid in random order keep their variation to 1 %."""
    model = Brick(width=28, height=20, joint=3.0, bond="stack", color=0.35, intensity=0.2, noise=0.03)
    own = Case.of(model)
    fresh, drawn = own.fresh(), own.again((192, 192), 0)
    assert drawn is not None and drawn.ideal is not None
    top, left = (int(drawn.ideal.mean(axes)[:period].argmax()) for axes, period in (((1, 2), 20), ((0, 2), 28)))
    rows, columns = (192 - top) // 20, (192 - left) // 28
    inner = (slice(top, top + 20 * rows), slice(left, left + 28 * columns))
    tiles = fresh[inner].reshape(rows, 20, columns, 28, 3).swapaxes(1, 2).reshape(-1, 20, 28, 3)
    order = np.random.default_rng(1).permutation(len(tiles))
    laid = fresh.copy()
    laid[inner] = tiles[order].reshape(rows, columns, 20, 28, 3).swapaxes(1, 2).reshape(20 * rows, -1, 3)
    before, after = (randomness(own.observe(image)).values["variation"] for image in (fresh, laid))
    assert (laid != fresh).mean() > 0.5
    assert after == pytest.approx(before, rel=0.01)


def test_the_phase_of_the_output_does_not_matter() -> None:
    """Cropping the output elsewhere hardly changes the variation."""
    wide = case("hexagon").fresh(230)
    values = [randomness(case("hexagon").observe(wide[y : y + 200, x : x + 200])).values for x, y in ((0, 0), (9, 5))]
    assert values[0]["variation"] == pytest.approx(values[1]["variation"], abs=0.1)


def test_lost_regularity_is_not_scored() -> None:
    """If regularity is lost every column is None, with that reason."""
    image, _ = case("weave").planted("off-lattice", 0.3)
    score = randomness(case("weave").observe(image))
    assert set(score.values.values()) == {None}
    assert all(reason.startswith("not scored: regularity is lost") for reason in score.reasons.values())


def test_threads_longer_than_a_tile_vary_alike_at_all_sizes() -> None:
    """Small and large fresh draws of a weave, whose threads run through the image, have a variation of about 1."""
    for side in (130, 208):
        found = [randomness(case("weave").observe(case("weave").fresh(side, k))).values["variation"] for k in range(6)]
        assert np.mean(found) == pytest.approx(1, abs=0.13)


def test_the_sample_is_measured_at_the_outputs_extent() -> None:
    """Without the model, fresh draws four times as large as the sample vary as the sample does."""
    found = [
        randomness(case("weave").observe(case("weave").fresh(256, k), False)).values["variation"] for k in range(3)
    ]
    assert np.mean(found) == pytest.approx(1, abs=0.3)


def test_noise_does_not_improve_the_distance() -> None:
    """One tile repeated stays far from fresh draws if noise of the missing strength is added."""
    tiled, fresh = one_tile_repeated(case("brick"), 192), randomness(case("brick").observe(case("brick").fresh()))
    strength = fresh.records["deviation"]["reference"]
    grain = np.random.default_rng(0).normal(0, strength, tiled.shape).astype(np.float32)
    noisy = randomness(case("brick").observe(quantize(np.clip(tiled + grain, 0, 1))))
    assert noisy.values["variation"] > 0.6
    assert noisy.values["distance"] > 50 * abs(fresh.values["distance"])
    assert noisy.values["distance"] > 0.4
    assert noisy.values["score"] < 0.3


def test_what_is_copied_is_found_in_the_sample() -> None:
    """Windows of the best copier are copies, those of fresh draws are not, and copies have no distance."""
    values, fresh = (
        randomness(case("hexagon").observe(i)).values for i in (copier(case("hexagon")), case("hexagon").fresh())
    )
    assert values["copied"] > 0.5
    assert abs(fresh["copied"]) < 0.05
    assert values["distance"] < 0.02


def test_damage_survives_or_not() -> None:
    """Survival is about 1 in fresh draws with missing bricks, 0 without any, and None if the sample has none."""
    worn, sound = Brick(color=0.2, missing=0.08), Brick(color=0.2)
    one = Case.of(worn, 5)
    other = Case(sound, one.texture)
    found = [randomness(one.observe(one.fresh(224, k))).values["survival"] for k in range(3)]
    assert np.mean([value for value in found if value is not None]) == pytest.approx(1, abs=0.4)
    assert randomness(one.observe(other.fresh(224))).values["survival"] == pytest.approx(0, abs=0.05)
    clean = Case.of(sound, 5)
    assert "no element of the sample is damaged" in randomness(clean.observe(clean.fresh())).reasons["survival"]


def test_basis_and_origin_do_not_matter() -> None:
    """Another basis of the lattice, and another of its points as origin, hardly change the scores."""
    observation = case("hexagon").observe(case("hexagon").fresh())
    lattice = case("hexagon").lattice
    assert observation.truth is not None
    a, b = lattice.matrix
    t1, t2, start = (tuple(float(x) for x in v) for v in (2 * a + b, a + b, np.array(lattice.origin) + 3 * a - b))
    other = replace(observation, truth=replace(observation.truth, lattice=Lattice(t1, t2, start)))
    values = randomness(other).values
    for column, value in randomness(observation).values.items():
        tolerance = {"distance": 2e-4}.get(column, 0.012)
        assert values[column] == (value if value is None else pytest.approx(value, abs=tolerance)), column


def test_a_texture_that_does_not_vary_is_not_applicable() -> None:
    """Every column of a perfectly regular texture is None, with that reason."""
    model = Brick(color=0.0, intensity=0.0, noise=0.0)
    exact = Case.of(model)
    score = randomness(exact.observe(exact.fresh()))
    assert set(score.values.values()) == {None}
    assert all(reason.startswith("not applicable") for reason in score.reasons.values())


def test_missing_scores_have_reasons() -> None:
    """With hardly a tile the scores are undecided."""
    small = randomness(case("brick").observe(case("brick").fresh()[:30, :30]))
    assert all(reason.startswith("undecided") for reason in small.reasons.values())


def test_sources_count_the_equal_places() -> None:
    """A sample has about as many sources as cells, and at least one."""
    lattice = case("brick").lattice
    sample = case("brick").texture.image
    assert 0.6 < count_sources(sample, lattice) * lattice.area / 128**2 < 1
    assert count_sources(sample[:9, :9], lattice) == 1


def test_a_lattice_of_whole_pixels_is_scored() -> None:
    """Tiles are compared even if the lattice fitted to the output needs another grid than the given one."""
    rng = np.random.default_rng(5)
    motif = rng.random((20, 20, 1)).astype(np.float32)
    sample, output = (np.tile(motif, (9, 9, 1)) * 0.8 + 0.2 * rng.random((180, 180, 1), np.float32) for _ in range(2))
    given = Lattice((20, 0), (0, 20))
    truth = Texture(sample, given, (given,))
    score = Randomness().score(Observation(sample, output, truth=truth, lattice_given=given))
    assert score.values["variation"] == pytest.approx(1, abs=0.1)
