"""Claims about regularized patches: the shape, the borders and the choice of texels, and the output."""

import tracemalloc
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from bent_pictures import bent
from hypothesis import given
from hypothesis import strategies as st
from synthesis_cases import noise, synthesize

import nrbench
from nrbench.calling.bent_samples import synthesize_in_geometry
from nrbench.calling.method_calls import check_source
from nrbench.imaging.convert import quantize
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Geometry, Observation, Refused, Synthesis, Task, Texture
from nrbench.synthesizers.regularized_patch import (
    NEIGHBORS,
    RegularizedPatch,
    TexelMosaic,
    TexelReader,
    TexelShape,
    TexelStock,
    growth_order,
    parallelogram,
    quiet_texels,
)
from nrbench.synthesizers.sample_reading.patches import Patches


def run_method(method: RegularizedPatch, texture: Texture, shape: tuple[int, int]) -> Synthesis:
    """Run a method as a cell does."""
    return synthesize_in_geometry(method, Task(texture.image, shape, texture.lattice, np.random.default_rng(1)))


def deformation(texture: Texture, made: Synthesis) -> Mapping[str, float]:
    """Return the values of the metric."""
    observation = Observation(texture.image, quantize(made.image), texture)
    return nrbench.plugins.build("metrics", "deformation").score(observation).values


@pytest.mark.parametrize("bend", [0.0, 0.5])
def test_the_map_points_at_what_is_shown(bend: float) -> None:
    """The source map passes the check of a run; straight pixels inside texels are copies or nearly so."""
    texture = bent(bend=bend)
    made = run_method(RegularizedPatch(), texture, (150, 170))
    assert made.source is not None and made.lattice is not None
    check_source(made.source, quantize(made.image), texture.image)
    x, y = made.source[..., :2].astype(int).reshape(-1, 2).T
    shown = texture.image[y, x].reshape(made.image.shape)
    assert np.abs(shown - made.image).mean() < 0.05


def test_the_papers_texels_lie_around_the_origin() -> None:
    """With the preset of the paper the cell around each lattice point is one texel: its middle has one color."""
    y, x = np.indices((96, 96))
    cells = (y + 7) // 14 * 10 + (x + 9) // 18
    sample = quantize(np.random.default_rng(0).random((cells.max() + 1, 3))[cells].astype("f4"))
    paper = RegularizedPatch(**RegularizedPatch.presets["paper"])
    made = synthesize(paper, sample, (80, 80), Lattice((18, 0), (0, 14), (18.0, 14.0)))
    for left, top in made.lattice.points((72, 70)).astype(int).tolist():
        middle = made.image[max(top - 4, 0) : top + 5, max(left - 6, 0) : left + 7]
        assert np.ptp(middle, axis=(0, 1)).max() < 0.01


def test_the_papers_warp_runs_once() -> None:
    """The preset of the paper bends the output by one pass, whose field is not that of four passes."""
    texture = bent()
    paper = RegularizedPatch(**RegularizedPatch.presets["paper"])
    once, four = (run_method(method, texture, (64, 64)) for method in (paper, replace(paper, geometry="bent")))
    assert (once.extras["straightened"] == four.extras["straightened"]).all()
    assert (once.image != four.image).any()


def test_deformations_are_synthesized_or_left_out() -> None:
    """The amplitude is that of the sample by default, a third or less by argmax, and nearly 0 without."""
    texture, ratios = bent("weave"), {}
    ways: list[Geometry] = ["bent", "argmax", "straight"]
    for way in ways:
        made = run_method(RegularizedPatch(geometry=way), texture, (256, 256))
        ratios[way] = deformation(texture, made)["amplitude_ratio"]
    assert ratios["bent"] == pytest.approx(1, abs=0.25)
    assert ratios["argmax"] < 0.35 and ratios["straight"] < 0.1


def test_the_field_of_a_large_output_folds_nowhere() -> None:
    """Bricks of bend 0.5: the topology is intact, amplitude and correlation length are within 25 % of the sample's."""
    texture = bent(seed=1)
    values = deformation(texture, run_method(RegularizedPatch(), texture, (256, 256)))
    assert values["folded"] == 0
    assert values["amplitude_ratio"] == pytest.approx(1, abs=0.25)
    assert values["length_ratio"] == pytest.approx(1, abs=0.25)


