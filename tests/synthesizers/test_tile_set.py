"""Claims about the set of tiles: what is continued, which tiles are drawn, where they are cut, and what is refused."""

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage, stats
from synthesis_cases import FRACTIONAL, WHOLE, noise, synthesize, waves

from nrbench import texture
from nrbench.api.arguments import as_lattice
from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.datasets_procedural.modelling.pattern import rotate
from nrbench.datasets_procedural.wallpaper import Group, Wallpaper
from nrbench.datasets_procedural.weave import Weave
from nrbench.imaging.convert import Image, quantize, to_bytes
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Refused, Task
from nrbench.synthesizers.canvas.canvas import find_paths
from nrbench.synthesizers.tile_laying.tile_kernels import error_surface
from nrbench.synthesizers.tile_laying.tiles import (
    ElementWeights,
    ShiftedImages,
    TilePlaces,
    element_costs,
    symmetric_copies,
    tile_shape,
)
from nrbench.synthesizers.tile_set import LEAST_SIDE, TileLaying, TileSet

TILES = ["auto", "upright", "lattice", "rectangle", "cell"]


def laying_of(
    sample: Image, lattice: Lattice, method: TileSet, shape: tuple[int, int] = (60, 60), seed: int = 0
) -> TileLaying:
    """Return the tiles of a sample, none of which is laid."""
    return TileLaying(method, Task(sample, shape, lattice, np.random.default_rng(seed)), lattice)


def test_larger_tiles_are_fewer() -> None:
    """Tiles of 2 x 2 cells are laid in steps twice as long, and the sample still holds many of them."""
    methods = (TileSet(tile="cell", cells=cells) for cells in (1, 2))
    small, large = (laying_of(noise(160, 160), WHOLE[2], method, (400, 400)) for method in methods)
    np.testing.assert_allclose(large.tile.steps, 2 * small.tile.steps)
    assert len(large.tile_numbers()) < 0.4 * len(small.tile_numbers())
    assert len(large.sets[0, 0]) > 20


def test_the_minimum_cut_keeps_to_the_overlap() -> None:
    """A tile laid over another fills what is empty, and its outermost pixels replace nothing."""
    method = TileSet(tile="cell", stitch="graphcut", registration=0)
    laying = laying_of(noise(120, 120), Lattice((20, 0), (0, 20)), method)
    canvas, mask = laying.canvas, laying.tile.mask
    tiles = laying.stock.find_places(laying.sets[0, 0])
    (left, top), (right, bottom) = laying.tile.box.tolist()
    for n, x in enumerate((30, 40)):
        window = 30 + top, 31 + bottom, x + left, x + right + 1
        pixels = canvas.pixels(window)
        before, known = canvas.image[pixels].copy(), canvas.known[pixels].copy()
        under = canvas.image[pixels], canvas.source[pixels], canvas.known[pixels], canvas.seams[:, *pixels]
        laying.join(window, tiles.take(np.array([n])), under)
    assert canvas.known[pixels][mask].all()
    ring = known & (laying.tile.pixel_cells[..., 2] == 0)
    assert ring.any()
    np.testing.assert_array_equal(canvas.image[pixels][ring], before[ring])


@pytest.mark.parametrize(
    ("parts", "registration", "decibels"), [(None, None, 30), (4, None, 35), (8, None, 35), (4, 0.0, 42), (8, 0.0, 42)]
)
def test_a_smooth_fractional_texture_is_continued_well(parts: Any, registration: float | None, decibels: int) -> None:
    """The PSNR of a continued texture is over 35 dB, over 42 dB unregistered, over 30 dB at whole pixels (default)."""
    truth = waves((256, 256), FRACTIONAL)[..., [0, 2, 2]]
    method = TileSet(parts=parts, registration=registration)
    made = synthesize(method, quantize(truth[:128, :128]), (256, 256), FRACTIONAL)
    assert -10 * np.log10(((made.image - truth) ** 2).mean()) > decibels


