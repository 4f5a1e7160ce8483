"""Claims about the grid of blocks, the canvas of placed blocks and filled gaps, and the search for what fits a gap."""

import math
from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from synthesis_cases import noise

from nrbench.imaging.convert import Image, quantize, to_bytes
from nrbench.synthesizers.canvas.canvas import Box, Mask, Sides, cut_closed_seam, edge_mask
from nrbench.synthesizers.gap_filling.blocks import OWN, BlockGrid, BlockPlacer, SeamMethod, cut_paths, gap_border
from nrbench.synthesizers.matching.frame_matching import FrameMatcher, Match, align_patch, fit_deformation
from nrbench.synthesizers.sample_reading.patches import Patches

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
        assert not {(row, column - 1), (row - 1, column), (row, column + 1), (row + 1, column)} & gaps


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
    distances = np.concatenate([border.pixels, 39 - border.pixels], 1).T.astype(float)
    distances[~np.array(there)] = np.inf
    owner = border.owners[border.pixels[:, 1], border.pixels[:, 0]]
    np.testing.assert_array_equal(distances[owner, np.arange(len(owner))], distances.min(0))


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


SEAMS = get_args(SeamMethod)


def test_a_blended_patch_stays_in_its_gap_and_a_cut_one_does_not() -> None:
    """Blending leaves placed blocks unchanged; seams may run into them, but not beyond their middles."""
    changed = {}
    for seam in SEAMS:
        placer = BlockPlacer(Patches(noise(60, 60)), BlockGrid((48, 48), 16, 5), seam)
        rng, canvas = np.random.default_rng(1), placer.canvas
        for block in placer.grid.placed():
            placer.place_block(block, rng.uniform(5, 39, 2))
        placer.extend_placed()
        before = canvas.image.copy()
        for gap in placer.grid.gaps():
            placer.fill_gap(gap, rng.uniform(0, 44, 2))
        moved = (canvas.image != before).any(-1)
        changed[seam] = sum(int(moved[canvas.pixels(block.window())].sum()) for block in placer.grid.placed())
        assert not moved[canvas.pixels((24, 25, 24, 25))].any()
    assert changed["blend"] == 0
    assert changed["graphcut"] > 0 and changed["quilting"] > 0


def joint(shape: tuple[int, int], sides: Sides = ALL, depth: int = 16) -> tuple[Mask, tuple[Mask, Mask]]:
    """Return what is known under a patch over a gap of 24 px, and which pixels must stay and must be new.

    Its border is 8 px wide, and the patch reaches 8 px beyond the gap on the sides that have neighbors.
    """
    known = np.ones(shape, np.bool_)
    left, top, right, bottom = (depth if there else 0 for there in sides)
    known[top : shape[0] - bottom, left : shape[1] - right] = False
    return known, (edge_mask(shape, sides), ~known)


