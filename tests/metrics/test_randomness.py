"""Randomness: variation, repetition, arrangement and distribution of the tiles."""

from functools import partial

import numpy as np
import pytest
from cases import Case, case, scored
from numpy.typing import NDArray
from scipy import ndimage

from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.metrics.judgment.examination import examine
from nrbench.metrics.judgment.tile_population import gather_tiles
from nrbench.metrics.quality import Quality
from nrbench.metrics.randomness import Randomness
from nrbench.plugins.forms import Observation, Texture
from nrbench.synthesizers.supertile import Supertile
from nrbench.synthesizers.tiling import Tiling

randomness = partial(scored, Randomness)


def copy_exactly(case: Case, side: int = 192, seed: int = 0) -> Image:
    """Fill every cell with a random cell of the sample, resampled at the exact place: the best possible copier."""
    lattice, sample = case.lattice.reduced(), case.texture.image
    reach = np.abs(lattice.matrix).sum(0) / 2 + 1
    places = lattice.points(sample.shape[:2])
    places = places[((places >= reach) & (places <= np.array(sample.shape[1::-1]) - 1 - reach)).all(1)]
    y, x = np.indices((side, side))
    xy = np.stack([x, y], -1).astype(float)
    cell = np.floor(lattice.to_cell(xy) + 0.5).astype(int)
    number = cell - cell.reshape(-1, 2).min(0)
    chosen = np.random.default_rng(seed).integers(len(places), size=number.reshape(-1, 2).max(0) + 1)
    at = xy - lattice.from_cell(cell) + places[chosen[number[..., 0], number[..., 1]]]
    planes = [ndimage.map_coordinates(sample[..., c], np.moveaxis(at, -1, 0)[::-1], order=5) for c in range(3)]
    return quantize(np.stack(planes, -1))


def test_a_fresh_draw_varies_like_the_texture(own: Case) -> None:
    """Fresh draws have a variation of about 1, no repetition, and no distance beyond chance."""
    found = [randomness(own.observe(own.fresh(k=k))).values for k in range(6)]
    assert np.mean([values["variation"] for values in found]) == pytest.approx(1, abs=0.15)
    assert max(abs(values["repetition"]) for values in found) < 0.3
    assert max(values["returning"] for values in found) < 0.005
    assert max(values["arrangement"] for values in found) < 0.1
    assert max(values["copied"] for values in found) < 0.2
    assert min(values["score"] for values in found) >= 0.9


@pytest.mark.parametrize("model", [True, False])
def test_one_tile_repeated_has_no_randomness(own: Case, model: bool) -> None:
    """Wallpaper is 0 where the sample varies: it does not vary, and all its windows are twins."""
    score = randomness(own.observe(quantize(Tiling().synthesize(own.task()).image), model))
    assert score.values["score"] == 0
    assert score.values["variation"] < 0.15
    assert score.values["repetition"] > 0.8 * score.records["sources"]


def test_wallpaper_is_seen_beside_a_sample_of_few_tiles() -> None:
    """Where the sample shows fewer than four whole tiles, one tile repeated, as JPEG, has 0; a draw has no score."""
    own = Case.of(Hexagon(color=0.3, period=32.0, noise=0.1))
    output = own.edited("JPEG 4:2:0, quality", 85, image=quantize(Tiling().synthesize(own.task(128)).image))
    wallpaper = randomness(own.observe(output, False)).values
    fresh = randomness(own.observe(own.fresh(128), False))
    assert wallpaper["score"] == 0 < wallpaper["repetition"] and wallpaper["variation"] is None
    assert fresh.values["score"] is None and "fewer than 4 whole tiles" in fresh.reasons["score"]


def test_arrangement_is_unknown_where_no_lag_has_pairs() -> None:
    """Beside draws whose bent tiles are whole here and there only, the arrangement is None, with its reason."""
    own = Case.of(Hexagon(bend=1.0), seed=1, side=80)
    found = randomness(own.observe(own.fresh()))
    assert found.values["arrangement"] is None and "pairs of tiles" in found.reasons["arrangement"]
    assert found.values["score"] is not None


def test_a_crop_repeated_is_worse_than_the_best_copier(own: Case) -> None:
    """A random choice of cells has a repetition of about 1; a crop of as many cells returns at its period."""
    crop = randomness(own.observe(quantize(Supertile().synthesize(own.task(256)).image))).values
    best = [randomness(own.observe(copy_exactly(own, 256, seed))).values for seed in range(2)]
    assert np.mean([values["repetition"] for values in best]) == pytest.approx(1, abs=0.5)
    assert min(values["copied"] for values in best) > 0.5
    assert max(values["returning"] for values in best) < 0.005 < crop["returning"]
    assert crop["score"] < 0.3 < min(values["score"] for values in best)


def test_equal_tiles_lower_the_score_by_degrees(own: Case) -> None:
    """The more of one tile is mixed into a draw, the less it varies, and the lower is the score."""
    found = [randomness(own.observe(own.planted("over-regular", size)[0])).values for size in (0.0, 0.3, 0.6, 1.0)]
    assert np.all(np.diff([values["variation"] for values in found]) < 0)
    scores = [values["score"] for values in found]
    assert scores[0] > 0.9 and scores[2] < 0.6 and scores[3] == 0
    assert scores == sorted(scores, reverse=True)


