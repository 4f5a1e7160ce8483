"""Claims about resample: which elements it finds, how it draws their colors and details, and when it falls back."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from skimage.color import rgb2lab
from synthesis_cases import noise, synthesize

from nrbench import texture
from nrbench.datasets_procedural.modelling.pattern import Frame
from nrbench.imaging.convert import Image, quantize
from nrbench.imaging.mean_tile import fold, interpolate
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Refused, Synthesis, Synthesizer, Texture
from nrbench.plugins.registry import build
from nrbench.synthesizers.lattice_places.equal_places import CellTorus
from nrbench.synthesizers.resample import Resample, VariationModel
from nrbench.synthesizers.resampling import element_colors
from nrbench.synthesizers.resampling.element_classes import draw_classes, find_object, group_colors, link_classes
from nrbench.synthesizers.resampling.element_colors import ElementColors, draw_field, match_distribution
from nrbench.synthesizers.resampling.element_copies import ElementCopies, _cut_seams
from nrbench.synthesizers.resampling.element_map import ElementMap, InstanceColors, _without_few
from nrbench.synthesizers.resampling.element_outlines import ElementOutlines
from nrbench.synthesizers.resampling.element_threads import find_turns, link_threads
from nrbench.synthesizers.resampling.novelty import NoveltyTest
from nrbench.synthesizers.tile_set import TileSet

SQUARE = Lattice((12.0, 0.0), (0.0, 12.0))


@cache
def drawn(model: str, **parameters: float | str) -> Texture:
    """Return a texture of 128 px, rounded to 8 bits."""
    made = texture(model, (128, 128), 0, **parameters)
    return Texture(quantize(made.image), made.lattice.reduced() if made.lattice else None)


def model_of(made: Texture) -> VariationModel:
    """Return the model of a texture."""
    return VariationModel.of(made.image, made.lattice)


def outputs(made: Texture, shape: tuple[int, int], *methods: Synthesizer) -> list[Synthesis]:
    """Return the outputs of methods, by default of resample, of one seed."""
    return [synthesize(method, made.image, shape, made.lattice) for method in methods or (Resample(),)]


def instances(values: NDArray[np.float64]) -> InstanceColors:
    """Return the colors of the instances of one element, all of which are shown whole."""
    return InstanceColors(values, np.ones(values.shape[:2]))


def mixed(rng: np.random.Generator, shared: float, *shape: int) -> NDArray[np.float64]:
    """Return colors of which each row of instances shares a part of the variance."""
    common, own = rng.standard_normal((*shape[:-1], 1, 3)), rng.standard_normal((*shape, 3))
    return np.sqrt(shared) * common + np.sqrt(1 - shared) * own


def explained(model: VariationModel, made: Texture) -> float:
    """Return the share of the residual's variance that the colors of the elements explain."""
    residual = made.image - model.mean.unfold((128, 128))
    return 1 - float(model.detail.rest.var() / residual.var())


@pytest.mark.parametrize(
    ("name", "more", "count"),
    [("brick", {}, 1), ("hexagon", {}, 1), ("weave", {}, 2), ("brick", {"bond": "flemish"}, 2)],
)
def test_elements_are_found(name: str, more: dict[str, str], count: int) -> None:
    """Bricks, also half bricks, tiles and threads are found: their colors explain 0.85 of what varies."""
    made = drawn(name, color=0.3, noise=0, **more)
    model = model_of(made)
    assert model.detail.elements.count == count and (more or not model.notes)
    assert explained(model, made) > 0.85


def test_threads_are_linked() -> None:
    """Warp and weft of a plain weave run on along the two diagonals of the cell; bricks run nowhere."""
    weave, brick = (model_of(drawn(name, color=0.3)) for name in ("weave", "brick"))
    assert sorted(thread.turn for thread in weave.colors.threads) == [(1, -1), (1, 1)]
    assert [thread.turn for thread in brick.colors.threads] == [(0, 0)]