def nothing(shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return the seams of a picture that has none."""
    return np.zeros((2, *shape[:2]), np.float32)


SIDES = [ALL, (False, True, True, False), (True, False, False, False), (False, False, True, True)]


@pytest.mark.parametrize("sides", SIDES)
def test_the_hole_is_new_and_the_edge_beside_a_neighbor_old(sides: tuple[bool, bool, bool, bool]) -> None:
    """Everything unknown becomes new, and a graph cut leaves the box's edge beside a neighbor old."""
    height, width = 24 + 8 * (sides[1] + sides[3]), 24 + 8 * (sides[0] + sides[2])
    old, new = np.random.default_rng(0).random((2, height, width, 3)).astype(np.float32)
    known, fixed = joint((height, width), sides)
    mask = cut_closed_seam(old, new, known, fixed, nothing(old.shape))
    assert mask[~known].all()
    assert not mask[fixed[0]].any()
    assert not mask.all()


ROW, COLUMN = np.indices((40, 40))[0] // 8, np.indices((40, 40))[1]
INSIDE = (np.indices((40, 40))[0] % 8 >= 2) & ((COLUMN + 6 * (ROW % 2)) % 12 >= 2)
BRICK = ROW * 6 + (COLUMN + 6 * (ROW % 2)) // 12
"""The numbers of bricks of 10 x 6 px with joints of 2 px, and the pixels inside of them."""


def bricks(rng: np.random.Generator) -> Image:
    """Return bricks with different tones, and weak noise."""
    tones = np.where(INSIDE, 0.4 + 0.2 * rng.random(30)[BRICK], 0.9)
    return (tones + 0.01 * rng.standard_normal((40, 40)))[..., np.newaxis].astype(np.float32)


def test_a_graph_cut_runs_around_bricks() -> None:
    """A graph cut between two walls with equal bricks of different tones leaves no brick two-toned."""
    rng = np.random.default_rng(3)
    for _ in range(5):
        old, new = bricks(rng), bricks(rng)
        mask = cut_closed_seam(old, new, *joint((40, 40)), nothing(old.shape))
        shares = np.array([mask[INSIDE & (which == BRICK)].mean() for which in np.unique(BRICK[INSIDE])])
        assert (np.minimum(shares, 1 - shares) < 0.1).all()


def test_recorded_seams_follow_the_cut() -> None:
    """After a cut the recorded seams are those of the joined picture."""
    old, new = np.random.default_rng(1).random((2, 40, 40, 3)).astype(np.float32)
    seams = nothing(old.shape)
    seams[0, 20, 19], seams[0, 1, 1] = 5.0, 3.0
    mask = cut_closed_seam(old, new, *joint((40, 40)), seams)
    changes = mask[:, 1:] != mask[:, :-1]
    across = seams[0, :, :-1]
    assert across[20, 19] == 0
    assert (across[changes] > 0).all()
    assert across[~changes].sum() in (0.0, 3.0)


def test_quilting_paths_follow_the_pixels_that_agree() -> None:
    """Where two pictures agree along a rectangle around the hole alone, the patch is shown inside it."""
    old = np.zeros((40, 40, 1), np.float32)
    new = np.ones_like(old)
    new[5, 4:37] = new[33, 4:37] = new[5:34, 4] = new[5:34, 36] = 0
    mask = np.zeros((40, 40), np.bool_)
    mask[5:34, 4:37] = True
    np.testing.assert_array_equal(cut_paths(old, new, np.ones_like(mask), (12, 28, 12, 28)), mask)


SIZE = 9
HOLES: list[Box] = [(3, 6, 3, 6), (0, 6, 3, 9), (2, 2, 4, 4)]


def cut(image: Image, x: int, y: int) -> NDArray[np.float32]:
    """Return a patch as whole numbers."""
    return to_bytes(image)[y : y + SIZE, x : x + SIZE].astype(np.float32)


def counted(patch: NDArray[np.float32], hole: Box) -> NDArray[np.float64]:
    """Return the pixels of a patch outside the hole, by naive loops: (n, C)."""
    y0, y1, x0, x1 = hole
    rows = range(SIZE)
    return np.array([patch[y, x] for y in rows for x in rows if not (y0 <= y < y1 and x0 <= x < x1)], np.float64)


def naive(patch: NDArray[np.float32], template: NDArray[np.float32], hole: Box, match: Match) -> float:
    """Rate by equation 10 (negated), or equations 3 and 6, as they stand."""
    f, g = counted(patch, hole), counted(template, hole)
    if match == "color":
        return -float(((f - g) ** 2).sum())
    f, g = f - f.mean(0), g - g.mean(0)
    sigma_f, sigma_g = np.sqrt((f**2).sum(0)), np.sqrt((g**2).sum(0))
    gamma = (f * g).sum(0) / (sigma_f * sigma_g)
    return float((gamma * sigma_f * sigma_g).sum() / (sigma_f * sigma_g).sum())


@pytest.mark.parametrize("match", ["ncc", "color"])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("hole", HOLES)
def test_ratings_equal_brute_force(match: Match, channels: int, hole: Box) -> None:
    """Both matches equal naive loops at every place."""
    image, other = noise(21, 17, channels), noise(21, 17, channels, seed=1)
    matcher = FrameMatcher(image, SIZE, match)
    template = cut(other, 3, 5)
    rows, columns = matcher.search_shape
    expected = [[naive(cut(image, x, y), template, hole, match) for x in range(columns)] for y in range(rows)]
    positions = np.argwhere(np.ones((rows, columns)))[:, ::-1]
    some = matcher.rate(template, hole, positions).reshape(rows, columns)
    np.testing.assert_allclose(some, expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(some, matcher.rate_everywhere(template, hole))


def test_ncc_ignores_brightness_and_contrast_and_color_does_not() -> None:
    """A darker, flatter template still correlates perfectly, but differs in color."""
    image = noise(20, 20, 1)
    image = quantize(np.rint(image * 100) * 2 / 255)
    template = cut(image, 4, 6) / 2
    here = np.array([[4, 6]])
    assert FrameMatcher(image, SIZE, "ncc").rate(template, (3, 6, 3, 6), here)[0] == pytest.approx(1)
    assert FrameMatcher(image, SIZE, "color").rate(template, (3, 6, 3, 6), here)[0] < 0


def test_a_flat_border_rates_zero_by_ncc() -> None:
    """Where nothing varies there is no correlation, and no warning."""
    image = np.full((20, 20, 1), 0.4, np.float32)
    assert not FrameMatcher(image, SIZE, "ncc").rate_everywhere(cut(image, 0, 0), (3, 6, 3, 6)).any()


def test_runs_too_long_for_float32_are_summed_exactly() -> None:
    """White frames of 400 px, whose rows sum to more than 2^24, match without a rounding error."""
    image = np.ones((410, 410, 3), np.float32)
    matcher = FrameMatcher(image, 400, "color")
    template = np.full((400, 400, 3), 255, np.float32)
    assert matcher.rate(template, (10, 390, 10, 390), np.array([[3, 5]]))[0] == 0


Y, X = np.indices((48, 48)).astype(float)
FRAME = np.ones((48, 48))
FRAME[14:34, 14:34] = 0


def texture(x: np.ndarray, y: np.ndarray) -> Image:
    """Return a texture of lines both ways, at any place."""
    waves = np.cos(2 * math.pi * x / 9.3) + np.cos(2 * math.pi * (y + 0.2 * x) / 8.1) + np.cos(0.9 * (x - y))
    return (0.5 + 0.15 * waves)[..., np.newaxis].astype(np.float32)


@pytest.mark.parametrize("off", [(0.4, -0.3), (-0.8, 0.7), (0.0, 0.05)])
def test_a_patch_is_moved_to_where_it_meets(off: tuple[float, float]) -> None:
    """A place that is off by up to a pixel is corrected to 0.02 px, by the frame alone."""
    old = texture(X + 5, Y + 7)
    place = np.add((5.0, 7.0), off)
    for _ in range(3):
        place = align_patch(lambda at: texture(X + at[0], Y + at[1]), place, old, FRAME)
    np.testing.assert_allclose(place, (5, 7), atol=0.02)


def test_equal_and_flat_pictures_move_nothing() -> None:
    """They give no displacement, not even a rounding error; flat ones neither if they differ in brightness."""
    flat = np.full((48, 48, 1), 0.3, np.float32)
    for old, new in ((texture(X, Y), texture(X, Y)), (flat, flat + 0.1)):
        assert align_patch(lambda at, new=new: new, np.array([3.0, 4.0]), old, FRAME).tolist() == [3, 4]


BULGE = 1.5 * np.stack([np.cos(math.pi * (Y + 0.5) / 48), np.cos(math.pi * (X + 0.5) / 48)], -1)
"""A smooth displacement of up to 1.5 px along x and along y."""


def moved(field: NDArray[np.float64]) -> Image:
    """Return the texture under a displacement of each pixel."""
    return texture(X + field[..., 0], Y + field[..., 1])


def test_a_deformation_is_found_by_the_frame_alone() -> None:
    """A smooth displacement is found to 0.1 px, also inside the hole; the limit shortens it."""
    found = fit_deformation(moved, moved(BULGE), FRAME, 3)
    assert np.abs(found - BULGE).max() < 0.1
    assert np.hypot(*np.moveaxis(fit_deformation(moved, moved(BULGE), FRAME, 0.5), -1, 0)).max() <= 0.5 + 1e-9


def test_nothing_deforms_where_nothing_differs_or_nothing_is_seen() -> None:
    """Equal pictures, flat pictures of other brightness, and a frame without weight give no displacement."""
    old = moved(np.zeros_like(BULGE))
    for new, weight in ((old, FRAME), (np.full_like(old, 0.1), FRAME), (old[::-1], 0 * FRAME)):
        assert not fit_deformation(lambda _, new=new: new, old, weight, 3).any()
