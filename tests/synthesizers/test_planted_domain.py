from dataclasses import replace

import numpy as np
import pytest
from planted_cases import NEEDS_NO_LATTICE, TEXTURE, Draws, plant

from nrbench.errors import BadInput
from nrbench.plugins.forms import Refused, Shape, Texture
from nrbench.synthesizers.defects.plant import read_displaced
from nrbench.synthesizers.planted import DEFECTS, Planted


@pytest.mark.parametrize("kind", DEFECTS)
def test_equal_seeds_give_equal_bytes(kind: str) -> None:
    """The task's generator decides everything."""
    np.testing.assert_array_equal(plant(kind, 0.3, 4).image, plant(kind, 0.3, 4).image)
    assert (plant(kind, 0.3, 4).image != plant(kind, 0.3, 5).image).any()


def test_wrong_parameters_say_what_to_do() -> None:
    """An unknown kind and a size out of range are bad input."""
    with pytest.raises(BadInput, match=r"kind 'dropped-rows' is unknown \(did you mean 'dropped-row'\?\)"):
        Planted("dropped-rows")
    with pytest.raises(BadInput, match=r"size 1.5 is outside \[0, 1\]"):
        Planted("phase-step", 1.5)


@pytest.mark.parametrize("kind", DEFECTS)
def test_without_fresh_draws_or_lattice_it_refuses(kind: str) -> None:
    """A photograph is refused, and a texture without a lattice where the kind needs one."""

    def chaotic(shape: Shape, k: int) -> Texture:
        return replace(TEXTURE, image=np.random.default_rng(k).random((*shape, 1), np.float32), lattice=None)

    with pytest.raises(Refused, match="no fresh draws"):
        plant(kind, 0, again=None)
    if kind in NEEDS_NO_LATTICE:
        assert kind in plant(kind, 0.3, again=chaotic).note
    else:
        with pytest.raises(Refused, match="no lattice"):
            plant(kind, 0.3, again=chaotic)


@pytest.mark.parametrize(
    ("kind", "size", "shape"),
    [
        ("doubled-tile", 0.4, (1, 1)),
        ("verbatim", 0.4, (8, 8)),
        ("blurred-band", 1.0, (1, 1)),
        ("missing-tile", 1.0, (1, 1)),
        ("stretch", 1.0, (1, 1)),
        ("phase-step", 0.01, (64, 48)),
        ("two-tone", 0.001, (64, 48)),
    ],
)
def test_an_empty_defect_is_refused(kind: str, size: float, shape: Shape) -> None:
    """A defect without room, or of less than a pixel or a tile, is refused."""
    with pytest.raises(Refused, match=rf"planted: {kind} of size .* covers no pixel .* give a larger size or output"):
        plant(kind, size, shape=shape)


@pytest.mark.parametrize("move", [(3, 0), (-3, 0), (0, 3), (0, -3)])
def test_a_margin_that_is_too_small_is_an_error(move: tuple[int, int]) -> None:
    """A margin as wide as the move is read to its end; one that is a pixel narrower is an error, on every side."""
    draw = np.random.default_rng(0).random((16, 20, 1)).astype(np.float32)
    field = np.broadcast_to(np.array(move, np.intp), (10, 14, 2))
    np.testing.assert_array_equal(
        read_displaced(draw, 3, field), draw[3 - move[1] : 13 - move[1], 3 - move[0] : 17 - move[0]]
    )
    with pytest.raises(IndexError, match="a margin of 2 px is too small for displacements of 3 px"):
        read_displaced(draw[1:-1, 1:-1], 2, field)


def test_the_lattice_costs_no_draw_of_the_sample() -> None:
    """All that is drawn beside the output is the smallest draw there is."""
    again = Draws()
    plant("phase-step", 0.3, again=again)
    assert [image.shape[:2] for image in again.seen[:-1]] == [(8, 8)]
