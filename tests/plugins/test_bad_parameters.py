"""Claims about values that make no texture: wherever they are given, one clear error says what to give."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nrbench import synthesize, texture
from nrbench.cli.main import main
from nrbench.errors import BadInput

SIDE = "each side must be from 1 to 16384 px"
STRENGTH = "color is 2.0; give a strength from 0 to 1"
PARALLEL = "are parallel or zero; give two independent vectors"
AREA = "is too large to draw; give at most"
LINES: Mapping[str, str] = {
    "render brick:color=2 -o X": STRENGTH,
    "render brick:color=-0.1 -o X": "color is -0.1; give a strength from 0 to 1",
    "render brick:color=nan -o X": "color is nan; give a strength from 0 to 1",
    "render brick:width=0 -o X": "width is 0.0 px; give at least",
    "render brick --size 0x0 -o X": SIDE,
    "render brick --sample 0x0 -o X": SIDE,
    "render brick --size 100000x100000 -o X": SIDE,
    "render brick --size 16384x16384 -o X": AREA,
    "render images:path=p.png,t1=0,0,t2=0,9 -o X": PARALLEL,
    "run core --size 100000x100000 --out X": SIDE,
    "plan core --sample 0x0 --out X": SIDE,
}
TABLES: Mapping[str, tuple[str, str]] = {
    "color": (
        "[[texture]]\nname='w'\ndataset='brick'\nparameters={color=2}",
        f"texture 'w': dataset brick: {STRENGTH}",
    ),
    "zero": ("sample='0x0'\n[[texture]]\nname='w'\ndataset='brick'", f"sample: size '0x0': {SIDE}"),
    "huge": ("size='100000x100000'\n[[texture]]\nname='w'\ndataset='brick'", SIDE),
    "own": ("[[texture]]\nname='w'\ndataset='brick'\nsample='0x9'", f"texture.0.sample: size '0x9': {SIDE}"),
    "parallel": (
        "[[texture]]\nname='w'\ndataset='images'\nparameters={path='p.png', t1=[3, 0], t2=[6, 0]}",
        f"texture 'w': dataset images: lattice: t1 (3.0, 0.0) and t2 (6.0, 0.0) {PARALLEL}",
    ),
}


def _refused(line: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(line.split())
    said = capsys.readouterr()
    assert stop.value.code == 2 and not said.out
    assert said.err.startswith("nrbench: ") and said.err.count("\n") == 1 and message in said.err
    assert not Path("X").exists()


@pytest.mark.parametrize("line", LINES)
def test_on_the_command_line(line: str, capsys: pytest.CaptureFixture[str]) -> None:
    """One line, exit code 2, and nothing is left behind."""
    _refused(line, LINES[line], capsys)


@pytest.mark.parametrize("verb", ["render {} -o X", "run {} --out X", "plan {} --out X"])
@pytest.mark.parametrize("name", TABLES)
def test_in_a_suite(name: str, verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    """The same from a file, for every verb that reads one; the row is named."""
    table, message = TABLES[name]
    Path("s.toml").write_text(f"name='s'\nmethods=['oracle']\n{table}\n", "utf-8")
    _refused(verb.format("s.toml"), message, capsys)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"color": 2}, STRENGTH),
        ({"shape": (0, 0)}, "at least 1"),
        ({"shape": (64, -3)}, "at least 1"),
        ({"shape": (100000, 100000)}, "at most 16384"),
        ({"shape": (16384, 16384)}, AREA),
        ({"shape": 64}, "two whole numbers"),
        ({"shape": (64, 64, 3)}, "two whole numbers"),
        ({"shape": (64.5, 64)}, "two whole numbers"),
        ({"shape": ("wide", 64)}, "two whole numbers"),
        ({"colour": 0.2}, "did you mean 'color'"),
    ],
)
def test_in_python(given: dict[str, Any], message: str) -> None:
    """``nrbench.texture`` raises BadInput for the same values."""
    with pytest.raises(BadInput, match=message):
        texture("brick", **given)


@pytest.mark.parametrize("shape", [(0, 64), (100000, 100000), 64])
def test_an_output_of_no_shape(shape: Any) -> None:
    """``nrbench.synthesize`` refuses a shape that no output can have before anything is made."""
    with pytest.raises(BadInput, match=r"shape .*: give \(height, width\) in px"):
        synthesize("scatter", np.random.default_rng(0).random((32, 32)), shape)
