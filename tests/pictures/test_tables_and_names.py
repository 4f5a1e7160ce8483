"""Tables as spreadsheets of several countries save them, and names with accents and shell characters."""

import json
import unicodedata
from pathlib import Path

import numpy as np
import pytest
from commands import call

from nrbench import read_image, write_image
from nrbench.datasets_procedural.images import read_rendered
from nrbench.errors import BadInput
from nrbench.pictures.truth import read_truth, read_vertices
from nrbench.plugins.parameters import match_pattern
from nrbench.storage import find_path, read_table
from nrbench.suites.plan import draw_samples
from nrbench.suites.suite import load_suite

NAME = "Mauer café ü.png"
NFD = unicodedata.normalize("NFD", NAME)
ROWS = [["file", "t1x", "t1y", "t2x", "t2y"], [NAME, "48.3", "0", "24.15", "22.7"], ["b.png", "", "", "", ""]]
VECTORS = {NAME: {"t1": (48.3, 0.0), "t2": (24.15, 22.7)}, "b.png": {}}


def _table(separator: str, decimal: str = ".", end: str = "\r\n") -> str:
    cells = [
        [cell if i == 0 or j == 0 else cell.replace(".", decimal) for j, cell in enumerate(row)]
        for i, row in enumerate(ROWS)
    ]
    return end.join([*map(separator.join, cells), ""])


SAVED = {
    "semicolons and decimal commas": _table(";", ",").encode(),
    "tabs": _table("\t", ",").encode("utf-8-sig"),
    "Unicode text": _table("\t", ",").encode("utf-16"),
    "big-endian": b"\xfe\xff" + _table(";", ",").encode("utf-16-be"),
    "without a mark": _table(",").encode("utf-16-le"),
    "sep": b"sep=;\r\n" + _table(";").encode(),
    "quoted decimal commas": _table('","', ",")
    .replace("\r\n", '"\r\n"')
    .encode()
    .join((b'"', b'"'))
    .removesuffix(b'""'),
    "line ends of old Macs": _table(";", ",", "\r").encode(),
    "emptied lines, columns without a name": _table(";", ",").replace("\r\n", ";;\r\n").encode() + b";;;;;;\r\n",
}


@pytest.mark.parametrize("saved", SAVED)
def test_truth_is_read_as_spreadsheets_save_it(saved: str, tmp_path: Path) -> None:
    """Separators, decimal commas, encodings and emptied lines do not change what a table says."""
    for name in VECTORS:
        (tmp_path / name).touch()
    (tmp_path / "truth.csv").write_bytes(SAVED[saved])
    assert read_truth(tmp_path) == VECTORS


def test_an_error_names_the_line_of_the_file(tmp_path: Path) -> None:
    """Also below a line of the separator; a text in another encoding is one clear error."""
    (tmp_path / "truth.csv").write_bytes(b"sep=;\r\nfile;t1x;t1y;t2x;t2y\r\nc.png;1,5;0;0;9\r\n")
    with pytest.raises(BadInput, match=r"truth\.csv line 3: lattice '1\.5,0,0,9'"):
        read_truth(tmp_path)
    (tmp_path / "truth.csv").write_bytes(_table(";").encode("cp1252"))
    with pytest.raises(BadInput, match=r"truth\.csv: is no CSV text .* save it as CSV UTF-8 with the columns file,t1x"):
        read_truth(tmp_path)


def test_vertices_and_lists_of_outputs_are_such_tables_too(tmp_path: Path) -> None:
    """Vertices with decimal commas are read; every table has the columns that its first line names."""
    path = tmp_path / "v.csv"
    path.write_text("row;column;x;y\n0;0;3;4\n0;1;23,5;4\n1;0;3;24,5\n1;1;23;24\n", "utf-16")
    assert [(each.x, each.y) for each in read_vertices(path, (40, 40))] == [(3, 4), (23.5, 4), (3, 24.5), (23, 24)]
    path.write_text("sample\toutput\na.png\tb.png\n")
    assert read_table(path, "sample,output") == (["sample", "output"], [(2, {"sample": "a.png", "output": "b.png"})])


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le"])
def test_suites_and_truth_are_read_as_editors_save_them(encoding: str, tmp_path: Path) -> None:
    """A mark of the encoding, line ends of Windows and UTF-16 do not change a suite or a truth.json."""
    text = 'name = "größe"\r\nmethods = ["scatter"]\r\n[[texture]]\r\nname = "a"\r\ndataset = "brick"\r\n'
    (tmp_path / "suite.toml").write_bytes(text.encode(encoding))
    assert load_suite(tmp_path / "suite.toml").name == "größe"
    (tmp_path / "truth.json").write_text('{"textures": {"ä.png": {"family": "wall"}}}', encoding)
    assert read_rendered(tmp_path)[1] == {"ä.png": {"family": "wall"}}


def test_names_are_equal_in_each_form_of_unicode(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A name that macOS stores decomposed is found by its composed form: in tables, as argument, and by -t.

    The texture has the composed name. A file of exactly the name goes first.
    """
    folder = tmp_path / unicodedata.normalize("NFD", "Façaden")
    folder.mkdir()
    image = np.random.default_rng(0).random((40, 40, 3), np.float32)
    write_image(folder / NFD, image)
    (folder / "truth.csv").write_text(f"file,t1x,t1y,t2x,t2y\n{NAME},9,0,0,8\n", "utf-8")
    (folder / "truth.json").write_text(json.dumps({"textures": {NAME: {"family": "wall"}}}))
    typed = tmp_path / "Façaden"
    assert not typed.exists() and find_path(typed / NAME) == folder / NFD
    assert find_path(typed / "é") == folder / "é"
    assert read_image(typed / NAME).shape == (40, 40, 3)
    (row,) = load_suite(str(typed)).texture
    assert (row.name, row.family, row.parameters["t1"]) == (Path(NAME).stem, "wall", (9.0, 0.0))
    pattern = unicodedata.normalize("NFD", "Mauer café*")
    assert call(f"plan '{typed}' -m scatter --lattice given -t '{pattern}' --json") == 0
    assert {each["texture"] for each in json.loads(capsys.readouterr().out)["cells"]} == {Path(NAME).stem}
    (folder / NAME).touch()
    assert find_path(folder / NAME).name == NAME and find_path(folder / NFD).name == NFD


def test_shell_characters_of_a_name_are_letters() -> None:
    """A pattern that is a name matches this one alone; a bracket that opens no matching set is a letter."""
    names = ["wall[1]", "wall1", "wall[2]", "what?", "whatX", "a*", "ab", "[", "wall [x"]
    for name in names:
        assert match_pattern(name, names) == {name}
    assert match_pattern("wall[[]*", names) == {"wall[1]", "wall[2]"}
    assert match_pattern("wall[12]", names) == {"wall1"}
    assert match_pattern("wall[1]*", ["wall[1]-a", "wall[2]"]) == {"wall[1]-a"}
    assert match_pattern("wall[3]", names) == match_pattern("nothing", names) == set()
    suite = load_suite("core")
    renamed = suite.with_changes(
        texture=[suite.texture[0].model_copy(update={"name": n}).model_dump(mode="json") for n in names[:2]]
    )
    assert [each.row.name for each in draw_samples(renamed, ["wall[1]"])] == ["wall[1]"]
