import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from nrbench.synthesizers.gap_filling.blocks import OWN, BlockGrid, Sides, gap_border
from nrbench.synthesizers.gap_filling.canvas import compose
from nrbench.synthesizers.sampling.patches import Patches

ALL: Sides = (True, True, True, True)
sides = st.tuples(*[st.booleans()] * 4)


def test_blocks_alternate_like_a_chess_board() -> None:
    """Placed blocks and gaps share the grid, and no two of a kind are neighbors."""
    grid = BlockGrid((90, 170), 40, 10)
    assert grid.counts == (3, 5)
    placed, gaps = ({(block.row, block.column) for block in kind} for kind in (grid.placed(), grid.gaps()))
    assert len(placed | gaps) == 15
    assert not placed & gaps
    for row, column in gaps:
        assert {(row, column - 1), (row - 1, column), (row, column + 1), (row + 1, column)} <= placed | {
            (r, c) for r in range(-1, 4) for c in range(-1, 6) if not (0 <= r < 3 and 0 <= c < 5)
        }


@given(sides)
def test_the_border_is_what_lies_near_a_neighbor(there: Sides) -> None:
    """The gap consists of border and hole: border pixels are less than 10 px from a neighbor's block."""
    border = gap_border(40, 10, there)
    rows, columns = np.indices((40, 40))
    distances = np.stack([columns, rows, 39 - columns, 39 - rows])
    near = (distances[np.array(there)] < 10).any(0) if any(there) else np.zeros((40, 40), bool)
    marked = np.zeros((40, 40), bool)
    marked[border.pixels[:, 1], border.pixels[:, 0]] = True
    np.testing.assert_array_equal(marked, near)
    y0, y1, x0, x1 = border.hole
    marked[y0:y1, x0:x1] = True
    assert marked.all()
    assert len(border.pixels[:, 1]) + (y1 - y0) * (x1 - x0) == 1600


@given(sides)
def test_each_wedge_belongs_to_the_nearest_neighbor(there: Sides) -> None:
    """The owner of a border pixel is the nearest side that has a neighbor: the corners' diagonals divide."""
    border = gap_border(40, 10, there)
    distances = np.stack(
        [border.pixels[:, 0], border.pixels[:, 1], 39 - border.pixels[:, 0], 39 - border.pixels[:, 1]]
    ).astype(float)
    distances[~np.array(there)] = np.inf
    np.testing.assert_array_equal(distances[border.owner, np.arange(len(border.owner))], distances.min(0))


@given(sides)
def test_weights_sum_to_one_and_draw_on_neighbors_that_are_there(there: Sides) -> None:
    """Blending is a partition of unity over the gap's own patch and existing neighbors."""
    border = gap_border(24, 7, there)
    np.testing.assert_allclose(border.weights.sum(0), 1, atol=1e-6)
    assert (border.weights >= 0).all()
    used = np.unique(border.layers[border.weights > 0])
    assert all(layer == OWN or there[layer] for layer in used)


def test_the_gaps_own_patch_fades_in_linearly() -> None:
    """Along the middle of a side the alpha rises by one tenth a pixel over a 10 px border."""
    border = gap_border(40, 10, ALL)
    middle = (border.pixels[:, 1] == 20) & (border.pixels[:, 0] < 10)
    np.testing.assert_allclose(border.weights[0, middle], (np.arange(10) + 0.5) / 10, atol=1e-6)


def test_squares_of_placed_blocks_are_untouched_copies() -> None:
    """The square of a placed block is a copy with weight 1."""
    rng = np.random.default_rng(1)
    sample = rng.random((60, 60, 1), np.float32)
    grid = BlockGrid((64, 64), 16, 6)
    places = rng.integers(6, 38, (4, 4, 2))
    image, source = compose(Patches(sample), grid, places.astype(float))
    for block in grid.placed():
        x, y = places[block.row, block.column]
        window = np.s_[block.row * 16 : block.row * 16 + 16, block.column * 16 : block.column * 16 + 16]
        np.testing.assert_array_equal(image[window], sample[y : y + 16, x : x + 16])
        assert (source[window][..., 2] == 1).all()
    x, y, weight = np.moveaxis(source, -1, 0)
    copied = weight == 1
    np.testing.assert_array_equal(image[copied], sample[y[copied].astype(int), x[copied].astype(int)])