def test_joints_take_no_color() -> None:
    """The gain is 1 in the middle of bricks, and under a fifth on the mortar."""
    model = model_of(drawn("brick", color=0.3))
    mortar = model.mean.unfold((128, 128)).min(-1) > 0.64
    row, column, _ = model.detail.elements.places((128, 128))
    gain = model.colors.gain.mean(-1)[row, column]
    assert mortar.mean() > 0.05 and np.median(gain[mortar]) < 0.2
    assert np.median(gain[~mortar]) == pytest.approx(1, abs=0.1)


def chain(count: int, length: int, along: float, between: float, seed: int) -> list[InstanceColors]:
    """Return colors of two elements, correlated from row to row by ``along`` and with each other by ``between``."""
    rng = np.random.default_rng(seed)
    values = rng.standard_normal((2, count, length, 3))
    values[1] = between * values[0] + np.sqrt(1 - between**2) * values[1]
    for i in range(1, count):
        values[:, i] = along * values[:, i - 1] + np.sqrt(1 - along**2) * values[:, i]
    return [instances(one) for one in values]


def test_threads_are_linked_across_two_cells() -> None:
    """In a twill a thread comes up again two cells on along one direction, which is farther than the nearest cells."""
    model = model_of(drawn("weave", color=0.3, noise=0, warp=7.7, weft=7.1, gap=1.3, draft="twill"))
    assert all(max(map(abs, thread.turn)) == 2 for thread in model.colors.threads)


def test_few_pairs_have_to_agree_more() -> None:
    """Colors that correlate by 0.6 at all lags are threads if 12 times 12 instances say so, and none if nine do."""
    values = mixed(np.random.default_rng(16), 0.6, 12, 12)
    many, few = (instances(values[:n, :n]) for n in (12, 3))
    assert [thread.turn for thread in link_threads([many], SQUARE)] == [(0, 1)]
    assert [thread.turn for thread in link_threads([few], SQUARE)] == [(0, 0)]


def test_panes_in_a_large_wall_are_found() -> None:
    """A wall that covers most of the cell, but keeps its color, does not make the panes too small to count."""
    model = model_of(drawn("windows", color=0.3, intensity=0.3, noise=0.02, width=29.3, height=28.9, lines=2))
    assert model.detail.elements.count >= 4


def test_elements_that_are_seldom_whole_join_their_neighbors() -> None:
    """An element that a sample shows whole only twice joins the other one, which it shows four times."""
    lattice = Lattice.from_basis(np.array([[12.0, 0], [0, 12.0]]), (-0.5, -0.5))
    label = np.zeros((18, 18), np.int64)
    label[6:, :3] = 1
    elements = ElementMap(lattice, label, np.zeros((18, 18, 2), np.int64))
    label[0] = 0
    assert _without_few(elements, (120, 120)).count == 2
    assert [int((c.shown >= 0.97).sum()) for c in elements.mean_colors(np.zeros((14, 38, 1)))] == [3, 4]
    assert _without_few(elements, (14, 38)).count == 2
    assert [int((c.shown >= 0.97).sum()) for c in elements.mean_colors(np.zeros((24, 22, 1)))] == [2, 4]
    assert _without_few(elements, (24, 22)).count == 1


def test_threads_are_linked_under_detail() -> None:
    """Instances that share 0.8 of their variance at all lags are a thread; independent ones are none."""
    thread = instances(mixed(np.random.default_rng(6), 0.8, 12, 12))
    (alone, _) = chain(12, 12, 0.0, 0.0, seed=7)
    assert [found.turn for found in link_threads([thread, alone], SQUARE)] == [(0, 1), (0, 0)]


def test_the_evidence_of_elements_is_added() -> None:
    """Nine instances that share 0.7 of their variance along a lag are no thread, nine of each of six elements are."""
    colors = [instances(one) for one in mixed(np.random.default_rng(11), 0.7, 6, 3, 3)]
    assert find_turns(colors[:1], SQUARE) == [(0, 0)]
    assert (0, 1) in find_turns(colors, SQUARE) and set(find_turns(colors, SQUARE)) <= {(0, 0), (0, 1)}


