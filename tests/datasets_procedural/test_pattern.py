"""Claims about patterns: coordinates, shapes, shades, threads, and layers of elements."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nrbench.datasets_procedural.modelling.pattern import (
    Field,
    Frame,
    Layer,
    Pattern,
    bevel,
    box,
    boxes,
    capsule,
    coverage,
    disc,
    hats,
    hexagon,
    honeycomb,
    hue_rotation,
    interlace,
    lozenge,
    mix,
    rim,
    round_profile,
    rows,
    split_period,
    stripe,
)
from nrbench.datasets_procedural.weave import Weave
from nrbench.lattice.geometry import Lattice


@given(st.floats(-720, 720), st.floats(-50, 50), st.floats(-50, 50))
def test_frame_and_vector_agree(rotation: float, ox: float, oy: float) -> None:
    """A pixel's model coordinates, turned back into the picture and moved to the origin, are the pixel."""
    frame = Frame((ox, oy), rotation)
    x, y = frame.grid((3, 4))
    back = frame.vector((x[2, 3], y[2, 3]))
    assert (back[0] + ox, back[1] + oy) == pytest.approx((3, 2), abs=1e-9)


def test_right_angles_are_exact() -> None:
    """A turn by 90 degrees exchanges the axes without rounding."""
    assert Frame(rotation=90.0).vector((3.0, 0.0)) == (0.0, 3.0)
    assert Frame(rotation=-90.0).vector((3.0, 0.0)) == (0.0, -3.0)


def test_split_period() -> None:
    """Points go to the nearest multiple of the period, and keep their signed distance from it."""
    index, rest = split_period(np.array([-7.0, 0, 4, 14]), 10)
    assert index.tolist() == [-1, 0, 0, 1] and rest.tolist() == [3, 0, 4, 4]


@pytest.mark.parametrize("name", ["rows", "honeycomb"])
def test_index_is_the_lattice_coordinate(name: str) -> None:
    """The cell's index times the generating vectors, plus the local coordinates, is the point; it lies in its cell."""
    x, y = np.random.default_rng(0).uniform(-90, 90, (2, 2000))
    if name == "rows":
        (i, j), (dx, dy) = rows(x, y, 20.0, 9.0, 0.5)
        lattice = Lattice((20, 0), (10, 9))
        assert np.abs(dx).max() <= 10 and np.abs(dy).max() <= 4.5
    else:
        (i, j), (dx, dy) = honeycomb(x, y, 14.0)
        lattice = Lattice((14, 0), (7, 7 * math.sqrt(3)))
        np.testing.assert_allclose(np.stack([dx, dy], -1), lattice.wrap(np.stack([x, y], -1)), atol=1e-9)
    there = lattice.from_cell(np.stack([i, j], -1)) + np.stack([dx, dy], -1)
    np.testing.assert_allclose(there, np.stack([x, y], -1), atol=1e-9)


def test_boxes() -> None:
    """A row of boxes of 10 and 4 px: which box, how far from its middle, how wide; the first one's middle is at 0."""
    which, aside, width = boxes(np.array([0.0, 4.9, 5.5, 7, 9.5, 14, -5.5]), (10.0, 4.0))
    assert which.tolist() == [0, 0, 1, 1, 2, 2, -1] and width.tolist() == [10, 10, 4, 4, 10, 10, 4]
    np.testing.assert_allclose(aside, [0, 4.9, -1.5, 0, -4.5, 0, 1.5])


def test_hats_are_a_partition() -> None:
    """The four whole points around a point have weights that add up to 1, and their mean is the point."""
    u, v = np.random.default_rng(0).uniform(-9, 9, (2, 500))
    found = hats(u, v)
    assert sum(weight for _, weight in found) == pytest.approx(np.ones(500))
    for k, part in enumerate((u, v)):
        np.testing.assert_allclose(sum(index[k] * weight for index, weight in found), part, atol=1e-12)
    for (i, j), _ in found:
        assert len(np.unique(i % 2)) == len(np.unique(j % 2)) == 1


def test_margin_and_displacement() -> None:
    """A margin adds pixels on every side; content that moved by (2, -1) comes from that much to the left and below."""
    frame = Frame((1.5, -0.5), 30.0)
    x, y = frame.grid((4, 5))
    wide = frame.grid((4, 5), margin=2)
    np.testing.assert_array_equal(wide[0][2:-2, 2:-2], x)
    moved = frame.grid((4, 5), moved=np.broadcast_to([2.0, -1.0], (4, 5, 2)))
    np.testing.assert_allclose(moved[0][:3, 2:], x[1:, :3])
    np.testing.assert_allclose(moved[1][:3, 2:], y[1:, :3])


