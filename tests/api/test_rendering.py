"""Textures as files, and runs on their directory."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from nrbench.api.picture_folders import SHEET, model_suite, write_textures
from nrbench.errors import BadInput
from nrbench.pictures.files import read_image, write_image
from nrbench.suites.cell import Cell
from nrbench.suites.plan import draw_samples, make_plan
from nrbench.suites.suite import Suite, load_suite, validated_suite

ROWS = [
    {"name": "wall", "dataset": "brick", "description": "A wall.", "parameters": {"color": 0.3, "rotation": 7.0}},
    {"name": "cloth", "dataset": "weave", "family": "fabric", "sample": "72x56", "size": "80x96"},
    {"name": "sand", "dataset": "noise", "departure": "noise", "level": 0.5},
]


def _suite(**more: object) -> Suite:
    content = {"name": "three", "seed": 5, "sample": "64x64", "size": "96x80", "replicates": 2, "lattice": ["given"]}
    return validated_suite({**content, "texture": ROWS, "methods": ["oracle", "scatter"], **more}, "test")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Render the suite."""
    write_textures(draw_samples(_suite()), tmp_path / "three")
    return tmp_path / "three"


def _cells(suite: Suite) -> list[Cell]:
    changed = suite.with_changes(methods=["oracle", "scatter"], lattice=["given"], size="96x80")
    return [cell for cell, _ in make_plan(changed).cells]


def test_what_is_written(folder: Path) -> None:
    """The folder holds a PNG for each texture and replicate, a contact sheet, and two truth files that agree."""
    pictures = {f"{name}{number}.png" for name in ("wall", "cloth", "sand") for number in ("", "-1")}
    assert {path.name for path in folder.iterdir()} == pictures | {SHEET, "truth.csv", "truth.json"}
    truth = json.loads((folder / "truth.json").read_text("utf-8"))
    rows = _rows(folder)
    assert set(rows) == set(truth["textures"]) == pictures
    for name, known in truth["textures"].items():
        assert rows[name]["family"] == known["family"] and rows[name]["kind"] == known["kind"]
        if known["lattice"]:
            assert float(rows[name]["t1x"]) == known["lattice"]["t1"][0]
    assert truth["textures"]["wall.png"]["description"] == "A wall."
    assert truth["textures"]["sand.png"]["lattice"] is None


def test_a_run_on_the_directory_is_the_run_of_the_suite(folder: Path) -> None:
    """Every cell of the directory has the key of a cell of the suite."""
    there = {(cell.key, cell.family, cell.regular_share) for cell in _cells(load_suite(folder))}
    rows = {row.name: (row.departure, row.level) for row in load_suite(folder).texture}
    assert rows["sand"] == rows["sand-1"] == ("noise", 0.5) and rows["wall"] == ("", None)
    assert there == {(cell.key, cell.family, cell.regular_share) for cell in _cells(_suite())}


def test_an_edited_truth_counts(folder: Path) -> None:
    """If the lattice in truth.csv is edited, the picture is treated as a photograph with that lattice."""
    table = folder / "truth.csv"
    table.write_text(table.read_text("utf-8").replace(_rows(folder)["wall.png"]["originx"], "2.5"), "utf-8")
    samples = {sample.row.name: sample for sample in draw_samples(load_suite(folder))}
    wall = samples["wall"].texture
    assert samples["wall"].recipe.dataset == "images" and samples["cloth"].recipe.dataset == "weave"
    assert wall and wall.lattice and wall.lattice.origin[0] == 2.5
    (folder / "truth.csv").unlink()
    assert next(iter(draw_samples(load_suite(folder), ["wall"]))).recipe.dataset == "brick"


def test_an_edited_picture_is_a_photograph(folder: Path) -> None:
    """If the recipe no longer gives the pixels of the picture, the picture is used, with its known lattice."""
    before = {sample.row.name: sample for sample in draw_samples(load_suite(folder))}
    image = read_image(folder / "wall.png")
    image[3, 3] = 1 - image[3, 3]
    write_image(folder / "wall.png", image)
    after = {sample.row.name: sample for sample in draw_samples(load_suite(folder))}
    old, new = before["wall"].texture, after["wall"].texture
    assert before["wall"].recipe.dataset == "brick" and after["wall"].recipe.dataset == "images"
    assert old and new and old.lattice and new.lattice
    np.testing.assert_allclose(new.image, image, atol=1e-6)
    assert new.lattice.is_equivalent(old.lattice, tolerance=1e-9)
    np.testing.assert_allclose(new.lattice.origin, old.lattice.origin, atol=1e-9)
    assert after["cloth"].recipe.dataset == "weave"


def test_a_recipe_of_a_missing_dataset_is_ignored(folder: Path) -> None:
    """If the dataset of a recipe is not installed, the picture is used, with its known lattice."""
    text = (folder / "truth.json").read_text("utf-8").replace('"dataset": "brick"', '"dataset": "nobody"')
    (folder / "truth.json").write_text(text, "utf-8")
    wall = next(sample for sample in draw_samples(load_suite(folder), ["wall"]))
    assert wall.recipe.dataset == "images" and wall.texture and wall.texture.lattice


def test_another_seed_draws_other_outputs_of_the_same_samples(folder: Path) -> None:
    """The option --seed changes the random streams of the methods on a rendered directory, but not the pictures."""
    changed = _cells(load_suite(folder).with_changes(seed=9))
    assert {cell.sample_hash for cell in changed} == {cell.sample_hash for cell in _cells(load_suite(folder))}
    assert {cell.seed for cell in changed} == {9}