def test_independent_colors_and_stains_are_no_threads() -> None:
    """Of 40 walls of independent colors, and of 40 half of whose variance is stains, at most one each has threads."""
    rng = np.random.default_rng(12)
    own = rng.standard_normal((40, 5, 5, 3))
    stains = gaussian_filter(rng.standard_normal((40, 5, 5, 3)), (0, 1, 1, 0), mode="reflect")
    for walls in (own, own + stains / stains.std()):
        turns = [find_turns([instances(one)], SQUARE)[0] for one in walls]
        assert sum(turn != (0, 0) for turn in turns) <= 1


def test_the_drawn_field_has_the_covariance_of_the_sample() -> None:
    """A field drawn from 400 correlated cells has their covariance at all lags, within the error of the estimate."""
    sample = chain(20, 20, 0.6, 0.5, seed=1)
    field = draw_field(sample, CellTorus(64, 64), np.random.default_rng(2))
    drawn_colors = [instances(field[:, :, k]) for k in (0, 1)]
    for a, b, lag, known in ((0, 0, (1, 0), 0.6), (0, 0, (2, 0), 0.36), (0, 1, (0, 0), 0.5), (0, 0, (0, 1), 0.0)):
        r, pairs = drawn_colors[a].correlation(drawn_colors[b], lag)
        assert r == pytest.approx(known, abs=0.12) and pairs > 3000
    assert field.std((0, 1)) == pytest.approx(1, abs=0.1)


def test_chance_correlations_are_dropped() -> None:
    """A field drawn from 25 independent cells is not correlated."""
    field = draw_field(chain(5, 5, 0.0, 0.0, seed=3), CellTorus(40, 40), np.random.default_rng(4))
    one, other = (instances(field[:, :, k]) for k in (0, 1))
    assert max(abs(one.correlation(other, (i, j))[0]) for i in (0, 1) for j in (0, 1)) < 0.1


def test_the_colors_are_distributed_as_the_samples() -> None:
    """Colors of two clusters, one rare, keep mean, covariance and the share of the rare ones; a few are not copied."""
    rng = np.random.default_rng(5)
    sample = rng.normal(0, 0.05, (60, 3))
    sample[:12] += (0.6, 0.1, -0.3)
    made = match_distribution(rng.standard_normal((50, 60, 3)), sample, rng).reshape(-1, 3)
    expected = sample - sample.mean(0)
    np.testing.assert_allclose(made.mean(0), 0, atol=0.03)
    np.testing.assert_allclose(np.cov(made.T), np.cov(expected.T), atol=0.012)
    assert np.mean(made[:, 0] > 0.25) == pytest.approx(0.2, abs=0.04)
    assert np.linalg.norm(made[:, np.newaxis] - expected, axis=-1).min(1).mean() > 0.01


@pytest.mark.parametrize("count", [8, 24, 60])
def test_inks_are_classes(count: int) -> None:
    """Colors of two to four inks and a little noise are those classes."""
    rng = np.random.default_rng(10)
    inks = np.array([(0.1, 0.1, 0.1), (-0.3, 0.2, 0.0), (0.2, -0.2, 0.1), (0.0, 0.3, -0.4)])
    for k in (2, 3, 4):
        true = np.arange(count) % k
        colors = inks[true] + 0.01 * rng.standard_normal((count, 3))
        found = group_colors(instances(colors[np.newaxis]))
        assert found is not None and len({*zip(true.tolist(), found[0].tolist(), strict=True)}) == k == found.max() + 1


def test_a_continuum_is_no_classes() -> None:
    """Normal colors, round, long or gray, uniform, skewed and faint ones are no classes, few or many."""
    assert group_colors(instances(np.random.default_rng(2).normal(0.5, 0.004, (8, 8, 3)))) is None
    rng = np.random.default_rng(11)
    for count in (6, 12, 24, 60):
        for _ in range(10):
            along, noise = 0.1 * rng.standard_normal((count, 1)), 0.004 * rng.standard_normal((count, 3))
            round_colors, uniform = 0.1 * rng.standard_normal((count, 3)), rng.uniform(-0.2, 0.2, (count, 1)) + noise
            for colors in (round_colors, along + noise, along, uniform, 0.1 * np.exp(6 * along) + noise):
                assert group_colors(instances(colors[np.newaxis])) is None


