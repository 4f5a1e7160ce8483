"""The detector of bent lattices: it follows them as the command does, vertex by vertex."""

import pytest

from nrbench import detect_lattice, texture, track_lattice
from nrbench.lattice.vertices import displace_vertices, lay_vertices, match_vertices
from nrbench.pictures.overlays import draw_vertices


def test_a_bent_lattice_is_followed() -> None:
    """The vertices of a wavy wall are found, which no straight lattice hits; the answer is that of `track_lattice`."""
    wall = texture("brick", shape=(112, 112), seed=1, bend=0.5)
    truth = displace_vertices(wall.lattice, wall.displacement)
    found = detect_lattice(wall, "tracked", reject="none")
    match = match_vertices(found.vertices, truth, (112, 112))
    straight = match_vertices(lay_vertices(wall.lattice, (112, 112)), truth, (112, 112))
    assert match.precision == 1 and (match.recall or 0) > 0.95 and (straight.recall or 1) < 0.7
    assert found.diagnostics["bent"] == 1 and not found.has_origin
    assert found.vertices == track_lattice(wall.image).lattice_points
    drawn = draw_vertices(wall.image, found.vertices)
    assert all((drawn[round(y), round(x)] != wall.image[round(y), round(x)]).any() for _, _, x, y in found.vertices)


def test_a_straight_lattice_is_that_of_consensus() -> None:
    """In a straight picture the points of the lattice are laid, without further search."""
    wall = texture("brick", shape=(96, 96), seed=1)
    found, plain = (detect_lattice(wall, name) for name in ("tracked", "consensus"))
    assert found.diagnostics["bent"] == 0 and found.confidence == plain.confidence
    assert found.lattice.is_equivalent(plain.lattice, 0.1)
    assert len(found.vertices) == pytest.approx(96 * 96 / plain.lattice.area, abs=8)
