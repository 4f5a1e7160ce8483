"""Claims about the cheapest paths, minimum cuts and L-shaped seams between a picture and a patch laid over it."""

import itertools
from collections.abc import Iterable, Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import maximum_flow

from nrbench.imaging.convert import Image
from nrbench.jit import kernel
from nrbench.synthesizers.canvas.canvas import Mask, find_paths
from nrbench.synthesizers.canvas.seam_kernels import (
    SOURCE,
    cheapest_path,
    corner_paths,
    cut_overlap,
    grow_trees,
    link_costs,
)

sizes = st.tuples(st.integers(1, 5), st.integers(1, 5))
seeds = st.integers(0, 10_000)
Pixel = tuple[int, int]

_grow = kernel(grow_trees.function)


def paths_from(start: Pixel, rows: int, width: int) -> Iterator[list[Pixel]]:
    """Yield every 8-connected path from a pixel down to the last row, in columns below ``width``."""
    y, x = start
    if y == rows - 1:
        yield [start]
        return
    for step in (-1, 0, 1):
        if 0 <= x + step < width:
            for rest in paths_from((y + 1, x + step), rows, width):
                yield [start, *rest]


def least_path(error: NDArray[np.float64], starts: Iterable[Pixel], width: int) -> float:
    """Return the least sum of errors over every path from any of the starts."""
    return min(sum(error[pixel] for pixel in path) for start in starts for path in paths_from(start, len(error), width))


@given(sizes, seeds)
def test_no_path_is_cheaper(shape: tuple[int, int], seed: int) -> None:
    """The seam is a path, and costs no more than any other path."""
    error = np.random.default_rng(seed).integers(0, 4, shape).astype(float)
    seam = cheapest_path(error)
    assert (np.abs(np.diff(seam)) <= 1).all()
    assert error[np.arange(len(error)), seam].sum() == least_path(error, ((0, x) for x in range(shape[1])), shape[1])


def test_ties_are_broken_always_alike() -> None:
    """On a flat surface the seam is the straight line at the left."""
    np.testing.assert_array_equal(cheapest_path(np.zeros((6, 4))), np.zeros(6))


def test_forbidden_pixels_are_avoided() -> None:
    """A seam passes through the only gap in a wall of infinities."""
    error = np.ones((9, 7))
    error[4] = np.inf
    error[4, 5] = 100
    assert cheapest_path(error)[4] == 5


Weights = NDArray[np.float64]
Problem = tuple[Weights, Weights, Weights]
"""Capacities of the links to the right and downward ``(2, h, w)``, to the source, and to the sink ``(h, w)``."""
BOUND = 1 << 20
"""Stands for infinity where capacities must be whole numbers."""


def problem(shape: tuple[int, int], seed: int, largest: int = 20, dense: float = 0.5, hard: float = 0.0) -> Problem:
    """Return a random problem of whole numbers; some pixels are tied to a side."""
    rng = np.random.default_rng(seed)
    weights = rng.integers(0, largest, (4, *shape)) * (rng.random((4, *shape)) < dense).astype(float)
    links, source, sink = weights[:2], weights[2], weights[3]
    links[0, :, -1] = links[1, -1] = 0
    tied = rng.random(shape)
    source[tied < hard], sink[tied > 1 - hard] = np.inf, np.inf
    return links, source, sink


def minimum_cut(links: Weights, source: Weights, sink: Weights) -> Mask:
    """Return the pixels that the maximum flow leaves in the tree of the source."""
    padded = np.pad(links, ((0, 0), (1, 1), (1, 1)))
    residual = np.stack([padded[0], np.roll(padded[0], 1, 1), padded[1], np.roll(padded[1], 1, 0)])
    terminal = np.pad(source - sink, 1)
    tree = _grow(residual.reshape(4, -1), terminal.ravel(), terminal.shape[1])
    return tree.reshape(terminal.shape)[1:-1, 1:-1] == SOURCE


def cut_value(mask: Mask, links: Weights, source: Weights, sink: Weights) -> float:
    """Return the cost of a labeling."""
    across, down = mask[:, 1:] != mask[:, :-1], mask[1:] != mask[:-1]
    terminals = float(source[~mask].sum() + sink[mask].sum())
    return terminals + float(links[0, :, :-1][across].sum() + links[1, :-1][down].sum())


def flow(links: Weights, source: Weights, sink: Weights) -> int:
    """Compute the maximum flow with scipy."""
    shape, count = source.shape, source.size
    index = np.arange(count).reshape(shape)
    first = [index[:, :-1], index[:, 1:], index[:-1], index[1:], np.full(shape, count), index]
    last = [index[:, 1:], index[:, :-1], index[1:], index[:-1], index, np.full(shape, count + 1)]
    held = [links[0, :, :-1], links[0, :, :-1], links[1, :-1], links[1, :-1], source, sink]
    data = np.concatenate([np.minimum(part, BOUND).ravel() for part in held]).astype(np.int32)
    where = tuple(np.concatenate([part.ravel() for part in parts]) for parts in (first, last))
    graph = coo_array((data, where), shape=(count + 2, count + 2)).tocsr()
    return int(maximum_flow(graph, count, count + 1).flow_value)