def equal_neighbors(classes: NDArray[np.int64]) -> list[float]:
    """Return the shares of equal neighbors along both vectors of the lattice, and along both diagonals."""
    pairs = ([1, 0], [0, 1], [1, 1], [1, -1])
    return [float((classes == np.roll(classes, lag, (0, 1)))[2:-2, 2:-2].mean()) for lag in pairs]


def plant_unlike(size: int, seed: int) -> NDArray[np.int64]:
    """Return random classes of which no two neighbors along rows and columns are equal."""
    rng, classes = np.random.default_rng(seed), np.full((size + 1, size + 1), -1)
    for i, j in np.ndindex(size, size):
        classes[i, j] = rng.choice(sorted({0, 1, 2} - {int(classes[i - 1, j]), int(classes[i, j - 1])}))
    return classes[:-1, :-1]


def test_classes_keep_their_shares_and_neighbors() -> None:
    """Checks stay checks, unlike neighbors stay unlike, clumps as clumped; independent classes keep their shares."""
    rng = np.random.default_rng(12)
    checks = np.indices((5, 5)).sum(0) % 2
    alone = rng.choice(3, (9, 9), p=(0.6, 0.3, 0.1))
    clumps = (gaussian_filter(rng.standard_normal((12, 12)), 1.0, mode="wrap") > 0).astype(np.int64)
    for planted, tolerance in ((checks, 0.02), (plant_unlike(6, 13), 0.03), (clumps, 0.1)):
        made = draw_classes([planted], CellTorus(40, 40), rng)[..., 0]
        np.testing.assert_allclose(equal_neighbors(made)[:2], equal_neighbors(planted)[:2], atol=tolerance)
    assert not link_classes([alone])
    made = draw_classes([alone], CellTorus(60, 60), rng)
    np.testing.assert_allclose(np.bincount(made.ravel()) / made.size, np.bincount(alone.ravel()) / 81, atol=0.03)


def test_classes_of_several_elements_go_together() -> None:
    """Where the ink of one element decides that of the next cell's other element, it does so in the output."""
    rng = np.random.default_rng(14)
    one = rng.integers(3, size=(8, 8))
    made = draw_classes([one, (np.roll(one, 1, 0) + 1) % 3], CellTorus(40, 40), rng)
    assert (made[..., 1] == (np.roll(made[..., 0], 1, 0) + 1) % 3).mean() > 0.98


def test_elements_whose_classes_decide_each_other_are_one_object() -> None:
    """A heart whose ink follows from that of the petals is a part of the flower; independent ones are not."""
    rng = np.random.default_rng(17)
    one, other = rng.integers(3, size=(2, 5, 5))
    assert find_object({0: one, 3: (one + 1) % 3}) == (0, 3, (0, 0))
    assert find_object({0: one, 3: other}) is None


@pytest.mark.parametrize("name", ["hexagon", "brick"])
def test_a_print_keeps_its_inks(name: str) -> None:
    """Tiles in three inks get no other colors: each is within 3 CIELAB units of one of the sample."""
    made = drawn(name, color=0.3, noise=0.02, inks=3)
    output = outputs(made, (200, 200))[0].image
    tiles, own = (rgb2lab(middles(image, made.lattice, 2)).mean((1, 2)) for image in (output, made.image))
    assert np.linalg.norm(tiles[:, np.newaxis] - own, axis=-1).min(1).max() < 3


@cache
def dotted() -> Texture:
    """Return dots in three inks on a ground of one color."""
    lattice = Lattice.from_basis(np.array([[22.3, 0.0], [11.15, 19.31]]), (3.0, 5.0))
    fine = np.stack(np.meshgrid(np.arange(512), np.arange(512)), -1) / 4 - 0.375
    cell = np.rint(lattice.to_cell(fine)).astype(np.int64)
    inside = np.linalg.norm(lattice.from_cell(cell) - fine, axis=-1) < 7.4
    ink = np.random.default_rng(15).integers(3, size=(40, 40))[cell[..., 0] + 20, cell[..., 1] + 20]
    inks = np.array([(0.8, 0.2, 0.2), (0.2, 0.3, 0.6), (0.9, 0.7, 0.2)])
    picture = np.where(inside[..., np.newaxis], inks[ink], (0.95, 0.92, 0.85)).reshape(128, 4, 128, 4, 3).mean((1, 3))
    return Texture(quantize(picture.astype(np.float32)), lattice.reduced())