def test_one_model() -> None:
    """A model's name with parameters is a suite of one texture."""
    assert write_textures(draw_samples(model_suite("brick:color=0.4")), Path("out"))[0] == Path("out/brick.png")


def _rows(directory: Path) -> dict[str, dict[str, str]]:
    with (directory / "truth.csv").open(encoding="utf-8", newline="") as lines:
        return {row["file"]: row for row in csv.DictReader(lines)}


def _textures(directory: Path) -> dict[str, dict[str, object]]:
    found: dict[str, dict[str, object]] = json.loads((directory / "truth.json").read_text("utf-8"))["textures"]
    return found


def _contents(directory: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(directory.iterdir())}


def test_a_further_render_loses_nothing(folder: Path) -> None:
    """A render of another model keeps the existing pictures and their truth, and the contact sheet shows all."""
    rows, textures, sheet = _rows(folder), _textures(folder), read_image(folder / SHEET)
    write_textures(draw_samples(model_suite("hexagon")), folder)
    after = {**_rows(folder)}
    assert after.pop("hexagon.png")["family"] == "hexagon"
    assert after == rows and list(_rows(folder)) == [*rows, "hexagon.png"]
    known = _textures(folder)
    assert known.pop("hexagon.png")["recipe"] and known == textures
    assert read_image(folder / SHEET).size > sheet.size
    assert {sample.recipe.dataset for sample in draw_samples(load_suite(folder))} == {
        "brick",
        "weave",
        "noise",
        "hexagon",
    }
    assert not [path for path in folder.iterdir() if path.name.startswith(".")]


def test_a_second_render_replaces_a_picture_and_its_truth(folder: Path) -> None:
    """A picture of the same name is replaced with its truth; the truth of a deleted picture is removed."""
    before = _contents(folder)
    (folder / "sand.png").unlink()
    other = _suite(texture=[{"name": "wall", "dataset": "weave"}], replicates=1)
    write_textures(draw_samples(other), folder)
    rows, textures = _rows(folder), _textures(folder)
    assert set(rows) == set(textures) == {name for name in before if name.endswith(".png")} - {SHEET, "sand.png"}
    assert rows["wall.png"]["family"] == textures["wall.png"]["family"] == "weave"
    assert rows["wall-1.png"]["family"] == "brick"
    assert (folder / "wall.png").read_bytes() != before["wall.png"]
    assert (folder / "wall-1.png").read_bytes() == before["wall-1.png"]


def test_rendered_twice_nothing_changes(folder: Path) -> None:
    """A second identical render gives the same bytes, and keeps the columns that a user added to truth.csv."""
    before = _contents(folder)
    write_textures(draw_samples(_suite()), folder)
    assert _contents(folder) == before
    header, *lines = (folder / "truth.csv").read_text("utf-8").splitlines()
    (folder / "truth.csv").write_text("\n".join([f"{header},notes", *(f"{line},mine" for line in lines)]), "utf-8")
    write_textures(draw_samples(model_suite("hexagon")), folder)
    assert [row["notes"] for row in _rows(folder).values()] == ["mine"] * 6 + [""]


def test_an_interrupted_render_goes_on(folder: Path) -> None:
    """A render can be repeated after an interruption that left pictures without truth files."""
    before = _contents(folder)
    for name in ("truth.csv", "truth.json", SHEET, "sand.png"):
        (folder / name).unlink()
    write_textures(draw_samples(_suite()), folder)
    assert _contents(folder) == before


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("truth.csv", "file,t1x,t1y,t2x,t2y\n", r"truth\.csv: was not written by `nrbench render` \(it lacks column"),
        ("truth.csv", "name,city\nAda,London\n", r"truth\.csv line 1: column 'file' is missing"),
        ("truth.csv", None, r"line 2: lattice '12,zero,0,9': give four numbers.*Fix truth.csv first"),
        ("truth.json", "{", r"truth\.json: is no JSON .*pass another -o, or move it away"),
        ("truth.json", "[1]", r"truth\.json: was not written by `nrbench render`; pass another -o"),
        ("truth.json", '{"sheet": "contact-sheet.png", "textures": {"wall.png": {"recipe": 3}}}', "was not written by"),
        ("wall.png", "mine", r"wall\.png: exists, and no model drew it; pass another -o, or move it away, or rename"),
        ("contact-sheet.png", "mine", r"contact-sheet\.png: exists, and was not written by `nrbench render`"),
    ],
)
def test_what_is_not_of_a_render_is_left_alone(tmp_path: Path, name: str, text: str | None, message: str) -> None:
    """If a render would overwrite files of another origin, the error names them, and nothing is written."""
    (tmp_path / "a.png").write_bytes(b"another's")
    header = "file,t1x,t1y,t2x,t2y,originx,originy,family,kind,regular_share"
    (tmp_path / name).write_text(f"{header}\na.png,12,zero,0,9,,,,,\n" if text is None else text, "utf-8")
    before = _contents(tmp_path)
    with pytest.raises(BadInput, match=message):
        write_textures(draw_samples(_suite()), tmp_path)
    assert _contents(tmp_path) == before


@pytest.mark.parametrize("names", [("a-1", "a"), ("contact-sheet", "b"), ("Wall", "wall")])
def test_two_files_of_one_name(names: tuple[str, str]) -> None:
    """A texture is refused if its file would have the name of another texture's or of the contact sheet."""
    suite = _suite(texture=[{"name": name, "dataset": "brick"} for name in names])
    with pytest.raises(BadInput, match="name of two pictures; rename the texture"):
        write_textures(draw_samples(suite), Path("out"))
