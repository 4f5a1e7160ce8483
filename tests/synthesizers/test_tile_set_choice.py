from collections import Counter
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from nrbench.imaging.convert import quantize, to_bytes
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Task
from nrbench.synthesizers.tile_laying.tile_stock import TilePlaces
from nrbench.synthesizers.tile_set import TileLaying, TileSet

from .test_tile_set import noise, waves

SQUARE = Lattice((14, 0), (0, 14))


def laying_of(size: int, channels: int = 1, lattice: Lattice = SQUARE, **parameters: Any) -> TileLaying:
    """Return the laying of noise, whole pixels only, without registration."""
    task = Task(noise(size, size, channels), (60, 60), lattice, np.random.default_rng(0))
    return TileLaying(TileSet(registration=0, parts=1, **parameters), task, lattice)


def lay(laying: TileLaying, number: tuple[int, int], threshold: float) -> tuple[int, int]:
    """Lay the tile of this number, and return the sample's (x, y) that is shown right of its middle."""
    i, j = number
    place = laying.lattice.origin + np.array(number) @ laying.tile.steps
    laying.lay_tile(i, j, place, threshold)
    x, y = np.floor(place + 0.5).astype(int) + laying.canvas.margin + right(laying)
    found_x, found_y = laying.canvas.origins[y, x, :2].astype(int).tolist()
    return found_x, found_y


