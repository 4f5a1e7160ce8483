"""Claims about the cuts of a patch into what it overlaps: along one side, and in the shape of an L."""

import itertools
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from nrbench.synthesizers.seams.overlap_seam import cut_sides, l_shaped_seam

fewer_examples = settings(max_examples=40)
Pixel = tuple[int, int]


def upward_paths(start: Pixel, rows: int, width: int) -> Iterator[list[Pixel]]:
    """Yield every path from a pixel down to the last row, in columns below ``width``."""
    y, x = start
    if y == rows - 1:
        yield [start]
        return
    for step in (-1, 0, 1):
        if 0 <= x + step < width:
            for rest in upward_paths((y + 1, x + step), rows, width):
                yield [start, *rest]


def least_cut(error: NDArray[np.float64], overlap: int) -> float:
    """Return the least cost over every pair of paths that meet at a pixel of the corner, by exhaustive search."""
    height, width = error.shape
    costs = []
    for meeting in itertools.product(range(overlap), repeat=2):
        down = min(sum(error[pixel] for pixel in path) for path in upward_paths(meeting, height, overlap))
        level = min(
            sum(error[x, y] for y, x in path) for path in upward_paths((meeting[1], meeting[0]), width, overlap)
        )
        costs.append(down + level - error[meeting])
    return float(min(costs))


@fewer_examples
@given(st.integers(2, 5), st.integers(2, 5), st.integers(1, 3), st.integers(0, 10_000), st.booleans())
def test_no_l_shaped_cut_is_cheaper(height: int, width: int, overlap: int, seed: int, ties: bool) -> None:
    """The cost of the cut equals that of an exhaustive search over all pairs of paths and all meeting pixels."""
    overlap = min(overlap, height, width)
    draw = np.random.default_rng(seed)
    error = draw.integers(0, 3, (height, width)).astype(float) if ties else draw.random((height, width))
    _, cost = l_shaped_seam(error, overlap)
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
    mask, cost = l_shaped_seam(error, overlap)
    assert mask[overlap:, overlap:].all()
    on_cut = {(y, int(mask[y].argmax())) for y in range(overlap, height)}
    on_cut |= {(int(mask[:, x].argmax()), x) for x in range(overlap, width)}
    assert sum(error[pixel] for pixel in on_cut) <= cost
    assert all(int(cost) & int(error[pixel]) for pixel in on_cut if error[pixel] < 2.0**50)


def test_an_l_shaped_cut_follows_a_free_path() -> None:
    """Where an L of zeros leads through the overlap, the cut is that L."""
    error = np.ones((9, 9))
    error[2, 3:] = error[3:, 3] = error[2, 3] = 0
    mask, cost = l_shaped_seam(error, 5)
    expected = np.zeros((9, 9), bool)
    expected[2:, 3:] = True
    assert cost == 0
    np.testing.assert_array_equal(mask, expected)


@pytest.mark.parametrize("channels", [1, 3])
def test_a_cut_along_one_side_is_the_cheapest_path(channels: int) -> None:
    """With one overlap the cut equals an exhaustive search over the squared differences, at the left and at the top."""
    rng = np.random.default_rng(4)
    for _ in range(10):
        old, new = rng.integers(0, 256, (2, 6, 5, channels), dtype=np.uint8)
        error = ((old.astype(float) - new) ** 2).sum(-1)
        least = min(sum(error[pixel] for pixel in path) for x in range(3) for path in upward_paths((0, x), 6, 3))
        mask = cut_sides(old, new, 3, left=True, top=False)
        first = mask.argmax(1)
        assert error[np.arange(6), first].sum() == least
        assert (np.abs(np.diff(first)) <= 1).all()
        turned = cut_sides(old.swapaxes(0, 1), new.swapaxes(0, 1), 3, left=False, top=True)
        np.testing.assert_array_equal(turned, mask.T)


def test_a_patch_without_overlap_is_shown_whole() -> None:
    """The first patch covers its spot."""
    assert cut_sides(*np.zeros((2, 4, 4, 1), np.uint8), 2, left=False, top=False).all()
