"""Claims about single models: what lies at known places, their lattices, plane groups."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from nrbench import plugins
from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.jigsaw import Jigsaw
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.datasets_procedural.overlap import Overlap
from nrbench.datasets_procedural.wallpaper import GROUPS, Group, Wallpaper, operations, random_motif
from nrbench.datasets_procedural.weave import Weave
from nrbench.lattice.geometry import Lattice

from .conftest import NONE, truth

PLACES: list[tuple[str, dict[str, Any], tuple[float, float], str, tuple[int, ...]]] = [
    ("brick", {"width": 20, "height": 10, "bond": "stack"}, (20, 10), "brick", (1, 1)),
    ("brick", {"width": 20, "height": 10, "bond": "english"}, (10, 0), "brick", (1, 0)),
    ("brick", {"width": 20, "height": 10, "bond": "english"}, (10, 10), "ground", ()),
    ("brick", {"width": 20, "height": 10, "bond": "flemish"}, (15, 0), "brick", (1, 0)),
    ("brick", {"width": 20, "height": 10, "bond": "flemish"}, (0, 10), "brick", (-1, 1)),
    ("hexagon", {"period": 20, "joint": 4, "style": "net"}, (10, 0), "wire", (1, 0)),
    ("hexagon", {"period": 20, "joint": 4, "style": "net"}, (0, 0), "ground", ()),
    ("jigsaw", {"width": 40, "height": 40, "tabs": "same"}, (24, 0), "piece", (0, 0)),
    ("jigsaw", {"width": 40, "height": 40, "tabs": "same"}, (24, 14), "piece", (1, 0)),
    ("pavement", {"width": 10, "style": "herringbone"}, (10, 0), "stone", (0, 0)),
    ("pavement", {"width": 20}, (20, 20), "small stone", (0, 0)),
    ("card", {"width": 10, "height": 20}, (10, 20), "hole", (1, 1)),
    ("plate", {"period": 20}, (20, 0), "lozenge", (1, 0)),
    ("ceramic", {"period": 30}, (15, 0), "ground", ()),
    ("scales", {"width": 20}, (0, 8), "scale", (0, 0)),
    ("scales", {"width": 20}, (10, 8), "scale", (0, 1)),
    ("squares", {"period": 20}, (4, 0), "middle", (0, 0)),
    ("cans", {"period": 20, "packing": "square"}, (20, 20), "can", (1, 1)),
    ("swirl", {"period": 20}, (10, 20), "swirl", (0, 1)),
    ("mat", {"width": 24, "height": 18, "rope": 8}, (12, 9), "knot", (0, 0)),
    ("mat", {"width": 24, "height": 18, "rope": 8}, (0, 0), "rope", (0,)),
    ("pie", {"period": 20, "strip": 12}, (0, 0), "upright", (0,)),
    ("pie", {"period": 20, "strip": 12}, (20, 0), "level", (0,)),
    ("toothpaste", {"width": 20, "turn": 40}, (20, 10), "stripe", (1, 1)),
    ("windows", {"width": 40, "height": 60}, (20, 0), "ground", ()),
    ("mosaic", {"period": 60}, (0, 0), "stone", (0, 0)),
    ("cracker", {"period": 40}, (5, 40), "cracker", (0, 1)),
    ("carpet", {"knot": 5}, (10, 5), "knot", (2, 1)),
    ("rug", {"yarn": 4, "step": 6}, (12, 16), "patch", (1, 1)),
    ("corduroy", {"width": 16, "tuft": 6}, (16, 12), "tuft", (1, 2)),
    ("corduroy", {"width": 16, "tuft": 6}, (8, 0), "ground", ()),
    ("overlap", {"period": 40}, (14, 0), "square", (0, 0)),
    ("overlap", {"period": 40}, (0, 0), "hexagon", (0, 0)),
    ("basket", {"stake": 20, "strand": 8}, (0, 0), "stake", (0,)),
    ("basket", {"stake": 20, "strand": 8}, (20, 0), "strand", (0,)),
]


@pytest.mark.parametrize(("name", "parameters", "point", "layer", "index"), PLACES)
def test_known_places(
    name: str, parameters: dict[str, Any], point: tuple[float, float], layer: str, index: tuple[int, ...]
) -> None:
    """At known points lies the element that should, or the ground."""
    model = plugins.build("datasets", name, parameters)
    pattern = model.pattern(*(np.array([part], np.float64) for part in point))
    seen = {each.name: (float(each.coverage[0]), tuple(int(part[0]) for part in each.index)) for each in pattern.layers}
    if layer == "ground":
        assert sum(coverage for coverage, _ in seen.values()) < 0.01
    else:
        assert seen[layer] == (pytest.approx(1, abs=0.02), index)


def test_each_wire_is_one_element() -> None:
    """Three wires of a hexagonal net belong to each mesh; both meshes beside a wire give it one name."""
    net = Hexagon(period=20, joint=4, style="net", color=0.5, intensity=0, noise=0)
    texture = net.render((200, 200), np.random.default_rng(0))
    count, meshes = len(texture.elements["wire.index"]), 200 * 200 / (400 * math.sqrt(3) / 2)
    assert count == pytest.approx(3 * meshes, rel=0.15)
    x = np.array([9.0, 11.0])
    index = net.pattern(x, np.zeros(2)).layers[0].index
    assert index[0][0] == index[0][1] and index[1][0] == index[1][1]


def test_pieces_fit() -> None:
    """A jigsaw piece has the area of its cell, whatever its tabs: what it bulges out, its neighbors lack."""
    for tabs in ("same", "alternate"):
        puzzle = Jigsaw(width=60, height=50, gap=1.0, tabs=tabs)
        y, x = np.mgrid[-60:60:0.25, -60:60:0.25]
        i, j = puzzle.pattern(x, y).layers[0].index
        assert ((i == 0) & (j == 0)).sum() / 16 == pytest.approx(3000, rel=0.07 if tabs == "alternate" else 0.01)


def test_two_lattices() -> None:
    """The overlap has three lattices: squares, hexagons, and the one of both, of which the others are finer."""
    texture = Overlap(period=30.5, rotation=10.0).render((64, 64), np.random.default_rng(0))
    common, squares, hexagons = texture.lattices
    assert texture.lattice == common and squares.s == pytest.approx(30.5)
    assert hexagons.classify(0.02) == "hexagonal" and {one.origin for one in texture.lattices} == {common.origin}
    for part in (squares, hexagons):
        steps = common.matrix @ np.linalg.inv(part.matrix)
        np.testing.assert_allclose(steps, np.rint(steps), atol=1e-9)
    assert common.area / squares.area == pytest.approx(25) and common.area / hexagons.area == pytest.approx(56)


def test_each_brick_has_one_factor() -> None:
    """Inside a brick the picture is the ideal one times the brick's factor, and the mortar never varies."""
    wall = Brick(width=30, height=12, joint=2, phase=(0, 0), color=0.4, intensity=0, noise=0)
    texture = wall.render((12, 90), np.random.default_rng(0))
    ratio = texture.image / truth(texture)[1]
    index, factor = (texture.elements[f"brick.{part}"] for part in ("index", "factor"))
    for brick, column in (((0, 0), slice(0, 13)), ((1, 0), slice(18, 43)), ((2, 0), slice(48, 73))):
        inside = ratio[0:4, column].reshape(-1, 3)
        expected = np.broadcast_to(factor[(index == brick).all(1)], inside.shape)
        np.testing.assert_allclose(inside, expected, rtol=1e-5)
    np.testing.assert_allclose(ratio[6], 1, atol=1e-6)