def test_tolerance_trades_fit_for_variety() -> None:
    """With a large d_max texels are drawn freely, so that fewer neighbors in the output are neighbors in the sample."""
    texture = bent("hexagon", 0.0, color=0.5)
    joints = []
    for tolerance in (0.0, 1.0):
        made = synthesize(RegularizedPatch(tolerance=tolerance, zone=2.0), texture.image, (160, 160), texture.lattice)
        joints.append((np.abs(np.diff(made.source[..., :2], axis=1)).max(-1) > 2).mean())
    assert joints[0] < 0.9 * joints[1]


def test_samples_without_texels_are_refused() -> None:
    """No lattice, less than two periods, and less than two whole texels are refused, saying what is missing."""
    with pytest.raises(Refused, match="no lattice"):
        synthesize(RegularizedPatch(), noise(64, 64), (64, 64))
    with pytest.raises(Refused, match="two periods"):
        synthesize(RegularizedPatch(), noise(64, 64), (64, 64), Lattice((40, 0), (0, 40)))
    with pytest.raises(Refused, match="does not hold two"):
        synthesize(RegularizedPatch(texel="given", zone=20), noise(64, 64), (64, 64), Lattice((30, 0), (0, 30)))


OBLIQUE = Lattice((21.4, 2.6), (-6.3, 17.8), (3.0, 4.0))
BRICKS = Lattice((27.0, 0.0), (13.5, 12.0))
BRICK = np.array([(13.5, 6.0), (0.0, 6.0), (-13.5, 6.0), (-13.5, -6.0), (0.0, -6.0), (13.5, -6.0)])


@pytest.mark.parametrize("zone", [0.0, 3.0, 7.0])
@pytest.mark.parametrize("texel", [parallelogram(OBLIQUE), (BRICKS, BRICK)], ids=["parallelogram", "brick"])
def test_weights_add_up_to_one_and_a_texel_covers_its_area(texel, zone: float) -> None:
    """At any point the weights of all texels sum to 1, and over the plane each texel weighs as much as a cell."""
    shape = TexelShape.of(*texel, zone)
    side = np.arange(120.0)
    points = np.stack(np.meshgrid(side, side), -1).reshape(-1, 2) + 0.013
    total, own = np.zeros(len(points)), 0.0
    for number, weight in shape.weights(points):
        total += weight
        own += weight[(number == (2, 2)).all(1)].sum()
    np.testing.assert_allclose(total, 1)
    assert own == pytest.approx(shape.lattice.area, rel=0.03)


def test_weights_fall_linearly_across_a_side() -> None:
    """On a side a texel weighs a half, a quarter of the zone inside three quarters, and beyond the zone nothing."""
    shape = TexelShape.of(BRICKS, BRICK, 4.0)
    points = np.array([(5.0, y) for y in (3.9, 5.0, 6.0, 7.0, 8.1)])
    weights = sum(weight * (number == 0).all(1) for number, weight in shape.weights(points))
    np.testing.assert_allclose(weights, [1, 0.75, 0.5, 0.25, 0])


def test_shared_zones_are_as_broad_as_the_zone() -> None:
    """The zone that two bricks of a course share holds about its breadth times the height of a brick."""
    shape = TexelShape.of(BRICKS, BRICK, 4.0)
    assert len(shape.shared_zone((1, 0))) == pytest.approx(4 * 12, rel=0.4)
    assert sum(len(shape.shared_zone(step)) > 0 for step in NEIGHBORS) == 6