def test_dots_are_copied_whole() -> None:
    """Every pixel of new polka dots, and not only their middle, is near one of the sample's at the same place."""
    made = dotted()
    model, output = model_of(made), outputs(made, (128, 128))[0]
    assert model.detail.own is not None and output.note == "elements are whole instances: their colors form classes"
    test = NoveltyTest(made.image, model.detail.elements, model.colors.threads)
    assert test.measure(output.image) < 3


def test_new_elements_that_are_strange_are_not_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dots whose classes are not found get colors between the inks; the model sees it, and copies whole instances."""
    monkeypatch.setattr(element_colors, "group_colors", lambda color: None)
    made = dotted()
    model = VariationModel.fit(made.image, made.lattice)
    assert model.detail.own is not None
    assert model.notes[-1].endswith("stranger than those of the sample are to each other")


def test_fresh_draws_are_as_new_as_the_sample() -> None:
    """Other bricks of a wall are no farther from the sample than its own are; a sample in other colors is."""
    brick = build("datasets", "brick", {"color": 0.3})
    made = brick.render((128, 128), np.random.default_rng(0))
    fresh = brick.again(made, (128, 128), np.random.default_rng(1))
    model = model_of(made)
    test = NoveltyTest(made.image, model.detail.elements, model.colors.threads)
    assert test.passes(fresh.image) and test.compare(fresh.image) < 1.1
    tinted = made.image + np.array([0.3, -0.1, 0], np.float32)
    assert not test.passes(np.clip(tinted, 0, 1))


def middles(image: Image, lattice: Lattice, reach: int) -> NDArray[np.float32]:
    """Return the middle of each whole cell of an image: places up to ``reach`` fifteenths of a vector away."""
    side = np.arange(-7, 8) / 15
    around = np.stack(np.meshgrid(side, side), -1) @ lattice.matrix
    points = lattice.points(image.shape[:2])
    most = np.abs(around).reshape(-1, 2).max(0)
    whole = (points >= most).all(1) & (points <= np.array(image.shape[1::-1]) - 1 - most).all(1)
    part = np.s_[7 - reach : 8 + reach]
    return interpolate(image, points[whole][:, np.newaxis, np.newaxis] + around[part, part])


def test_without_variation_the_output_is_the_mean_tile() -> None:
    """With ``variation=0`` the output is tiled with the mean tile of the model, to the last bit."""
    made = drawn("hexagon", color=0.3, noise=0.05)
    tiled = np.clip(model_of(made).mean.unfold((150, 170)), 0, 1)
    np.testing.assert_array_equal(outputs(made, (150, 170), Resample(variation=0))[0].image, tiled)


def test_variation_is_the_strength_of_departures() -> None:
    """The departures from the mean tile are the sample's in energy, and twice as strong with ``variation=2``."""
    made = drawn("hexagon", color=0.15, noise=0.02)
    tile = fold(made.image, made.lattice)
    own = float(np.square(made.image - tile.unfold((128, 128))).mean())
    for variation in (1.0, 2.0):
        (output,) = outputs(made, (256, 256), Resample(variation=variation))
        energy = float(np.square(output.image - tile.unfold((256, 256))).mean())
        assert energy == pytest.approx(variation**2 * own, rel=0.3)


def nearest_colors(output: Image, made: Texture) -> NDArray[np.float32]:
    """Return the distance between the middle of each brick of an output and the most similar one of the sample."""
    bricks, own = (middles(image, made.lattice, 1).mean((1, 2)) for image in (output, made.image))
    return np.asarray(np.linalg.norm(bricks[:, np.newaxis] - own, axis=-1).min(1))