def blocks(side: int) -> Image:
    """Return 5 x 5 blocks of this side, each of its own color, in cells of 32 px, the first from (10, 4) on."""
    picture = np.full((160, 160, 3), 0.5, np.float32)
    for place, color in zip(np.ndindex(5, 5), np.random.default_rng(0).random((25, 3)), strict=True):
        row, column = np.array(place) * 32
        picture[row + 4 : row + 4 + side, column + 10 : column + 10 + side] = color
    return quantize(picture)


def test_the_quiet_anchor_keeps_borders_off_what_differs() -> None:
    """The quiet anchor puts the borders of tiles where tiles are alike."""
    laying = laying_of(blocks(8), Lattice((32, 0), (0, 32)), TileSet(tile="cell", anchor="quiet"))
    away = np.abs((np.array([13.5, 7.5]) - laying.lattice.origin + 8) % 16 - 8)
    assert (away > 3).all()


def test_elements_are_shown_whole_by_t() -> None:
    """Anchored by elements, the tiles of T lie around what differs from tile to tile."""
    lattice = Lattice((32, 0), (0, 32))
    laying = laying_of(blocks(16), lattice, TileSet(tile="cell", anchor="elements"))
    assert np.abs(lattice.wrap(np.subtract(laying.lattice.origin, (17.5, 11.5)))).max() <= 2


SQUARE = Lattice((14, 0), (0, 14))


def noisy(size: int, channels: int = 1, lattice: Lattice = SQUARE, **parameters: Any) -> TileLaying:
    """Return the tiles of noise, whole pixels only, without registration."""
    return laying_of(noise(size, size, channels), lattice, TileSet(registration=0, parts=1, **parameters))


def lay(laying: TileLaying, number: tuple[int, int], threshold: float) -> tuple[int, int]:
    """Lay the tile of this number, and return the sample's (x, y) that is shown right of its middle."""
    i, j = number
    place = laying.lattice.origin + np.array(number) @ laying.tile.steps
    laying.lay_tile(i, j, place, threshold)
    x, y = (np.floor(place + 0.5).astype(int) + right(laying)).tolist()
    found_x, found_y = laying.canvas.source[laying.canvas.pixels((y, y + 1, x, x + 1))][0, 0, :2].astype(int).tolist()
    return found_x, found_y


