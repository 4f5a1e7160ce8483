import math

import numpy as np
import pytest
from scipy import stats
from synthesis_cases import noise

from nrbench.errors import BadInput
from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Refused, Synthesis, Task
from nrbench.synthesizers.rectangular_tiles.wang_tiles import WangTiles, edge_colors
from nrbench.synthesizers.representative_tile import RepresentativeTile

LATTICE = Lattice((12, 0), (0, 10))


def synthesize(
    tiles: int, sample: Image, shape: tuple[int, int] = (80, 96), lattice: Lattice = LATTICE, seed: int = 1
) -> Synthesis:
    """Run the method."""
    return RepresentativeTile(tiles=tiles).synthesize(Task(sample, shape, lattice, np.random.default_rng(seed)))


def test_there_are_edge_colors_all_numbers_but_few() -> None:
    """Each pair of a north and a west color has two tiles, no two of the set the same four; 1, 2, 3 and 5 cannot."""
    assert [k for k in range(1, 200) if edge_colors(k) is None] == [1, 2, 3, 5]
    for tiles in [*range(6, 200), 4]:
        colors = edge_colors(tiles)
        assert colors is not None and 2 * math.prod(colors) <= tiles <= math.prod(colors) ** 2
    assert (edge_colors(8), edge_colors(18)) == ((2, 2), (3, 3))


@pytest.mark.parametrize("tiles", [-4, 0, 2, 3, 5, 1001, 10**18])
def test_other_numbers_of_tiles_are_refused(tiles: int) -> None:
    """No time is spent on a number that no output can show."""
    with pytest.raises(BadInput, match=f"tiles {tiles}; choose 1, 4, or 6 to 1000"):
        RepresentativeTile(tiles=tiles)


@pytest.mark.parametrize("tiles", [4, 6, 7, 8, 12, 16, 18])
def test_a_set_has_as_many_tiles_as_asked_and_each_corner_has_two(tiles: int) -> None:
    """No two tiles have the same edges, and every pair of a north and a west color has at least two of them."""
    edges = synthesize(tiles, noise(60, 72)).extras["edges"]
    assert len(np.unique(edges, axis=0)) == len(edges) == tiles
    pairs = np.unique(edges[:, [0, 3]], axis=0, return_counts=True)[1]
    colors = edge_colors(tiles)
    assert colors is not None and len(pairs) == math.prod(colors) and pairs.min() >= 2


def test_edges_of_equal_colors_show_the_same_piece() -> None:
    """Tiles with one north color have the same first row; along all borders neighbors are the sample's neighbors."""
    made = synthesize(16, noise(60, 72))
    tiles, north = [made.extras[f"tile-{k:02d}"] for k in range(1, 17)], made.extras["edges"][:, 0]
    rows = [{tile[0].tobytes() for tile, edge in zip(tiles, north, strict=True) if edge == color} for color in (0, 1)]
    assert len(rows[0]) == len(rows[1]) == 1 and rows[0] != rows[1]
    assert made.source is not None
    down, right = (np.diff(made.source[..., :2], axis=axis) for axis in (0, 1))
    joined = [(down == (0, 1)).all(-1), (right == (1, 0)).all(-1)]
    assert max(joined[0][row::10].mean() for row in range(10)) == 1
    assert max(joined[1][:, column::12].mean() for column in range(12)) >= 0.8


def test_neighbors_agree_in_their_colors_and_choice_is_uniform() -> None:
    """South meets north, east meets west, and each tile that fits is drawn equally often."""
    edges = np.array([(n, e, s, w) for n in (0, 1) for e in (0, 1) for s in (0, 1) for w in (0, 1)])
    tiles = WangTiles(np.zeros((16, 4, 4, 2)), edges, (0, 0))
    laid = tiles.lay_out((60, 70), np.random.default_rng(0))
    north, east, south, west = np.moveaxis(edges[laid], -1, 0)
    assert (south[:-1] == north[1:]).all() and (east[:, :-1] == west[:, 1:]).all()
    assert stats.chisquare(np.bincount(laid.ravel(), minlength=16)).pvalue > 1e-3


@pytest.mark.parametrize("lattice", [LATTICE, Lattice((12, 0), (6, 10)), Lattice((12.4, 0), (0, 10.3))])
def test_the_lattice_continues_through_all_tiles(lattice: Lattice) -> None:
    """Every pixel comes from a place equivalent to its own, within half a pixel."""
    made = synthesize(8, noise(90, 96), (150, 160), lattice)
    assert made.source is not None
    y, x = np.indices((150, 160))
    assert np.abs(lattice.wrap(made.source[..., :2] - np.stack([x, y], -1))).max() <= 0.5 + 1e-4
    assert len(np.unique(np.rint(made.source[..., :2]).reshape(-1, 2), axis=0)) > 2 * lattice.area


def test_on_a_periodic_sample_it_is_the_continuation() -> None:
    """On a periodic sample all pieces are equal, and the output is its continuation, to the bit."""
    picture = np.tile(noise(10, 12), (20, 20, 1))
    made = synthesize(8, picture[:60, :72], (130, 170))
    np.testing.assert_array_equal(quantize(made.image), picture[:130, :170])


def test_a_set_shows_more_than_one_tile_does() -> None:
    """Randomness survives in part: the output does not repeat at the lattice's vectors, as that of one tile does."""
    sample = noise(60, 72)
    several, one = (synthesize(tiles, sample).image for tiles in (8, 1))
    np.testing.assert_allclose(one[10:], one[:-10], atol=1e-6)
    assert np.abs(several[10:] - several[:-10]).mean() > 0.05


def test_tiles_are_cut_where_there_are_enough_pieces() -> None:
    """On a sample that holds two pieces an edge in some phases, but not in all, a set is found all the same."""
    for seed in range(12):
        assert len(synthesize(8, noise(24, 29, seed=seed), (20, 20), seed=seed).extras["edges"]) == 8


def test_samples_with_too_few_pieces_are_refused() -> None:
    """The refusal says how many there are, and what to do."""
    with pytest.raises(Refused, match="choose fewer tiles"):
        synthesize(32, noise(21, 25))
    with pytest.raises(Refused, match="choose tiles=1"):
        synthesize(8, noise(40, 40), lattice=Lattice((5, 0), (0, 9)))


def test_the_same_stream_gives_the_same_bytes_and_another_does_not() -> None:
    """All randomness is the task's."""
    first, second, other = (synthesize(8, noise(60, 72), seed=k).image for k in (1, 1, 2))
    np.testing.assert_array_equal(first, second)
    assert (first != other).any()


def test_a_sample_without_a_whole_piece_is_refused() -> None:
    """A long slanted tile leaves no room around its edges: the refusal says so, and what to do."""
    with pytest.raises(Refused, match=r"0 and 0 whole pieces .* choose fewer tiles"):
        synthesize(4, noise(96, 96), (41, 97), Lattice((30, 4), (28, 10)))