def lay_tiles(order: str) -> tuple[Case, Image, Image]:
    """Return a wall of stacked bricks, and the same wall with its bricks laid in another order."""
    own = Case.of(Brick(width=20, height=14, joint=2.0, bond="stack", color=0.0, intensity=0.3, noise=0.03), 0)
    drawn = own.again((256, 256), 0)
    top, left = (int(drawn.ideal.mean(axes)[:period].argmax()) for axes, period in (((1, 2), 14), ((0, 2), 20)))
    rows, columns = (256 - top) // 14, (256 - left) // 20
    inner = (slice(top, top + 14 * rows), slice(left, left + 20 * columns))
    tiles = drawn.image[inner].reshape(rows, 14, columns, 20, 3).swapaxes(1, 2).reshape(-1, 14, 20, 3)
    light = tiles.mean((1, 2, 3)).argsort()
    y, x = np.indices((rows, columns)).reshape(2, -1)
    rank: NDArray[np.float64] = {
        "random": np.random.default_rng(1).random(len(tiles)),
        "rows": 100.0 * y + x,
        "checkerboard": 100.0 * ((x + y) % 2) + np.random.default_rng(1).random(len(tiles)),
        "blob": np.hypot(x - columns / 2, y - rows / 2),
    }[order]
    laid = np.empty_like(tiles)
    laid[rank.argsort()] = tiles[light]
    image = drawn.image.copy()
    image[inner] = laid.reshape(rows, columns, 14, 20, 3).swapaxes(1, 2).reshape(14 * rows, -1, 3)
    return own, drawn.image, image


def test_tiles_in_random_order_are_random() -> None:
    """Tiles cut in their joints and laid in random order keep variation and score."""
    own, fresh, laid = lay_tiles("random")
    before, after = (randomness(own.observe(image)).values for image in (fresh, laid))
    assert (laid != fresh).mean() > 0.5
    assert after["variation"] == pytest.approx(before["variation"], rel=0.02)
    assert after["score"] >= 0.9


@pytest.mark.parametrize("order", ["rows", "checkerboard", "blob"])
def test_sorted_tiles_are_not(order: str) -> None:
    """The same tiles sorted by their light into rows, a checkerboard or a blob have a quality of at most 0.6."""
    own, _, laid = lay_tiles(order)
    values = randomness(own.observe(laid)).values
    assert values["arrangement"] > 0.3
    assert scored(Quality, own.observe(laid)).values["score"] <= 0.6


def test_variation_measures_how_far_tiles_depart() -> None:
    """Departures of half the strength have about a quarter of the energy."""
    strong, weak = Brick(color=0.4, intensity=0.0, noise=0.0), Brick(color=0.2, intensity=0.0, noise=0.0)
    own = Case.of(strong)
    other = Case(weak, own.texture)
    values = [randomness(own.observe(other.fresh(k=k))).values["variation"] for k in range(3)]
    assert np.mean(values) == pytest.approx(0.25, abs=0.1)


def test_a_sample_excuses_what_it_shows() -> None:
    """Beside the model, a copy of an odd sample is measured to the sample, too; what neither shows is not excused."""
    own = Case.of(Hexagon(color=0.4, noise=0.02, period=21.3), 5)
    population = gather_tiles(examine(own.observe(own.fresh())).reference)
    tiles = population.features
    light = tiles[tiles.mean(1) > np.quantile(tiles.mean(1), 0.8)]
    odd, copy, other = 3 * light[::2], 3 * light[1::2], 9 * tiles
    assert population.measure_distance(copy, odd) < 0.3 * population.measure_distance(copy)
    assert population.rate_variation(copy, odd) > population.rate_variation(copy)
    assert population.measure_distance(tiles, odd) == pytest.approx(population.measure_distance(tiles), abs=0.01)
    assert population.measure_distance(other, odd) > population.distance_limit


def test_noise_does_not_make_wallpaper_random(own: Case) -> None:
    """One tile repeated stays below 0.4 if grain is added."""
    paper = Tiling().synthesize(own.task()).image
    noisy = paper + np.random.default_rng(0).normal(0, 0.05, paper.shape).astype(np.float32)
    values = randomness(own.observe(quantize(np.clip(noisy, 0, 1).astype(np.float32)))).values
    assert values["score"] < 0.4


def test_a_texture_that_does_not_vary_needs_no_variety() -> None:
    """Of a perfectly regular texture one tile repeated has full randomness, and the other columns have a reason."""
    own = Case.of(Brick(color=0.0, intensity=0.0, noise=0.0))
    score = randomness(own.observe(own.fresh()))
    assert score.values["score"] == pytest.approx(1, abs=0.02)
    assert score.values["repetition"] is None and "does not visibly vary" in score.reasons["repetition"]


def test_missing_scores_have_reasons() -> None:
    """With hardly a tile, and where half of the tiles are out of place, every column is None with a reason."""
    small = randomness(case("brick").observe(case("brick").fresh()[:34, :34]))
    lost = randomness(case("weave").observe(case("weave").planted("off-lattice", 0.3)[0]))
    assert set(small.values.values()) == set(lost.values.values()) == {None}
    assert all(reason.startswith("undecided") for reason in small.reasons.values())
    assert all(reason.startswith("not scored: half of the tiles") for reason in lost.reasons.values())


def test_a_lattice_of_whole_pixels_is_scored() -> None:
    """Gray noise on a motif of 20 px varies as much in the output as in the sample."""
    rng = np.random.default_rng(5)
    motif = rng.random((20, 20, 1)).astype(np.float32)
    sample, output = (np.tile(motif, (9, 9, 1)) * 0.8 + 0.2 * rng.random((180, 180, 1), np.float32) for _ in range(2))
    given = Lattice((20, 0), (0, 20))
    values = randomness(Observation(sample, output, truth=Texture(sample, given))).values
    assert values["variation"] == pytest.approx(1, abs=0.1) and values["score"] > 0.9