@settings(max_examples=150)
@given(
    st.tuples(st.integers(1, 12), st.integers(1, 12)),
    st.integers(0, 10**6),
    st.sampled_from([2, 4, 1000]),
    st.sampled_from([0.1, 0.5, 1.0]),
    st.sampled_from([0.0, 0.2]),
)
def test_the_cut_costs_what_the_largest_flow_carries(
    shape: tuple[int, int], seed: int, largest: int, dense: float, hard: float
) -> None:
    """On random grids, also with ties and pixels tied to a side, the cut equals the maximum flow."""
    made = problem(shape, seed, largest, dense, hard)
    assert cut_value(minimum_cut(*made), *made) == flow(*made)


def test_a_large_grid_is_cut_exactly() -> None:
    """The cut equals the maximum flow on a grid as large as a patch."""
    links, source, sink = problem((60, 70), 3, 256, 1.0)
    source[:], sink[:] = 0, 0
    source[:, 0], sink[:, -1] = np.inf, np.inf
    made = links, source, sink
    assert cut_value(minimum_cut(*made), *made) == flow(*made)


@pytest.mark.parametrize("shape", [(3, 3), (2, 4), (1, 5)])
@pytest.mark.parametrize("seed", range(8))
def test_no_labeling_costs_less(shape: tuple[int, int], seed: int) -> None:
    """No labeling of a small grid costs less, and of the best ones the smallest is returned."""
    made = problem(shape, seed, 5, hard=0.1)
    labelings = [np.array(bits).reshape(shape) for bits in itertools.product([False, True], repeat=shape[0] * shape[1])]
    least = min(cut_value(mask, *made) for mask in labelings)
    found = minimum_cut(*made)
    assert cut_value(found, *made) == least
    assert found.sum() == min(mask.sum() for mask in labelings if cut_value(mask, *made) == least)


def graphcut_seam(old: Image, new: Image, fixed_old: Mask, fixed_new: Mask, squared: bool = False) -> Mask:
    """Return where the least visible seam shows the new picture."""
    costs = link_costs(old, new, squared)
    return cut_overlap(costs, np.zeros(costs.shape, np.float32), fixed_old, fixed_new)


def pictures(shape: tuple[int, int], seed: int) -> tuple[np.ndarray, np.ndarray, Mask, Mask]:
    """Return two random pictures, and the overlap's two sides."""
    rng = np.random.default_rng(seed)
    old, new = rng.random((2, *shape, 3)).astype(np.float32)
    column = np.arange(shape[1]) * np.ones((shape[0], 1))
    return old, new, column == 0, column == shape[1] - 1


MIDDLES = (np.array(bits).reshape(3, 2) for bits in itertools.product([False, True], repeat=6))
LABELINGS = [np.pad(middle, ((0, 0), (1, 1)), constant_values=((0, 0), (0, 1))) for middle in MIDDLES]
"""Every labeling of a 3 x 4 overlap: old at the left, new at the right."""