def test_equal_spacings_still_need_two_threads() -> None:
    """With square crossings the smallest lattice is the centered one, of area 2 p^2."""
    lattice = truth(Weave(warp=13.3, weft=13.3).render((32, 32), np.random.default_rng(0)))[0]
    assert lattice.area == pytest.approx(2 * 13.3**2) and lattice.s == pytest.approx(13.3 * np.sqrt(2))


@pytest.mark.parametrize("made", [Hexagon(**NONE), Wallpaper(group="p6", **NONE)])
def test_sixfold_symmetry(made: Model) -> None:
    """Turned by 60 degrees about its origin, a hexagonal tiling or a wallpaper of group p6 is itself."""
    turned = (dataclasses.replace(made, phase=(0.0, 0.0), rotation=angle) for angle in (10.0, 70.0))
    images = [each.render((64, 64), np.random.default_rng(0)).image for each in turned]
    np.testing.assert_allclose(images[0], images[1], atol=1e-5)


def test_hexagons_have_equal_vectors() -> None:
    """The two vectors of a hexagonal tiling are as long as its period, at an angle of 60 degrees."""
    lattice = truth(Hexagon(period=20.5, rotation=8.0).render((32, 32), np.random.default_rng(0)))[0]
    assert lattice.area == pytest.approx(20.5**2 * math.sqrt(3) / 2) and lattice.s == pytest.approx(20.5)


ORDERS = dict(zip(GROUPS, (1, 2, 2, 2, 2, 4, 4, 4, 4, 4, 8, 8, 3, 6, 6, 6, 12), strict=True))
EVERY = {one for group in GROUPS for one in operations(group)}


def _error(group: Group, operation: tuple[int, int, int, int, float, float]) -> float:
    """Return how much an operation changes a motif: the squared error over twice the variance."""
    motif = random_motif(5, group, 2)
    u, v = np.random.default_rng(0).random((2, 800))
    a, b, c, d, e, f = operation
    return float(((motif(a * u + b * v + e, c * u + d * v + f) - motif(u, v)) ** 2).mean() / 2)


@pytest.mark.parametrize("group", GROUPS)
def test_a_group_is_a_group(group: Group) -> None:
    """Each group has its order, and keeps the metric of its lattice."""
    found = operations(group)
    assert len(found) == len(set(found)) == ORDERS[group]
    cell = Lattice(*Wallpaper(group=group).vectors).matrix.T
    for a, b, c, d, *_ in found:
        turn = cell @ np.array([(a, b), (c, d)]) @ np.linalg.inv(cell)
        np.testing.assert_allclose(turn @ turn.T, np.eye(2), atol=1e-9)


@pytest.mark.parametrize("group", GROUPS)
def test_a_motif_has_the_symmetry_of_its_group_and_no_other(group: Group) -> None:
    """Among the operations of all groups, only those of its own leave a motif unchanged; no other nearly does."""
    for operation in EVERY:
        error = _error(group, operation)
        assert error < 1e-20 if operation in operations(group) else error > 0.02


def test_motifs_are_standardized_and_unlike() -> None:
    """Each function has mean 0 and variance 1 over the cell; two of one motif, and two motifs, differ."""
    u, v = np.meshgrid(*[np.arange(32) / 32] * 2)
    first, second = (random_motif(seed, "p4g", 2)(u, v) for seed in (1, 2))
    np.testing.assert_allclose(first.mean((1, 2)), 0, atol=1e-9)
    np.testing.assert_allclose(first.var((1, 2)), 1, atol=1e-9)
    assert np.abs(first[0] - first[1]).mean() > 0.2 and np.abs(first - second).mean() > 0.2