def right(laying: TileLaying) -> NDArray[np.int64]:
    """Return (x, y), from a tile's middle, of a pixel of its right half: no tile before it showed that place."""
    return np.array([laying.tile.box[1, 0] // 2, 0])


def apart(laying: TileLaying, number: tuple[int, int], cuts: TilePlaces) -> NDArray[np.float64]:
    """Return each tile's mean absolute difference, channels added, from what is filled at this number's place."""
    place = laying.lattice.origin + np.array(number) @ laying.tile.steps
    x, y = np.floor(place + 0.5).astype(int).tolist()
    (left, top), (right, bottom) = laying.tile.box.tolist()
    pixels = laying.canvas.pixels((y + top, y + bottom + 1, x + left, x + right + 1))
    stands = laying.canvas.known[pixels] & laying.tile.mask
    shown, sample = laying.canvas.image[pixels][stands].astype(float), to_bytes(laying.task.sample).astype(float)
    tiles = (sample[cy + top : cy + bottom + 1, cx + left : cx + right + 1][stands] for cx, cy in cuts.pixel.tolist())
    return np.array([np.abs(tile - shown).sum(-1).mean() for tile in tiles])


def test_candidates_are_the_tiles_that_differ_by_no_more_than_the_threshold(monkeypatch: pytest.MonkeyPatch) -> None:
    """At each place the candidates are all tiles within the threshold, or the nearest one if there is none."""
    laying = noisy(100, 3, Lattice((20, 0), (0, 16)))
    threshold, sizes = 222.0, Counter[str]()
    drawn: list[tuple[TilePlaces, NDArray[np.int64]]] = []
    real = laying.draw

    def record(cuts: TilePlaces, among: NDArray[np.int64]) -> TilePlaces:
        drawn.append((cuts, among))
        return real(cuts, among)

    monkeypatch.setattr(laying, "draw", record)
    for i, j in laying.tile_numbers().tolist()[1:]:
        cuts = laying.stock.find_places(laying.sets[i % 2, j % 2])
        before = apart(laying, (i, j), cuts) if laying.canvas.known.any() else None
        lay(laying, (i, j), threshold)
        if before is None or np.isnan(before).any():
            continue
        np.testing.assert_array_equal(drawn[-1][0].pixel, cuts.pixel)
        within = np.flatnonzero(before <= max(threshold, before.min()) + 1e-9)
        np.testing.assert_array_equal(drawn[-1][1], within)
        sizes["none" if before.min() > threshold else "all" if len(within) == len(cuts.place) else "some"] += 1
    assert sizes["none"] > 1 and sizes["some"] > 3


@pytest.mark.parametrize("share", [0.4, 1.0])
def test_the_random_choice_is_uniform_over_the_candidates(share: float) -> None:
    """Each tile within the threshold is drawn equally often, and no other."""
    laying = noisy(110, tile="lattice", cells=1)
    first = laying.tile_numbers()[0].tolist()
    second = first[0] + 1, first[1]
    lay(laying, first, 0)
    arrays = laying.canvas.image, laying.canvas.known, laying.canvas.source, laying.canvas.seams
    kept = [array.copy() for array in arrays]
    cuts = laying.stock.find_places(laying.sets[second[0] % 2, second[1] % 2])
    differences = apart(laying, second, cuts)
    threshold = float(np.quantile(differences, share)) + 1e-6
    places = Counter[tuple[int, int]]()
    for _ in range(1500):
        for array, old in zip(arrays, kept, strict=True):
            array[...] = old
        places[lay(laying, second, threshold)] += 1
    candidates = cuts.pixel[differences <= threshold] + right(laying)
    assert len(candidates) > 3 and (len(candidates) < len(cuts.place)) == (share < 1)
    assert set(places) == {tuple(place) for place in candidates.tolist()}
    assert stats.chisquare(list(places.values())).pvalue > 1e-3


def test_the_first_tile_is_drawn_from_all_of_t() -> None:
    """On an empty canvas every tile of T is drawn equally often, whatever the threshold."""
    laying = noisy(88, tile="lattice")
    first = laying.tile_numbers()[0].tolist()
    places = Counter[tuple[int, int]]()
    for _ in range(1500):
        laying.canvas.known[...] = False
        places[lay(laying, first, 0)] += 1
    assert len(places) == len(laying.sets[0, 0])
    assert stats.chisquare(list(places.values())).pvalue > 1e-3


@given(
    st.tuples(st.floats(-20, 20), st.floats(-20, 20)),
    st.sampled_from(["upright", "lattice", "rectangle", "cell"]),
    st.integers(1, 3),
)
@settings(max_examples=40)
def test_laying_starts_with_a_tile_of_t(origin: tuple[float, float], tile: Any, cells: int) -> None:
    """Wherever the lattice lies, the first tile is of T, at most a step before the first that touches the output."""
    lattice = Lattice((20, 5), (-4, 22), origin)
    laying = noisy(200, lattice=lattice, tile=tile, cells=cells, anchor="given")
    numbers = laying.tile_numbers()
    places = laying.lattice.origin + numbers @ laying.tile.steps
    low, high = -laying.tile.reach - 1, np.add((60, 60), laying.tile.reach)
    touching = ((places > low) & (places < high)).all(1)
    assert np.abs(lattice.wrap(places[0] - origin)).max() < 1e-6
    assert touching[1:].all() and len(np.unique(numbers, axis=0)) == len(numbers)
    assert touching[0] or set((numbers[1] - numbers[0]).tolist()) <= {0, 1}


def test_the_oddest_tile_accepts_half_of_the_others() -> None:
    """The threshold is the largest, over the tiles of all sets, of the medians of their differences from the others."""
    sample, lattice = noise(70, 70, 1), Lattice((16, 0), (0, 16))
    sample[:16, :16] = 1
    laying = laying_of(sample, lattice, TileSet(tile="cell", anchor="given", cells=1, margin=0))
    (left, top), (right, bottom) = laying.tile.box.tolist()
    x, y = np.meshgrid(np.arange(left, right + 1), np.arange(top, bottom + 1))
    row, column, _ = np.moveaxis(laying.tile.pixel_cells, -1, 0)
    covered = laying.tile.mask & ((row < 8) | (column < 8))
    medians = []
    for number in np.ndindex(2, 2):
        middles = laying.stock.find_places(laying.sets[number]).pixel
        cut = np.stack([to_bytes(sample)[y0 + y[covered], x0 + x[covered], 0] for x0, y0 in middles]).astype(float)
        distances = np.abs(cut[:, np.newaxis] - cut).mean(-1)
        medians += [np.median(np.delete(line, n)) for n, line in enumerate(distances)]
    assert laying.stock.estimate_threshold(0.5, 1.0, "mean") == pytest.approx(max(medians))
    assert laying.stock.estimate_threshold(0.5, 0.5, "mean") == pytest.approx(np.median(medians))


@pytest.mark.parametrize(("period", "moves"), [(18.0, False), (26.0, True)])
def test_registration_moves_nothing_by_less_than_half_a_part(period: float, moves: bool) -> None:
    """By default tiles are registered where 0.025 s is half a pixel or more, not where s is from 10 to 20 px."""
    lattice = Lattice((period + 0.43, 2.6), (-2.3, period + 0.31))
    sample = quantize(0.8 * waves((128, 128), lattice) + 0.2 * noise(128, 128))
    one, other = (synthesize(TileSet(registration=r), sample, (160, 160), lattice).image for r in (None, 0.0))
    assert (one != other).any() == moves


REAL_LATTICES = [
    Lattice((24.3, 0.0), (0.0, 21.7)),
    Lattice((14.2, 12.7), (14.2, -12.7)),
    Lattice((23.4, 5.1), (-5.1, 23.4)),
]


def discs(size: int, lattice: Lattice, seed: int = 0) -> tuple[Image, NDArray[np.float64], NDArray[np.bool_]]:
    """Return discs of one color each on a flat ground, each pixel's lattice point, and a mask of the discs."""
    y, x = np.indices((size, size))
    pixels = np.stack([x, y], -1)
    away = lattice.wrap(pixels - lattice.origin)
    middles = np.round(lattice.to_cell(pixels - away)).astype(int)
    colors = np.random.default_rng(seed).random((200, 200, 3))[middles[..., 0], middles[..., 1]]
    inside = np.hypot(*np.moveaxis(away, -1, 0)) < 0.48 * lattice.s
    return quantize(np.where(inside[..., np.newaxis], colors, 0.5).astype("f4")), middles, inside


def whole(made: Image, middles: NDArray[np.float64], inside: NDArray[np.bool_]) -> float:
    """Return the share of discs that are of one color."""
    keys = middles[..., 0] * 1000 + middles[..., 1]
    spreads = [np.ptp(made[inside & (keys == key)], axis=0).max() for key in np.unique(keys[20:-20, 20:-20])]
    return float(np.mean(np.array(spreads) < 0.02))


@pytest.mark.parametrize("lattice", REAL_LATTICES)
def test_elements_stay_whole(lattice: Lattice) -> None:
    """Nine of ten discs keep one color."""
    _, middles, inside = discs(200, lattice)
    away = np.hypot(*np.moveaxis(lattice.wrap(np.stack(np.indices((200, 200))[::-1], -1)), -1, 0))
    made = synthesize(TileSet(), discs(128, lattice)[0], (200, 200), lattice).image
    assert whole(made, middles, inside & (away < 0.48 * lattice.s - 2)) > 0.9


PAPER = TileSet(**TileSet.presets["paper"])


def test_the_papers_seams_end_where_they_meet() -> None:
    """The seam of the left overlap starts at that of the top, so that what lies above it has no say in its course."""
    surface = np.full((20, 20), 1.0)
    surface[:9, 8], surface[9:, 2], surface[9, 2:] = 0, 0, 0
    across, down, *meeting = find_paths(surface, 10, 10)
    assert meeting == [9, 2]
    assert (across[9:] == 2).all() and (down[2:] == 9).all()


MODELS = [Brick(color=0.2), Weave(color=0.2), Hexagon(color=0.2)]


def joined(
    model: Model, seeds: range, shape: int, size: int, method: TileSet, at: tuple[float, float] = (0, 0)
) -> float:
    """Return the mean share of the elements of outputs 5 % of which or more come from a second element of the sample.

    ``at`` is the origin of the given lattice, in cells from the middle of an element.
    """
    return float(np.mean([joined_once(model, seed, shape, size, method, at) for seed in seeds]))


def joined_once(model: Model, seed: int, shape: int, size: int, method: TileSet, at: tuple[float, float]) -> float:
    """Return the same for one seed."""
    drawn = model.render((shape, shape), np.random.default_rng(seed))
    lattice, (x0, y0) = drawn.lattice, drawn.lattice.origin
    given = lattice.shifted(np.array(at) @ lattice.matrix)
    source = method.synthesize(Task(quantize(drawn.image), (size, size), given, np.random.default_rng(seed))).source

    def elements(x: NDArray[Any], y: NDArray[Any]) -> NDArray[np.int64]:
        """Return the number of the element that covers each point, 0 between elements."""
        found = np.zeros(x.shape, np.int64)
        for n, layer in enumerate(model.pattern(*rotate(x - x0, y - y0, model.rotation)).layers, 1):
            number = n + sum((part + 500) * 1000**k for k, part in enumerate(layer.index, 1))
            found = np.where(layer.coverage > 0.99, number, np.where(layer.coverage > 0.01, 0, found))
        return found

    y, x = np.indices((size, size)).astype(np.float64)
    places, origins = elements(x, y), elements(*np.moveaxis(np.rint(source[..., :2]).astype(np.float64), -1, 0))
    inside = (ndimage.maximum_filter(places, 3) == ndimage.minimum_filter(places, 3)) & (places > 0)
    pieces, count = ndimage.label(inside)
    largest = [np.unique(origins[pieces == n], return_counts=True)[1] for n in range(1, count + 1)]
    return float(np.mean([each.max() < 0.95 * each.sum() for each in largest if each.sum() > 40]))


@pytest.mark.parametrize(("model", "most"), list(zip(MODELS, (0.3, 0.3, 0.5), strict=True)))
def test_the_papers_tiles_leave_elements_whole(model: Model, most: float) -> None:
    """Seven of ten bricks and crossings and half of the hexagons are of one piece, anchored on joints, as by hand.

    In the middle of elements, the paper's stitching joins more; what counts is that borders lie where tiles agree.
    """
    methods = (replace(PAPER, anchor=anchor) for anchor in ("quiet", "given"))
    quiet, middle = (joined(model, range(800, 804), 128, 160, method) for method in methods)
    assert quiet < most and quiet < 0.75 * middle


@pytest.mark.parametrize("model", [MODELS[0], MODELS[2]])
@pytest.mark.parametrize("method", [TileSet(anchor="given"), replace(PAPER, anchor="given")])
def test_a_given_anchor_lies_midway_between_rows(method: TileSet, model: Model) -> None:
    """Midway between two rows, above the middle of an element, few are broken; midway between four, most."""
    good, bad = (joined(model, range(810, 812), 128, 160, method, at) for at in ((0.25, 0.5), (0.5, 0.5)))
    assert good < 0.75 * bad


def test_windows_of_the_lattices_shape_break_fewer_bricks() -> None:
    """On a turned wall, tiles along the lattice break fewer bricks than upright rectangles (section 4.3)."""
    methods = (replace(PAPER, tile=tile) for tile in ("upright", "lattice"))
    upright, along = (joined(Brick(color=0.2, rotation=17.3), range(2), 160, 160, method) for method in methods)
    assert along < 0.75 * upright


def test_the_upper_seam_counts_the_border_that_it_leaves() -> None:
    """A seam that ends high at the right pays for the border below its end, where the row above goes on."""
    image, patch = np.zeros((6, 6, 1), np.uint8), np.full((6, 6, 1), 2, np.uint8)
    known = np.ones((6, 6), np.bool_)
    known[3:, 3:] = False
    cells = np.stack(np.indices((6, 6))[::-1], -1)
    surface, bands = error_surface(image, known, patch, cells)
    assert bands == (3, 3)
    assert surface[:, -1].tolist() == [12, 8, 4, 0, 0, 0]
    assert surface[:3, :-1].tolist() == [[4.0] * 5] * 3


@pytest.mark.parametrize("given", [None, Lattice((24, 0), (12, 12))])
def test_without_an_origin_the_papers_anchor_is_quiet(given: Lattice | None) -> None:
    """A lattice that was detected, or given without an origin, is anchored by the paper's rule; the note says so."""
    sample = quantize(Brick(width=24, height=12, noise=0).render((128, 128), np.random.default_rng(0)).image)
    task, method = Task(sample, (64, 64), given, np.random.default_rng(1)), replace(PAPER, anchor="given")
    made = method.synthesize(task)
    assert "no origin" in made.note and made.lattice is not None
    assert made.lattice.is_equivalent(Lattice((24, 0), (12, 12)), 0.1)
    quiet = replace(PAPER, anchor="quiet").synthesize(replace(task, rng=np.random.default_rng(1)))
    np.testing.assert_array_equal(made.image, quiet.image)
    anchored = method.synthesize(replace(task, lattice=as_lattice("24,0,12,12,0,0")))
    assert not anchored.note


@pytest.mark.parametrize("lattice", REAL_LATTICES)
def test_the_anchor_lies_in_the_middle_of_elements(lattice: Lattice) -> None:
    """With few tiles the anchor lies within 1.5 px of the discs' middles, wherever they are."""
    for seed, origin in enumerate([(0.0, 0.0), (5.5, 3.2), (-7.1, 9.9)]):
        moved = lattice.shifted(origin)
        costs, anchors = element_costs(discs(110, moved, seed)[0], lattice)
        assert np.hypot(*lattice.wrap(anchors[costs.argmin()] - origin)) < 1.5


def test_seams_are_recorded_only_where_tiles_meet() -> None:
    """Nearly all links between pixels of different tiles have a cost, and hardly any others."""
    laying = laying_of(noise(120, 120), REAL_LATTICES[0], TileSet(registration=0), (90, 90), seed=1)
    laying.lay_tiles()
    canvas = laying.canvas
    y, x = canvas.margin
    window = np.s_[y : y + 90, x : x + 90]
    offsets = canvas.source[window][..., :2] - np.stack(np.indices((90, 90))[::-1], -1)
    across = (offsets[:, 1:] != offsets[:, :-1]).any(-1)
    down = (offsets[1:] != offsets[:-1]).any(-1)
    for seams, meet in ((canvas.seams[0][window][:, :-1], across), (canvas.seams[1][window][:-1], down)):
        assert (seams[~meet] > 0).mean() < 0.02
        assert (seams[meet] > 0).mean() > 0.95


@pytest.mark.parametrize(("s", "cells"), [(6.3, 3), (10.7, 2), (15.9, 2), (16.0, 1), (40.0, 1)])
def test_small_cells_are_laid_several_at_a_time(s: float, cells: int) -> None:
    """By default tiles have the fewest cells that make s times the cells at least 16 px."""
    lattice = Lattice((s, 0.0), (0.0, 1.2 * s))
    laying = laying_of(noise(200, 200, 1), lattice, TileSet())
    np.testing.assert_allclose(laying.tile.steps, tile_shape(lattice, "cell", cells).steps)
    assert s * cells >= LEAST_SIDE > s * (cells - 1)


def test_a_margin_lengthens_tiles_and_leaves_steps() -> None:
    """Each side is longer by twice the margin in its own direction."""
    plain, wide = (tile_shape(REAL_LATTICES[2], "lattice", 1, margin) for margin in (0.0, 3.0))
    np.testing.assert_allclose(np.hypot(*wide.sides.T), np.hypot(*plain.sides.T) + 6)
    np.testing.assert_allclose(wide.steps, plain.steps)


def test_a_sample_too_small_for_margins_is_laid_without() -> None:
    """If tiles just fit into the sample, they have no margin by default."""
    laying = laying_of(noise(82, 82, 1), Lattice((40, 0), (0, 40), (20, 20)), TileSet(anchor="given"))
    np.testing.assert_allclose(np.abs(laying.tile.sides).sum(0), 40)


@pytest.mark.parametrize("color", [0.05, 0.1, 0.14, 0.3])
@pytest.mark.parametrize(("model", "most"), [("brick", 2.0), ("hexagon", 1.5)])
def test_elements_of_slight_departures_are_found(model: str, most: float, color: float) -> None:
    """On eight draws, of the vectors alone, the best anchor is the middle of a brick or hexagon, to that many px."""
    for seed in range(300, 308):
        drawn = texture(model, (128, 128), seed, color=color)
        costs, anchors = element_costs(quantize(drawn.image), Lattice(drawn.lattice.t1, drawn.lattice.t2))
        off = drawn.lattice.wrap(anchors[costs.argmin()] - drawn.lattice.origin)
        assert np.hypot(*off) < most, (seed, off)


@pytest.mark.parametrize("color", [0.05, 0.3])
def test_seams_follow_joints_between_like_bricks(color: float) -> None:
    """On mild walls at most one brick in 200 is joined of two."""
    assert joined(Brick(color=color), range(700, 703), 128, 256, TileSet()) <= 0.005


def test_bricks_as_wide_as_the_cell_stay_whole() -> None:
    """Where a cell is one brick wide and six courses high, automatic tiles join few bricks; one cell joins more."""
    wall = Brick(width=22.7, height=9.3, joint=1.8, small_every=6, color=0.15, intensity=0.2)
    automatic, cell = (joined(wall, range(7, 9), 192, 240, method) for method in (TileSet(), TileSet(tile="cell")))
    assert automatic <= 0.04 and cell > 2 * automatic


def test_element_weights_are_least_at_joints() -> None:
    """The weight in the middle of a brick is at least three times that at the joint between two."""
    drawn = texture("brick", (160, 160), 5, width=27.3, height=12.2, joint=2.2, color=0.1)
    weights = ElementWeights.of(quantize(drawn.image), drawn.lattice)
    rows, columns = weights.table.shape
    numbers = weights.numbers_from(np.zeros(2))

    def at(x: float, y: float) -> float:
        u, v = numbers @ (x + drawn.lattice.origin[0], y + drawn.lattice.origin[1], 1)
        return float(weights.table[round(v * rows) % rows, round(u * columns) % columns])

    assert at(0, 0) > 3 * max(at(27.3 / 2, 0), at(0, 12.2 / 2))


@pytest.mark.parametrize("lattice", WHOLE)
def test_a_set_is_what_no_lattice_vector_leads_out_of(lattice: Lattice) -> None:
    """Upright, lattice and rectangle tiles have two sets, cells four, and tiles of 2 x 2 cells one."""
    for tile, count in (("upright", 2), ("lattice", 2), ("rectangle", 2), ("cell", 4)):
        for cells in (1, 2, 3):
            shape = tile_shape(lattice, tile, cells)
            numbers = shape.set_offsets(lattice)
            assert len(numbers) == (1 if cells == 2 else count) and numbers[0] == (0, 0)
            between = np.array(list(np.ndindex(2, 2))) @ shape.steps
            nearest = np.stack([lattice.wrap(between - np.array(one) @ shape.steps) for one in numbers])
            assert ((np.hypot(*np.moveaxis(nearest, -1, 0)) < 1e-6).sum(0) == 1).all()


@settings(max_examples=40)
@given(
    st.tuples(st.integers(16, 48), st.integers(16, 48)),
    st.sampled_from([Lattice((12, 0), (0, 15)), Lattice((11.3, 0), (0, 9.7)), *WHOLE, Lattice((8, 1), (-1, 9.5))]),
    st.sampled_from(TILES),
    st.sampled_from(["quiet", "elements", "given"]),
    st.tuples(st.floats(-20, 20), st.floats(-20, 20)),
    st.sampled_from([1, 2, 3]),
)
def test_whatever_the_size_it_is_laid_or_refused(
    size: tuple[int, int], lattice: Lattice, tile: Any, anchor: Any, origin: tuple[float, float], cells: int
) -> None:
    """For samples about as small as possible, with any origin, there is an output or a reason."""
    method, sample = TileSet(tile=tile, anchor=anchor, cells=cells), noise(*size, 1)
    try:
        made = synthesize(method, sample, (30, 34), lattice.shifted(origin))
    except Refused as refusal:
        assert "less than two periods" in refusal.reason or "does not hold" in refusal.reason
        return
    assert made.image.shape == (30, 34, 1) and made.source is not None and (made.source[..., 2] > 0).all()


@pytest.mark.parametrize("lattice", [Lattice((11.3, 0), (0, 9.7)), Lattice((20.9, 0.2), (-0.1, 13.2))])
@pytest.mark.parametrize("cells", [1, 2, 3])
def test_upright_tiles_leave_no_gap(lattice: Lattice, cells: int) -> None:
    """Every pixel is filled where an upright tile is the minimum tile itself, with fractional sides."""
    made = synthesize(TileSet(tile="upright", cells=cells), noise(90, 140, 1), (150, 160), lattice)
    assert made.source is not None and (made.source[..., 2] > 0).all()


@pytest.mark.parametrize(
    ("group", "rotation", "count"), [("p1", 0.0, 0), ("pgg", 0.0, 3), ("p6", 9.0, 5), ("p4m", 0.0, 7)]
)
def test_copies_show_what_the_sample_shows(group: Group, rotation: float, count: int) -> None:
    """There is a copy for each isometry of the group but the identity, and on a periodic sample it is the sample."""
    model = Wallpaper(width=24.0, height=20.0, group=group, rotation=rotation, color=0, intensity=0, noise=0, motif=1)
    drawn = model.render((96, 96), np.random.default_rng(0))
    copies = symmetric_copies(drawn.image, drawn.lattice, whole=False)
    assert len(copies) == count
    rows = ShiftedImages.of(drawn.image, 1, copies).values.reshape(-1, 96, 96, 3).astype(int)
    y, x = np.indices((96, 96))
    for (matrix, offset), copy in zip(copies, rows[1:], strict=True):
        at = np.stack([x, y], -1) @ matrix + offset
        shown = ((at >= 2) & (at <= 93)).all(-1)
        errors = [np.abs(np.roll(copy, moved, 1) - rows[0])[shown].mean() for moved in (0, 1)]
        assert shown.mean() > 0.4 and errors[0] < min(3.0, errors[1] / 2)


def test_tiles_of_copies_are_drawn_with_their_sources() -> None:
    """With its own symmetry, a wall takes exact pixels of mirrored copies, and the map says whence."""
    drawn = texture("brick", shape=(96, 112), seed=2, color=0.4)
    plain, made = (
        synthesize(TileSet(symmetry=kind), drawn.image, (128, 128), drawn.lattice) for kind in ("none", "own")
    )
    x, y, weight = np.moveaxis(made.source, -1, 0)
    assert (weight == 1).all() and np.abs(made.image - drawn.image[y.astype(int), x.astype(int)]).max() < 1 / 255
    assert ((np.diff(x, axis=1) == -1).mean() > 0.1) and ((np.diff(plain.source[..., 0], axis=1) == -1).mean() < 0.02)