@pytest.mark.parametrize("squared", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_a_seam_is_the_least_visible_of_all(squared: bool, seed: int) -> None:
    """No labeling of a 3 x 4 overlap costs less, with the cost of each link written out."""
    old, new, fixed_old, fixed_new = pictures((3, 4), seed)
    gradients = [[np.gradient(picture.astype(float), axis=axis) for axis in (0, 1)] for picture in (old, new)]

    def link(s: tuple[int, int], t: tuple[int, int]) -> float:
        cost = sum(float(np.linalg.norm(old[p].astype(float) - new[p])) for p in (s, t))
        axis = 0 if s[1] == t[1] else 1
        busy = sum(float(np.linalg.norm(slopes[axis][p])) for slopes in gradients for p in (s, t))
        return (cost**2 if squared else cost) / (busy + 1 / 255)

    def cost(mask: Mask) -> float:
        pairs = [((y, x), (y, x + 1)) for y in range(3) for x in range(3)]
        pairs += [((y, x), (y + 1, x)) for y in range(2) for x in range(4)]
        return sum(link(s, t) for s, t in pairs if mask[s] != mask[t])

    found = graphcut_seam(old, new, fixed_old, fixed_new, squared)
    assert not found[fixed_old].any() and found[fixed_new].all()
    assert cost(found) == pytest.approx(min(map(cost, LABELINGS)), rel=1e-6)


def test_a_seam_follows_a_planted_path_where_the_pictures_agree() -> None:
    """Two pictures that agree only along a zigzag are cut along it, at no cost."""
    rng = np.random.default_rng(0)
    old, new, fixed_old, fixed_new = pictures((40, 20), 1)
    path = np.clip(10 + np.cumsum(rng.integers(-1, 2, 40)), 2, 17)
    for row, column in enumerate(path):
        new[row, column - 1 : column + 2] = old[row, column - 1 : column + 2]
    found = graphcut_seam(old, new, fixed_old, fixed_new)
    np.testing.assert_array_less(np.abs(20 - found.sum(1) - path), 3)
    costs = link_costs(old, new, False)
    assert costs[0, :, :-1][found[:, 1:] != found[:, :-1]].sum() == costs[1, :-1][found[1:] != found[:-1]].sum() == 0


def test_pictures_that_agree_keep_the_old() -> None:
    """If both pictures agree no seam costs anything, and only the pixels that must be new are new."""
    old, _, fixed_old, fixed_new = pictures((6, 9), 0)
    assert not link_costs(old, old, False).any()
    np.testing.assert_array_equal(graphcut_seam(old, old, fixed_old, fixed_new), fixed_new)


@pytest.mark.parametrize("seed", range(4))
def test_old_seams_are_covered_where_that_is_worth_it(seed: int) -> None:
    """No labeling costs less if old seams count where both their pixels stay."""
    old, new, fixed_old, fixed_new = pictures((3, 4), seed)
    links = link_costs(old, new, False)
    seams = (np.random.default_rng(seed).random((2, 3, 4)) * 2 * links).astype(np.float32)

    def cost(mask: Mask) -> float:
        total = 0.0
        for axis, (here, there) in enumerate(((mask[:, :-1], mask[:, 1:]), (mask[:-1], mask[1:]))):
            link, seam = (part[axis, : here.shape[0], : here.shape[1]] for part in (links, seams))
            total += float(link[here != there].sum() + seam[~here & ~there].sum())
        return total

    found = cut_overlap(links, seams, fixed_old, fixed_new)
    assert cost(found) == pytest.approx(min(map(cost, LABELINGS)), abs=1e-6)


fewer_examples = settings(max_examples=40)


def least_cut(error: NDArray[np.float64], overlap: int) -> float:
    """Return the least cost over every pair of paths that meet at a pixel of the corner, by exhaustive search."""
    return min(
        least_path(error, [(y, x)], overlap) + least_path(error.T, [(x, y)], overlap) - error[y, x]
        for y, x in itertools.product(range(overlap), repeat=2)
    )


@fewer_examples
@given(st.integers(2, 5), st.integers(2, 5), st.integers(1, 3), st.integers(0, 10_000), st.booleans())
def test_no_l_shaped_cut_is_cheaper(height: int, width: int, overlap: int, seed: int, ties: bool) -> None:
    """The cost of the cut equals that of an exhaustive search over all pairs of paths and all meeting pixels."""
    overlap = min(overlap, height, width)
    draw = np.random.default_rng(seed)
    error = draw.integers(0, 3, (height, width)).astype(float) if ties else draw.random((height, width))
    *_, cost = corner_paths(error, overlap, overlap)
    assert cost == pytest.approx(least_cut(error, overlap))


@fewer_examples
@given(st.integers(3, 8), st.integers(3, 8), st.integers(1, 4), st.integers(0, 10_000))
def test_the_patch_begins_on_the_cut(height: int, width: int, overlap: int, seed: int) -> None:
    """The patch's outermost pixels are on the paths: along each line that a path crosses, they cost what the cut costs.

    Errors of distinct powers of two show in the cost which pixels the paths consist of.
    """
    overlap = min(overlap, height, width)
    order = np.random.default_rng(seed).permutation(height * width).reshape(height, width)
    error = np.where(order < 50, 2.0 ** np.minimum(order, 50), 2.0**50)
    mask = find_paths(error, overlap, overlap).mask()
    *_, cost = corner_paths(error, overlap, overlap)
    assert mask[overlap:, overlap:].all()
    on_cut = {(y, int(mask[y].argmax())) for y in range(overlap, height)}
    on_cut |= {(int(mask[:, x].argmax()), x) for x in range(overlap, width)}
    assert sum(error[pixel] for pixel in on_cut) <= cost
    assert all(int(cost) & int(error[pixel]) for pixel in on_cut if error[pixel] < 2.0**50)


def test_a_cut_along_one_side_is_the_cheapest_path() -> None:
    """With one overlap the cut equals an exhaustive search, at the left and at the top."""
    rng = np.random.default_rng(4)
    for _ in range(10):
        error = rng.integers(0, 200_000, (6, 5)).astype(float)
        mask = find_paths(error, 3, 0).mask()
        first = mask.argmax(1)
        assert error[np.arange(6), first].sum() == least_path(error, ((0, x) for x in range(3)), 3)
        assert (np.abs(np.diff(first)) <= 1).all()
        np.testing.assert_array_equal(find_paths(np.ascontiguousarray(error.T), 0, 3).mask(), mask.T)