CORNER = 10 / math.sqrt(3)
DISTANCES: list[tuple[Callable[[Field, Field], Field], list[tuple[float, float]], list[float]]] = [
    (lambda x, y: box(x, y, 10, 6), [(0, 0), (5, 0), (8, 0), (8, 7), (0, 3)], [-3, 0, 3, 5, 0]),
    (lambda x, y: box(x, y, 10, 6, radius=1), [(0, 0), (5, 0), (8, 7)], [-3, 0, math.hypot(4, 5) - 1]),
    (
        lambda x, y: hexagon(x, y, 10),
        [(0, 0), (5, 0), (7, 0), (0, CORNER), (0, CORNER + 2), (2.5, 2.5 * math.sqrt(3))],
        [-5, 0, 2, 0, 2, 0],
    ),
    (lambda x, y: stripe(x, 4), [(0, 0), (-2, 9), (5, 0)], [-2, 0, 3]),
    (lambda x, y: disc(x, y, 6), [(0, 0), (3, 0), (4, 3)], [-3, 0, 2]),
    (lambda x, y: capsule(x, y, 10, 4), [(0, 0), (5, 0), (3, 2), (7, 0)], [-2, 0, 0, 2]),
    (lambda x, y: lozenge(x, y, 8, 6), [(0, 0), (4, 0), (0, 3), (2, 1.5)], [-2.4, 0, 0, 0]),
]


@pytest.mark.parametrize(("shape", "points", "distances"), DISTANCES)
def test_known_distances(
    shape: Callable[[Field, Field], Field], points: list[tuple[float, float]], distances: list[float]
) -> None:
    """Shapes have known distances at their centers, sides, corners and tips, negative inside."""
    np.testing.assert_allclose(shape(*np.array(points, np.float64).T), distances, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 17.0, 45.0])
@pytest.mark.parametrize("shape", ["box", "hexagon"])
def test_coverage_is_the_area_covered(shape: str, angle: float) -> None:
    """At any angle the share of each pixel agrees with one counted over 256 points in it."""

    def distance(x: Field, y: Field) -> Field:
        cos, sin = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        along, across = x * cos + y * sin, y * cos - x * sin
        return box(along, across, 15.3, 9.1) if shape == "box" else hexagon(along, across, 13.7)

    y, x = np.indices((30, 30)) - 14.6
    fine = (np.indices((480, 480)) + 0.5) / 16 - 0.5 - 14.6
    counted = (distance(fine[1], fine[0]) < 0).reshape(30, 16, 30, 16).mean((1, 3))
    error = coverage(distance(x, y)) - counted
    assert np.abs(error).max() < 0.25 and np.sqrt((error**2).mean()) < 0.02 and abs(error.sum()) < 0.01 * counted.sum()


def test_rim_and_profile() -> None:
    """A rim is darkest at the edge; a round thread is lightest in the middle, and never under its depth."""
    assert rim(np.array([0.0, -50]), 0.2, 1.5) == pytest.approx((0.8, 1.0))
    assert round_profile(np.array([0.0, 3, 5, 9]), 10, 0.4) == pytest.approx((1.0, 0.92, 0.6, 0.6))


def test_bevel_is_lit_from_the_upper_left() -> None:
    """On its edge an element is lighter towards the upper left and darker opposite; its middle keeps its color."""
    x, y = np.array([-1.0, 1, 1, 0]), np.array([-1.0, 1, -1, 0])
    assert bevel(np.array([0.0, 0, 0, -99]), x, y, 0.2, 2.0) == pytest.approx((1.2, 0.8, 1.0, 1.0))


def test_mix() -> None:
    """A quarter of white over black is a dark gray."""
    np.testing.assert_allclose(mix(np.array([[0.25]]), (0.0, 0, 0), (1.0, 1, 1)), [[[0.25] * 3]])