def right(laying: TileLaying) -> NDArray[np.int64]:
    """Return (x, y), from a tile's middle, of a pixel of its right half: no tile before it showed that place."""
    return np.array([laying.tile.box[1, 0] // 2, 0])


def apart(laying: TileLaying, number: tuple[int, int], cuts: TilePlaces) -> NDArray[np.float64]:
    """Return each tile's mean absolute difference, channels added, from what is filled at this number's place."""
    place = laying.lattice.origin + np.array(number) @ laying.tile.steps
    x, y = (laying.tile.pixels[:, :2] + np.floor(place + 0.5).astype(int) + laying.canvas.margin).T
    stands = laying.canvas.filled[y, x] == 1
    x, y, offsets = x[stands], y[stands], laying.tile.pixels[stands, :2]
    shown, sample = laying.canvas.values[y, x].astype(float), to_bytes(laying.task.sample).astype(float)
    tiles = (sample[cy + offsets[:, 1], cx + offsets[:, 0]] for cx, cy in cuts.pixel.tolist())
    return np.array([np.abs(tile - shown).sum(-1).mean() for tile in tiles])


def test_candidates_are_the_tiles_that_differ_by_no_more_than_the_threshold(monkeypatch: pytest.MonkeyPatch) -> None:
    """At each place the candidates are all tiles within the threshold, or the nearest one if there is none."""
    laying = laying_of(100, 3, Lattice((20, 0), (0, 16)))
    threshold, sizes = 222.0, Counter[str]()
    drawn: list[tuple[TilePlaces, NDArray[np.int64]]] = []
    real = laying.draw

    def record(cuts: TilePlaces, among: NDArray[np.int64]) -> TilePlaces:
        drawn.append((cuts, among))
        return real(cuts, among)

    monkeypatch.setattr(laying, "draw", record)
    for i, j in laying.tile_numbers().tolist()[1:]:
        cuts = laying.stock.cut(laying.sets[i % 2, j % 2])
        before = apart(laying, (i, j), cuts) if laying.canvas.filled.any() else None
        lay(laying, (i, j), threshold)
        if before is None or np.isnan(before).any():
            continue
        np.testing.assert_array_equal(drawn[-1][0].pixel, cuts.pixel)
        within = np.flatnonzero(before <= max(threshold, before.min()) + 1e-9)
        np.testing.assert_array_equal(drawn[-1][1], within)
        sizes["none" if before.min() > threshold else "all" if len(within) == len(cuts.row) else "some"] += 1
    assert sizes["none"] > 1 and sizes["some"] > 3


@pytest.mark.parametrize("share", [0.4, 1.0])
def test_the_random_choice_is_uniform_over_the_candidates(share: float) -> None:
    """Each tile within the threshold is drawn equally often, and no other."""
    laying = laying_of(110, tile="lattice", cells=1)
    first = laying.tile_numbers()[0].tolist()
    second = first[0] + 1, first[1]
    lay(laying, first, 0)
    arrays = laying.canvas.values, laying.canvas.filled, laying.canvas.origins, laying.canvas.seams
    kept = [array.copy() for array in arrays]
    cuts = laying.stock.cut(laying.sets[second[0] % 2, second[1] % 2])
    differences = apart(laying, second, cuts)
    threshold = float(np.quantile(differences, share)) + 1e-6
    places = Counter[tuple[int, int]]()
    for _ in range(1500):
        for array, old in zip(arrays, kept, strict=True):
            array[...] = old
        places[lay(laying, second, threshold)] += 1
    candidates = cuts.pixel[differences <= threshold] + right(laying)
    assert len(candidates) > 3 and (len(candidates) < len(cuts.row)) == (share < 1)
    assert set(places) == {tuple(place) for place in candidates.tolist()}
    assert stats.chisquare(list(places.values())).pvalue > 1e-3


def test_the_first_tile_is_drawn_from_all_of_t() -> None:
    """On an empty canvas every tile of T is drawn equally often, whatever the threshold."""
    laying = laying_of(88, tile="lattice")
    first = laying.tile_numbers()[0].tolist()
    places = Counter[tuple[int, int]]()
    for _ in range(1500):
        laying.canvas.filled[...] = 0
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
    laying = laying_of(200, lattice=lattice, tile=tile, cells=cells, anchor="given")
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
    laying = TileLaying(
        TileSet(tile="cell", anchor="given", cells=1, margin=0),
        Task(sample, (9, 9), lattice, np.random.default_rng(0)),
        lattice,
    )
    x, y, row, column, _ = laying.tile.pixels.T
    covered = (row < 8) | (column < 8)
    medians = []
    for number in np.ndindex(2, 2):
        middles = laying.stock.cut(laying.sets[number]).pixel
        cut = np.stack([to_bytes(sample)[y0 + y[covered], x0 + x[covered], 0] for x0, y0 in middles]).astype(float)
        distances = np.abs(cut[:, np.newaxis] - cut).mean(-1)
        medians += [np.median(np.delete(line, n)) for n, line in enumerate(distances)]
    assert laying.stock.estimate_threshold(0.5, "mean") == pytest.approx(max(medians))


def test_every_parameter_changes_something() -> None:
    """Every parameter has an effect on a sample whose tiles differ and that is slightly off its lattice."""
    lattice = Lattice((21.37, 2.6), (-2.3, 18.81))
    regular = waves((128, 128), lattice)
    sample = quantize(0.8 * regular + 0.2 * regular * noise(128, 128))

    def made(**parameters: Any) -> NDArray[np.float32]:
        task = Task(sample, (72, 72), lattice, np.random.default_rng(1))
        return TileSet(**parameters).synthesize(task).image

    base = made()
    changes: list[dict[str, Any]] = [
        {"tile": "upright"}, {"tile": "rectangle"}, {"tile": "lattice"}, {"cells": 2}, {"quantile": 0.1},
        {"threshold": 30.0}, {"registration": 3.0}, {"parts": 3}, {"margin": 0.0},
        {"stitch": "dynamic"}, {"anchor": "quiet"}, {"anchor": "given"},
    ]  # fmt: skip
    for change in changes:
        assert (made(**change) != base).any(), change
    assert (made(overlap_measure="sum", threshold=40.0) != made(threshold=40.0)).any()


@pytest.mark.parametrize(("period", "moves"), [(18.0, False), (26.0, True)])
def test_registration_moves_nothing_by_less_than_half_a_part(period: float, moves: bool) -> None:
    """By default tiles are registered where 0.025 s is half a pixel or more, not where s is from 10 to 20 px."""
    lattice = Lattice((period + 0.43, 2.6), (-2.3, period + 0.31))
    sample = quantize(0.8 * waves((128, 128), lattice) + 0.2 * noise(128, 128))
    one, other = (
        TileSet(registration=radius).synthesize(Task(sample, (160, 160), lattice, np.random.default_rng(1))).image
        for radius in (None, 0.0)
    )
    assert (one != other).any() == moves
