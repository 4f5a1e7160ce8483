from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

import nrbench
from nrbench.cli.single_images import synth_command
from nrbench.errors import BadInput
from nrbench.imaging.files import read_image, write_image
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Refused
from nrbench.synthesizers.tile_laying.tile_shape import tile_shape
from nrbench.synthesizers.tile_set import TileSet

from .test_tile_set import LATTICES, TILES, noise, synthesize

RECTANGULAR = Lattice((20, 0), (0, 25))


@pytest.mark.parametrize("lattice", LATTICES)
def test_a_set_is_what_no_lattice_vector_leads_out_of(lattice: Lattice) -> None:
    """Upright, lattice and rectangle tiles have two sets, cells four, and tiles of 2 x 2 cells one."""
    for tile, count in (("upright", 2), ("lattice", 2), ("rectangle", 2), ("cell", 4)):
        for cells in (1, 2, 3):
            shape = tile_shape(lattice, tile, cells)  # type: ignore[arg-type]
            numbers = shape.set_offsets(lattice)
            assert len(numbers) == (1 if cells == 2 else count) and numbers[0] == (0, 0)
            between = np.array(list(np.ndindex(2, 2))) @ shape.steps
            nearest = np.stack([lattice.wrap(between - np.array(one) @ shape.steps) for one in numbers])
            assert ((np.hypot(*np.moveaxis(nearest, -1, 0)) < 1e-6).sum(0) == 1).all()


@pytest.mark.parametrize("size", [(30, 128), (128, 30), (40, 40), (49, 128), (128, 39)])
@pytest.mark.parametrize("tile", TILES)
def test_samples_under_two_periods_are_refused(size: tuple[int, int], tile: Any) -> None:
    """The reason states the lattice's extent and the size of the sample."""
    lattice = RECTANGULAR if min(size) != 40 else Lattice((33, 0), (0, 35))
    with pytest.raises(Refused, match=f"reaches .* the sample is {size[1]}x{size[0]} px: .* less than two periods"):
        synthesize(TileSet(tile=tile), noise(*size), (64, 64), lattice)


def test_samples_without_a_tile_of_each_set_are_refused() -> None:
    """A sample of two periods can be too small for a tile: the reason states the tile's size."""
    with pytest.raises(Refused, match="a tile takes 80x100 px, the sample is 60x60 px: it does not hold a complete"):
        synthesize(TileSet(cells=4, tile="cell"), noise(60, 60), (64, 64), RECTANGULAR)
    with pytest.raises(Refused, match="does not hold a complete tile of each set"):
        synthesize(TileSet(cells=64), noise(60, 60), (64, 64), RECTANGULAR)


@settings(max_examples=40)
@given(
    st.tuples(st.integers(16, 48), st.integers(16, 48)),
    st.sampled_from([Lattice((12, 0), (0, 15)), Lattice((11.3, 0), (0, 9.7)), *LATTICES, Lattice((8, 1), (-1, 9.5))]),
    st.sampled_from(TILES),
    st.sampled_from(["quiet", "elements", "given"]),
    st.tuples(st.floats(-20, 20), st.floats(-20, 20)),
    st.sampled_from([1, 2, 3]),
)
def test_whatever_the_size_it_is_laid_or_refused(
    size: tuple[int, int], lattice: Lattice, tile: Any, anchor: Any, origin: tuple[float, float], cells: int
) -> None:
    """For samples about as small as possible, with any origin, there is an output or a reason."""
    method, sample = TileSet(tile=tile, anchor=anchor, cells=cells), noise(*size, 1)
    try:
        made = synthesize(method, sample, (30, 34), lattice.shifted(origin))
    except Refused as refusal:
        assert "less than two periods" in refusal.reason or "does not hold" in refusal.reason
        return
    assert made.image.shape == (30, 34, 1) and made.source is not None and (made.source[..., 2] > 0).all()


@pytest.mark.parametrize("lattice", [Lattice((11.3, 0), (0, 9.7)), Lattice((20.9, 0.2), (-0.1, 13.2))])
@pytest.mark.parametrize("cells", [1, 2, 3])
def test_upright_tiles_leave_no_gap(lattice: Lattice, cells: int) -> None:
    """Every pixel is filled where an upright tile is the minimum tile itself, with fractional sides."""
    made = synthesize(TileSet(tile="upright", cells=cells), noise(90, 140, 1), (150, 160), lattice)
    assert made.source is not None and (made.source[..., 2] > 0).all()


@pytest.mark.parametrize(
    "wrong",
    [
        {"quantile": 1.2}, {"threshold": -1.0}, {"threshold": float("nan")}, {"registration": -1.0}, {"margin": -1.0},
        {"registration": float("inf")},
        {"parts": 0}, {"parts": 17}, {"cells": 0}, {"cells": 65},
    ],
)  # fmt: skip
def test_bad_parameters_are_refused(wrong: dict[str, Any]) -> None:
    """The error says what to choose."""
    with pytest.raises(BadInput, match=f"{next(iter(wrong))} .*choose"):
        TileSet(**wrong)


@pytest.mark.parametrize("name", ["registration", "margin"])
def test_nothing_reaches_farther_than_s(name: str) -> None:
    """Registration and margin may be up to s; larger values are refused."""
    parameters: dict[str, Any] = {name: 20.0}
    assert synthesize(TileSet(**parameters), noise(140, 140, 1), (20, 20), RECTANGULAR).image.shape == (20, 20, 1)
    with pytest.raises(Refused, match=f"{name} 20.5 px reaches farther than s, 20.0 px; choose at most 20.0"):
        synthesize(TileSet(**{name: 20.5}), noise(80, 80, 1), (20, 20), RECTANGULAR)


def test_the_shape_of_tiles_can_be_chosen_from_outside(tmp_path: Path) -> None:
    """The command line and the Python function accept the shape of tiles."""
    sample = noise(80, 80, 1)
    arguments = [write_image(tmp_path / "sample.png", sample), "-m", "tile-set:tile=upright"]
    arguments += ["--size", "40x30", "--lattice", "27.3,0,13.65,12.2", "-o", tmp_path / "out.png"]
    done = CliRunner().invoke(synth_command, [str(word) for word in arguments])
    assert done.exit_code == 0, done.output
    made = nrbench.synthesize("tile-set", sample, (30, 40), "27.3,0,13.65,12.2", tile="upright")
    np.testing.assert_array_equal(read_image(tmp_path / "out.png"), made.image)