def test_bricks_and_hexagons_are_found() -> None:
    """The borders with least variance follow joints: three quarters of the texel's sides show little color."""
    for model in ("brick", "hexagon"):
        texture = nrbench.texture(model, shape=(192, 192), seed=0, color=0.4, intensity=0.3)
        middles, corners = quiet_texels(quantize(texture.image), texture.lattice, "hexagon")
        np.testing.assert_allclose(corners[:3], -corners[3:], atol=1e-9)
        x, y = corners.T
        area = 0.5 * abs((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())
        assert area == pytest.approx(texture.lattice.area)
        along = np.linspace(0, 1, 40, endpoint=False)[:, np.newaxis, np.newaxis]
        sides = (corners + along * (np.roll(corners, -1, 0) - corners)).reshape(-1, 2)
        departures = ((texture.image - texture.ideal) ** 2).sum(-1, keepdims=True).astype(np.float32)
        inside = middles.points((192, 192), -30.0)
        on_sides = Patches(departures).read_points(inside[:, np.newaxis] + sides).mean()
        assert on_sides < 0.35 * departures.mean()


def test_the_lattice_grows_from_its_middle() -> None:
    """Each texel is found once, after the one in the middle, and later than a texel whose vertices are all nearer."""
    order = list(growth_order((7, 5)))
    assert order[0] == (3, 2) and sorted(order) == sorted((u, v) for u in range(7) for v in range(5))
    rank = {place: n for n, place in enumerate(order)}
    assert rank[4, 2] < rank[5, 2] < rank[6, 2] and rank[3, 3] < rank[3, 4]
    distance = [abs(u - 3) + abs(v - 2) for u, v in order]
    assert distance == sorted(distance)


def stock_of(image: np.ndarray, lattice: Lattice, zone: float = 4.0) -> TexelStock:
    """Return the parallelograms of an image."""
    return TexelStock.of(TexelShape.of(*parallelogram(lattice), zone), TexelReader(image))


def test_differences_of_neighbors_equal_brute_force() -> None:
    """The difference from each neighbor is the sum of squared differences of texels laid side by side."""
    image = np.random.default_rng(0).random((70, 80, 3), np.float32)
    lattice = Lattice((16.0, 0.0), (0.0, 14.0))
    stock = stock_of(image, lattice)
    patches = Patches(image)
    for step in ((1, 0), (0, -1), (1, 1), (-1, 1)):
        points = stock.shape.shared_zone(step)
        assert stock.zone_size(step) == len(points)
        for i, j in ((0, 1), (3, 2), (1, 1)):
            own = patches.read_points(stock.middles[i] + points)
            other = patches.read_points(stock.middles[j] + points - np.array(step) @ lattice.matrix)
            expected = ((own - other) ** 2).sum() / 3
            np.testing.assert_allclose(stock.differences(step, j)[i], expected, rtol=1e-4, atol=1e-4)


def test_a_step_and_its_opposite_agree() -> None:
    """Texel i with j at its right differs as j with i at its left, whether the numbers are kept or not."""
    stock = stock_of(np.random.default_rng(0).random((70, 80, 3), np.float32), Lattice((16.3, 2.0), (-1.0, 14.2)))
    for step in NEIGHBORS:
        back = (-step[0], -step[1])
        there = np.array([stock.differences(step, j) for j in range(len(stock.middles))])
        assert np.array_equal(there.T, [stock.differences(back, i) for i in range(len(stock.middles))])
        assert np.array_equal(there[0], stock.differences(step, 0))


def test_memory_does_not_grow_with_the_square_of_the_texels() -> None:
    """2500 texels take less than 80 MiB; tables of all pairs would take 190 MiB."""
    image = np.random.default_rng(0).random((408, 408, 1), np.float32)
    tracemalloc.start()
    stock = stock_of(image, Lattice((8.0, 0.0), (0.0, 8.0)), 3.0)
    TexelMosaic.grow(stock, (np.zeros(2), np.full(2, 300.0)), 0.1, np.random.default_rng(0), lambda done: None)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(stock.middles) > 2400
    assert peak < 80 << 20


@given(st.integers(0, 50))
def test_texels_are_drawn_within_d_max(seed: int) -> None:
    """Every texel differs from those pasted before by at most d_max, or as little as any texel could."""
    image = np.random.default_rng(1).random((64, 64, 1), np.float32)
    stock = stock_of(image, Lattice((16.0, 0.0), (0.0, 16.0)))
    largest = 0.4
    box = np.zeros(2), np.full(2, 60.0)
    mosaic = TexelMosaic.grow(stock, box, largest, np.random.default_rng(seed), lambda done: None)
    columns, rows = mosaic.chosen.shape
    standing = np.full((columns + 2, rows + 2), -1)
    for column, row in growth_order((columns, rows)):
        squares, points = np.zeros(len(stock.middles)), 0
        for step in NEIGHBORS:
            there = standing[column + 1 + step[0], row + 1 + step[1]]
            if there >= 0:
                points += stock.zone_size(step)
                squares += stock.differences(step, int(there))
        chosen = mosaic.chosen[column, row]
        assert squares[chosen] <= max(largest**2 * points, squares.min()) * (1 + 1e-6)
        standing[column + 1, row + 1] = chosen
