"""Files of vertices set by hand: what is read, what is refused, and how a folder of photographs is scored by them."""

from pathlib import Path

import numpy as np
import pytest

from nrbench import Options, run, texture
from nrbench.errors import BadInput
from nrbench.lattice.vertices import displace_vertices
from nrbench.pictures.files import write_image
from nrbench.pictures.truth import read_vertices, vertices_file, vertices_text
from nrbench.reports.statistics.detections import tabulate_answers

GOOD = "row,column,x,y\n0,0,3,4\n0,1,23,4\n1,0,3,24.5\n1,1,23,24\n"


def test_a_file_is_read_as_it_was_written(tmp_path: Path) -> None:
    """Vertices survive writing and reading, to a thousandth px; spaces and a mark of the encoding are accepted."""
    path = tmp_path / "v.csv"
    path.write_text(GOOD)
    vertices = read_vertices(path, (40, 40))
    path.write_text("\ufeff" + vertices_text(vertices).replace(",", " , "))
    assert read_vertices(path, (40, 40)) == vertices
    assert vertices_file(Path("a/wall.jpg")) == Path("a/wall.jpg.vertices.csv")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "line 1: has the columns (none)"),
        ("x,y\n1,2\n", "line 1: has the columns x,y"),
        (GOOD.replace("row,column", "column,row"), "line 1: has the columns"),
        (GOOD + "2,0,3\n", "line 6: is no vertex"),
        (GOOD + "2,0,3,35,1\n", "line 6: is no vertex"),
        (GOOD + "2,0,three,35\n", "line 6: is no vertex"),
        (GOOD + "2.5,0,3,35\n", "line 6: is no vertex"),
        (GOOD + f"{10**20},0,3,35\n", "line 6: is no vertex"),
        (GOOD + f"2,{-(10**6)},3,35\n", "line 6: is no vertex"),
        (GOOD + "2,0,nan,35\n", "line 6: (nan, 35) lies outside the picture of 40x40 px"),
        (GOOD + "2,0,3,inf\n", "lies outside"),
        (GOOD + "2,0,3,39.5\n", "lies outside"),
        (GOOD + "2,0,-0.6,30\n", "lies outside"),
        (GOOD + "1,1,30,30\n", "line 6: has the row and column of line 5"),
        (GOOD + "2,2,23,24\n", "line 6: has the place of line 5"),
        (GOOD[: GOOD.rindex("1,1")], "has 3 vertices, at least 4"),
        (
            "row,column,x,y\n0,0,3,4\n0,1,9,4\n0,2,15,4\n0,3,21,4\n",
            "no vertex has a neighbor in its row and one",
        ),
        (GOOD.replace("0,0,3,4", "0,0,30,30"), "are flat or turned over"),
        ("row,column,x,y\n0,0,3,4\n0,1,9,4\n1,0,15,4\n1,1,21,4\n", "row 0, column 0 are flat or turned over"),
        ("\0\xff", "has the columns"),
    ],
)
def test_a_malformed_file_is_one_clear_error(text: str, message: str, tmp_path: Path) -> None:
    """The message names the file, the line and the fault."""
    path = tmp_path / "v.csv"
    path.write_text(text)
    with pytest.raises(BadInput) as refusal:
        read_vertices(path, (40, 40))
    assert message in str(refusal.value) and str(path) in str(refusal.value)


def test_a_folder_with_vertices_is_scored(tmp_path: Path) -> None:
    """Straight points laid over a bent picture miss some of the vertices that a person set; the mean lattice is known.

    A crop has the vertices in it alone.
    """
    drawn = texture("brick", shape=(128, 128), seed=3, bend=0.4, rotation=20.0)
    set_by_hand = [
        each
        for each in displace_vertices(drawn.lattice, drawn.displacement)
        if 0 <= min(each[2:]) <= max(each[2:]) < 127
    ]
    write_image(tmp_path / "wall.png", drawn.image)
    vertices_file(tmp_path / "wall.png").write_text(vertices_text(set_by_hand))
    options, numbers = Options(jobs=0), ",".join(map(str, drawn.lattice.numbers[:4]))
    common = {"methods": "lattice-only", "metrics": ["lattice_recovery"], "options": options, "size": "32x32"}
    done = run(tmp_path, lattice=["gncc:reject=none", numbers], sample="500x500", out=tmp_path / "whole", **common)
    (row,) = tabulate_answers(done).to_dict("records")
    assert 0.1 < row["vertex_recall"] < 0.95 and row["vertex_precision"] > 0.1
    assert done.cells[0].cell.lattice_truth.is_equivalent(drawn.lattice, 1.0)
    assert done.cells[1].reasons["lattice_recovery.vertex_recall"] == "no detector was used"
    (cell,) = run(tmp_path, lattice="gncc", sample="64x64", out=tmp_path / "crop", **common).cells
    assert 4 < len(cell.cell.vertices_truth) < len(set_by_hand) / 2
    assert np.array(cell.cell.vertices_truth)[:, 2:].min() >= -0.5
    vertices_file(tmp_path / "wall.png").write_text("x,y\n")
    with pytest.raises(BadInput, match="give row,column,x,y"):
        run(tmp_path, lattice="gncc", out=tmp_path / "refused", **common)