def test_the_output_copies_no_brick() -> None:
    """The bricks of the output have other colors than those of the sample; the bricks of a tile set have the same."""
    made = drawn("brick", color=0.3, noise=0)
    new, copied = (nearest_colors(output.image, made) for output in outputs(made, (200, 200), Resample(), TileSet()))
    assert np.median(new) > 0.01 and np.quantile(copied, 0.9) < 0.005


def test_a_seed_decides_the_output_and_the_model_is_kept() -> None:
    """Equal seeds give equal bytes, other seeds others; all outputs of a sample share its model."""
    made = drawn("weave", color=0.3)
    one, again, other = (synthesize(Resample(), made.image, (90, 90), made.lattice, s).image for s in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert np.abs(one - other).mean() > 0.01
    assert model_of(made) is model_of(made)


def test_large_outputs_are_composed_of_strips_without_seams() -> None:
    """An output higher than a strip continues the tiling of the mean tile and its colors below."""
    made = drawn("hexagon", color=0.3)
    image = outputs(made, (300, 64))[0].image
    steps = np.square(np.diff(image, axis=0)).mean((1, 2))
    assert steps[255] <= steps[200:300].max() and steps[255] < 3 * np.median(steps)


def test_a_texture_without_elements_keeps_cells_whole() -> None:
    """Where only grain varies, elements are whole cells, and the note says so."""
    made = drawn("hexagon", color=0, intensity=0, noise=0.08)
    (output,) = outputs(made, (128, 128))
    assert "elements are whole cells" in output.note
    assert model_of(made).detail.elements.count == 1


def test_few_cells_are_copied() -> None:
    """With fewer than three whole elements the output is that of the tile set, and the note says so."""
    made = drawn("hexagon", color=0.3)
    few = replace(made, image=made.image[:52, :56])
    output, copied = outputs(few, (100, 100), Resample(), TileSet())
    assert "copied by tile-set: the sample shows" in output.note
    np.testing.assert_array_equal(output.image, copied.image)


def test_a_sample_without_a_lattice_is_refused() -> None:
    """The refusal says that no lattice was found."""
    with pytest.raises(Refused, match="no lattice found"):
        synthesize(Resample(), noise(96, 96), (96, 96), None)


def test_details_are_copied_from_other_cells_than_the_neighbors() -> None:
    """With a dozen whole tiles, no two neighbors are copied from one cell."""
    model = model_of(drawn("hexagon", color=0.3))
    cells = model.detail.draw((256, 256), np.random.default_rng(0))[0]
    for lag in ((1, 0), (0, 1), (1, 1), (1, -1)):
        same = (cells == np.roll(cells, lag, (0, 1))).all(-1)
        assert not same[2:-2, 2:-2].any()


def test_a_sample_whose_elements_stay_in_place_is_copied() -> None:
    """Copies of all instances in their own places are the sample, with copied colors and with its colors laid anew."""
    made = drawn("weave", color=0.3)
    model = model_of(made)
    shape = made.image.shape[:2]
    elements, colors = model.detail.elements, model.colors.of_sample(shape)
    cells = np.stack([elements.cells(shape)] * elements.count)
    laid = model.detail.render(cells, shape, colors=colors)[0] + model.mean.unfold(shape)
    copies = ElementCopies(elements, made.image.astype(float), model.detail.outlines, colors)
    assert not model.notes
    np.testing.assert_allclose(laid, made.image, atol=0.02)
    np.testing.assert_allclose(copies.render(cells, shape, colors=copies.colors_of(cells))[0], made.image, atol=1e-6)


def test_outlines_lie_where_the_elements_are() -> None:
    """On a wall whose bricks are displaced, outlines err half as much as those of the mean tile."""
    model = build("datasets", "brick", {"color": 0.3, "jitter": 0.5, "noise": 0.02})
    made = model.render((160, 160), np.random.default_rng(5))
    frame = Frame(made.lattice.origin, 0.0)
    layers = model.colored_pattern(*frame.grid((160, 160), moved=made.displacement)).layers
    true = np.clip(sum(np.broadcast_to(layer.coverage, (160, 160)) for layer in layers), 0, 1)
    fit = VariationModel.fit(quantize(made.image), made.lattice.reduced())
    row, column, _ = fit.detail.elements.places((160, 160))
    usual = np.clip(fit.colors.gain.mean(-1)[row, column], 0, 1)
    errors = [np.abs(np.clip(found, 0, 1) - true).mean() for found in (fit.detail.outlines.mattes.sum(0), usual)]
    assert errors[0] < 0.5 * errors[1]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("inks", [1, 2])
def test_clean_tiles_without_noise_stay_clean(inks: int) -> None:
    """Flat tiles of one or two colors, on whole pixels and with thin joints, give such tiles, without a warning."""
    y, x = np.indices((120, 120))
    ink = np.random.default_rng(1).integers(inks, size=(5, 5))[y // 24, x // 24]
    image = np.array([(0.7, 0.2, 0.2), (0.2, 0.2, 0.7)])[ink]
    image[(y % 24 == 0) | (x % 24 == 0)] = 0.1
    made = Texture(image.astype(np.float32), Lattice((24.0, 0.0), (0.0, 24.0)))
    output = outputs(made, (160, 160))[0].image
    away = np.linalg.norm(output[12::24, 12::24, np.newaxis] - np.array([(0.7, 0.2, 0.2), (0.2, 0.2, 0.7)]), axis=-1)
    assert away.min(-1).max() < 0.01


def test_seams_lie_where_copies_agree() -> None:
    """Two copies that agree along a winding line, and differ elsewhere, are joined along it."""
    y, x = np.indices((60, 60))
    line = 30 + np.rint(8 * np.sin(y / 7)).astype(int)
    copies = np.stack([np.zeros((60, 60, 1)), (np.abs(x - line) > 2)[..., np.newaxis].astype(float)])
    shares = np.stack([np.where(x < 15, 1, 0.5), np.where(x < 15, 0, 0.5)])
    shares[:, x > 44] = [[1.0], [0.0]]
    owner = np.stack([np.where(x > 44, 2, 1), np.where(x > 44, 1, 2)])
    copies[:, x > 44] = copies[::-1, x > 44]
    weight = _cut_seams(copies, shares, owner)
    first = np.where(owner[0] == 1, weight[0], weight[1])
    assert np.abs(first.sum(1) - line[:, 0] - 0.5).max() <= 3


def two_joints(count: int) -> ElementCopies:
    """Return tiles whose upright joints are dark or bright, each tile between two joints of its own."""
    rng = np.random.default_rng(3)
    bright = rng.integers(2, size=(count, count + 1))
    y, x = np.indices((12 * count, 12 * count))
    sample = np.full((*x.shape, 3), 0.5)
    joint = (x + 2) % 12 < 4
    sample[joint] = bright[y // 12, (x + 2) // 12][joint][:, np.newaxis] * 0.8 + 0.1
    lattice = Lattice.from_basis(np.array([[12.0, 0], [0, 12.0]]), (-0.5, -0.5))
    elements = ElementMap(lattice, np.zeros((18, 18), np.int64), np.zeros((18, 18, 2), np.int64))
    colors = ElementColors.fit(elements, np.zeros(sample.shape, np.float32))
    outlines = ElementOutlines.fit(sample.astype(np.float32), np.full(sample.shape, 0.5, np.float32), colors)
    return ElementCopies(elements, sample, outlines, colors.of_sample(sample.shape[:2]))


def test_neighbors_are_drawn_whose_joints_fit() -> None:
    """Most tiles lie beside one that shows the same joint; by chance half do. All tiles are drawn about as often."""
    copies = two_joints(8)
    cells = copies.draw((400, 400), np.random.default_rng(4))[0]
    bright = copies.rest[6::12, ::12, 0] > 0.5  # the left joint of each tile, and its right joint
    left, right = (np.pad(bright, ((0, 0), (0, 1)), mode="edge")[cells[..., 1], cells[..., 0] + k] for k in (0, 1))
    known = (cells[..., 0] < 7)[:-1]
    assert (right[:-1] == left[1:])[known].mean() > 0.9
    used = np.unique(cells.reshape(-1, 2), axis=0, return_counts=True)[1]
    assert len(used) == len(copies.whole[0]) and used.max() < 3 * used.mean()