def test_hue_turns() -> None:
    """Three turns by 120 degrees are none, one takes red to green, gray and the mean of the channels stay."""
    turn = hue_rotation(120.0)
    np.testing.assert_allclose(turn @ (1, 0, 0), (0, 1, 0), atol=1e-12)
    np.testing.assert_allclose(turn @ turn @ turn, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(hue_rotation(33.0) @ (0.4, 0.4, 0.4), 0.4)
    assert (hue_rotation(33.0) @ (0.1, 0.2, 0.6)).mean() == pytest.approx(0.3)


DRAFT = np.array([[True, True, False], [False, True, True]])


def test_the_draft_is_followed() -> None:
    """At each crossing the thread is seen that the draft puts above, whole, and the other not at all."""
    y, x = np.mgrid[0:4, 0:6] * 10.0
    warp, weft = interlace(x, y, (10.0, 10.0), 2.0, DRAFT)
    expected = np.tile(DRAFT, (2, 2))
    np.testing.assert_array_equal(warp.coverage, expected)
    np.testing.assert_array_equal(weft.coverage, ~expected)
    np.testing.assert_array_equal(warp.index, np.tile(np.arange(6), (4, 1)))


def test_threads_rise_and_dive() -> None:
    """A thread is lighter where it lies above, and as light all along where it stays above two others."""
    x = np.linspace(0, 30, 61)
    weft = interlace(x, np.zeros(61), (10.0, 10.0), 2.0, ~DRAFT)[1]
    assert weft.shade[0] == weft.shade[10] == weft.shade[20] == 1.0 and weft.shade[40] < 0.6


def test_drafts_of_weaves() -> None:
    """In a twill each thread floats over two; a basket weave moves pairs; a herringbone turns back."""
    grid = np.mgrid[0:8, 0:8] * 10.0
    above = {}
    for draft in ("plain", "twill", "basket", "herringbone"):
        cloth = Weave(warp=10, weft=10, gap=2, draft=draft)  # type: ignore[arg-type]
        above[draft] = cloth.pattern(grid[1], grid[0]).layers[0].coverage > 0.5
    assert (above["plain"] != np.roll(above["plain"], 1, 0)).all()
    for draft in ("twill", "basket", "herringbone"):
        assert (above[draft] == np.roll(above[draft], 2, 0)).mean() == 0 and above[draft].mean() == 0.5
    assert (above["twill"] == np.roll(np.roll(above["twill"], 1, 0), -1, 1)).all()
    assert (above["basket"][::2] == above["basket"][1::2]).all()
    assert (above["herringbone"][:, 1:4] == above["herringbone"][:, 7:4:-1]).all()


INDEX = np.array([[-1, -1, 2], [-1, 0, 2]])
COVERAGE = np.array([[1.0, 0.5, 0.0], [1.0, 0.25, 0.0]])
PATTERN = Pattern((0.4, 0.4, 0.4), (Layer("dot", (INDEX,), COVERAGE, (0.8, 0.2, 0.6), 0.5),))


def test_census() -> None:
    """The census lists all indices between the least and the greatest; each point has its own; invisible ones count."""
    census = PATTERN.layers[0].census()
    assert census.index[:, 0].tolist() == [-1, 0, 1, 2]
    np.testing.assert_array_equal(census.index[census.row, 0], INDEX)
    assert census.visible(COVERAGE).tolist() == [True, True, False, False]


def test_ideal() -> None:
    """A pixel is its share of the shaded element, and ground for the rest."""
    np.testing.assert_allclose(PATTERN.ideal()[0], [(0.4, 0.1, 0.3), (0.4, 0.25, 0.35), (0.4, 0.4, 0.4)], atol=1e-6)


def test_cropped() -> None:
    """A crop of a pattern is the pattern of the crop."""
    whole = Pattern(
        np.zeros((5, 6, 3)), (Layer("dot", (np.arange(30).reshape(5, 6),), np.ones((5, 6)), (0.5, 0.5, 0.5)),)
    )
    part = whole.crop(2)
    assert part.layers[0].index[0].tolist() == [[14, 15]] and part.ideal().shape == (1, 2, 3)
    assert whole.crop(0).ideal().shape == (5, 6, 3)


def test_tinted() -> None:
    """A matrix turns the colors of ground and elements alike, and what leaves [0, 1] is cut off."""
    turned = PATTERN.recolor(np.array([[0.0, 0, 1], [1, 0, 0], [0, 2, 0]]))
    assert turned.layers[0].color == pytest.approx(np.array((0.6, 0.8, 0.4)))
    assert turned.ground == pytest.approx(np.array((0.4, 0.4, 0.8)))
