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


def test_a_tileable_output_has_no_seam_at_its_edges(wall: nrbench.Texture, capsys: pytest.CaptureFixture[str]) -> None:
    """Rolled by half its size, a tileable output is no rougher where its edges meet than elsewhere; others are."""
    rough = {}
    for words in ("", "--tileable"):
        assert call(f"synth wall.png -m fftm-patch --size 128x96 -o out.png {words}") == 0
        image = np.roll(nrbench.read_image(Path("out.png")), (48, 64), (0, 1))
        steps = np.abs(np.diff(image, axis=1)).mean((0, 2))
        rough[words] = steps[63] / np.median(steps[::32])
    assert rough["--tileable"] < 1.3 < rough[""]
    assert "out-mask.png (mask)" in capsys.readouterr().err


def test_methods_that_cannot_tile_say_so(wall: nrbench.Texture, capsys: pytest.CaptureFixture[str]) -> None:
    """A method without the parameter refuses a tileable output, and the error names the methods that can."""
    assert call("synth wall.png -m rsgf --tileable --size 128x96 -o out.png") == 2
    assert (
        "rsgf cannot make an output that repeats without a seam; fftm-patch, fftm-pixel can" in capsys.readouterr().err
    )
