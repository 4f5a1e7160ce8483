"""All methods on one photograph, tileable outputs, and the files that synth announces."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from commands import call

import nrbench


@pytest.fixture
def wall(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> nrbench.Texture:
    """Write ``wall.png`` into the current folder."""
    monkeypatch.chdir(tmp_path)
    wall = nrbench.texture("brick", shape=(96, 96), seed=0, color=0.2, width=32, height=16)
    nrbench.write_image(Path("wall.png"), wall.image)
    return wall


def test_a_sheet_shows_each_method_and_tells_why_one_is_missing(
    wall: nrbench.Texture, capsys: pytest.CaptureFixture[str]
) -> None:
    """The sheet holds the sample and the outputs; a method without one is printed with the reason."""
    chosen = "-m scatter -m rsgf:block=90 --lattice 32,0,16,16 --size 64x64 --jobs 0"
    assert call(f"sheet wall.png -o sheet.png {chosen}") == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[0].startswith("scatter  quality ")
    assert printed[1].startswith("rsgf:block=90  refused: the sample is 96x96 px")
    sheet = nrbench.read_image(Path("sheet.png"))
    assert sheet.shape[1] > 2 * 96
    spots = np.argwhere((np.abs(sheet - [1, 1, 1]).max(-1) > 0.05).any(0)).ravel()
    assert np.ptp(spots) > 96 + 64, "two pictures side by side"
    lattice, options = nrbench.Lattice((32, 0), (16, 16)), nrbench.Options(jobs=0)
    table = nrbench.sheet(wall, "own.png", methods="scatter", size=(64, 64), lattice=lattice, options=options)
    assert table["method"].tolist() == ["scatter"] and f"quality {table['quality'][0]:.2f}" in printed[0]
    np.testing.assert_array_equal(nrbench.read_image(Path("own.png"))[-60:], sheet[-60:])


def test_a_tileable_output_tells_its_strain(wall: nrbench.Texture, capsys: pytest.CaptureFixture[str]) -> None:
    """The command prints the strain and a better size; wrong methods and sizes exit with 2."""
    assert call("synth wall.png -m tiling --lattice 32,0,16,16 --tileable --size 130x96 -o out.png") == 0
    assert "closes by a strain of 1.5 %, 128x96 would need 0 %" in capsys.readouterr().err
    assert call("synth wall.png -m cartoon --tileable --size 128x96 -o out.png") == 2
    assert "cartoon cannot make an output that repeats without a seam; ann-pixel, auto, " in capsys.readouterr().err
    assert call("synth wall.png -m rsgf --lattice 32,0,16,16 --tileable --size 144x96 -o out.png") == 2
    assert "use --size 128x96" in capsys.readouterr().err
