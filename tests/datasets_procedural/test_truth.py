"""Claims about truth.csv."""

from __future__ import annotations

from pathlib import Path

import pytest

from nrbench.datasets_procedural.photographs.truth import read_rendered, read_truth
from nrbench.errors import BadInput

HEADER = "file,t1x,t1y,t2x,t2y\n"
ORIGINS = "file,t1x,t1y,t2x,t2y,originx,originy\n"


def _folder(tmp_path: Path, text: str) -> Path:
    for name in ("a.png", "b.png"):
        (tmp_path / name).touch()
    (tmp_path / "truth.csv").write_text(text, "utf-8")
    return tmp_path


def test_no_file(tmp_path: Path) -> None:
    """Without a truth.csv nothing is known."""
    assert read_truth(tmp_path) == {}


def test_vectors(tmp_path: Path) -> None:
    """Four numbers are two vectors, empty ones no lattice; order, other columns and a byte order mark do not matter."""
    text = '\ufefft2x,t2y,file,note,t1x,t1y\n0, 9.5,a.png,"x, y",12,-1\n,,b.png,,,\n'
    assert read_truth(_folder(tmp_path, text)) == {"a.png": {"t1": (12.0, -1.0), "t2": (0.0, 9.5)}, "b.png": {}}


def test_origin(tmp_path: Path) -> None:
    """Two further numbers are the origin, where both are given; numbers keep every digit."""
    header = HEADER.strip() + ",originx,originy\n"
    text = header + "a.png,12.300000000000001,0,0,9,3.25,-0.5\nb.png,12,0,0,9,,\n"
    known = read_truth(_folder(tmp_path, text))
    assert known["a.png"] == {"t1": (12.300000000000001, 0.0), "t2": (0.0, 9.0), "origin": (3.25, -0.5)}
    assert "origin" not in known["b.png"]


def test_pictures_without_a_line(tmp_path: Path) -> None:
    """A picture needs no line, and a line no numbers: nothing is known of its lattice."""
    assert read_truth(_folder(tmp_path, HEADER)) == {}
    assert read_truth(_folder(tmp_path, HEADER + "b.png\n")) == {"b.png": {}}


def test_rendered(tmp_path: Path) -> None:
    """What render wrote becomes a row; a truth.json of another kind is passed over; one that is no JSON is refused."""
    assert read_rendered(tmp_path) == ("", {})
    (tmp_path / "truth.json").write_text('{"textures": [1, 2]}')
    assert read_rendered(tmp_path) == ("", {})
    entry = '{"family": "wall", "kind": "I", "figure": null, "size": "64x64", "recipe": {"shape": "32x48"}}'
    (tmp_path / "truth.json").write_text(f'{{"sheet": "s.png", "textures": {{"a.png": {entry}}}}}')
    row = {"family": "wall", "size": "64x64", "recipe": {"shape": "32x48"}, "sample": "32x48"}
    assert read_rendered(tmp_path) == ("s.png", {"a.png": row})
    (tmp_path / "truth.json").write_text("{")
    with pytest.raises(BadInput, match=r"truth\.json: is no JSON"):
        read_rendered(tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("file,t1x,t1y,t2x\na.png,1,2,3\n", r"truth\.csv line 1: lacks column 't2y'"),
        ("", r"line 1: lacks column"),
        (HEADER + "a.png,12,0,0,9\nb.png,12,zero,0,9\n", r"line 3: .*'12,zero,0,9' are not four numbers"),
        (HEADER + "a.png,12,0,0\n", r"line 2: .*are not four numbers"),
        (HEADER + "a.png,12,0,24,0\n", r"line 2: .*parallel"),
        (HEADER + "a.png,12,0,nan,0\n", r"line 2: .*finite"),
        (HEADER + "c.png,12,0,0,9\n", r"line 2: there is no file 'c\.png'"),
        (HEADER + "a.png,,,,\na.png,,,,\n", r"line 3: 'a\.png' stands a second time; leave one"),
        (HEADER + "a.png,,,,\n\na.png ,12,0,0,9\n", r"line 4: 'a\.png' stands a second time; leave one"),
        (HEADER + "a.png,12,0,,\n", r"line 2: '12,0,,' are not four numbers; give all of t1x,t1y,t2x,t2y, or none"),
        (HEADER + "a.png,inf,0,0,9\n", r"line 2: .*finite"),
        (HEADER + "a.png,0,0,0,9\n", r"line 2: .*parallel or zero; give two independent vectors"),
        (HEADER + "a.png,12,0,0,9,3\n", r"line 2: has 6 fields for 5 columns; quote a field with a comma in it"),
        (HEADER + "./a.png,12,0,0,9\n", r"line 2: './a\.png' is a path; .*give the file's name alone"),
        (HEADER + "sub\\a.png,12,0,0,9\n", r"line 2: .* is a path"),
        (HEADER + "..,12,0,0,9\n", r"line 2: '\.\.' is a path"),
        (HEADER + ",12,0,0,9\n", r"line 2: names no file; give its name, or drop the line"),
        ("file,t1x,t1y,t2x,t2y,t1x\n", r"line 1: column 't1x' stands a second time; leave one"),
        ("file,t1x,t1y,t2x,t2y,originx\n", r"line 1: has 'originx' alone; give both columns originx,originy, or neit"),
        ("file,t1x,t1y,t2x,t2y,originy\n", r"line 1: has 'originy' alone"),
        (ORIGINS + "a.png,12,0,0,9,3,\n", r"line 2: '3,' are not two numbers; give all of originx,originy, or none"),
        (ORIGINS + "a.png,12,0,0,9,,3\n", r"line 2: ',3' are not two numbers"),
        (ORIGINS + "a.png,12,0,0,9,x,3\n", r"line 2: 'x,3' are not two numbers"),
        (ORIGINS + "a.png,12,0,0,9,nan,3\n", r"line 2: .*finite"),
        (ORIGINS + "a.png,,,,,x,y\n", r"line 2: 'x,y' are not two numbers"),
        (ORIGINS + "a.png,,,,,1,2\n", r"line 2: has an origin and no vectors; give t1x,t1y,t2x,t2y, or no origin eith"),
    ],
)
def test_malformed(tmp_path: Path, text: str, message: str) -> None:
    """What is wrong is named with its file and line."""
    with pytest.raises(BadInput, match=r"truth\.csv " + message.removeprefix(r"truth\.csv ")):
        read_truth(_folder(tmp_path, text))


def test_no_text(tmp_path: Path) -> None:
    """A table that is no text is refused."""
    (tmp_path / "truth.csv").write_bytes(b"\xff\xfe\x00\x00")
    with pytest.raises(BadInput, match="is no CSV text"):
        read_truth(tmp_path)
