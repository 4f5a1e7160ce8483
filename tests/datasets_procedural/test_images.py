"""Claims about pictures from files, and about truth.csv and truth.json."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrbench.datasets_procedural.images import (
    Images,
    _free_corner,
    _region_corner,
    plan_sizes,
    read_rendered,
    read_truth,
)
from nrbench.errors import BadInput
from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice
from nrbench.pictures.files import read_image, write_image
from nrbench.plugins.forms import Region, Shape
from nrbench.suites.plan import draw_samples
from nrbench.suites.suite import load_suite


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    """Write a picture of 90 x 60 px."""
    image = np.random.default_rng(0).random((60, 90, 3)).astype(np.float32)
    return write_image(tmp_path / "wall.png", image)


def _part(image: Image, region: Region | None) -> Image:
    assert region is not None
    x0, y0, x1, y1 = region
    return image[y0:y1, x0:x1]


def test_render_is_a_crop(picture: Path) -> None:
    """The sample is a part of the picture, named after it, and says which."""
    texture = Images(picture).render((20, 30), np.random.default_rng(1))
    np.testing.assert_array_equal(texture.image, _part(read_image(picture), texture.region))
    assert texture.image.shape == (20, 30, 3) and texture.name == "wall"
    assert texture.lattice is None and texture.regular_share is None and not Images.procedural


def test_crops_are_drawn(picture: Path) -> None:
    """Equal streams cut equal crops; over streams every place along the border is reached, and no other."""
    cut = [Images(picture).render((57, 88), np.random.default_rng(seed)).region for seed in [0, 0, *range(120)]]
    assert cut[0] == cut[1]
    assert {region[:2] for region in cut if region} == {
        (x, y) for x in range(3) for y in range(4) if x in (0, 2) or y in (0, 3)
    }


@pytest.mark.parametrize(("shape", "found"), [((100, 100), (60, 90)), ((60, 90), (60, 90)), ((80, 40), (60, 40))])
def test_small_picture_is_taken_whole(picture: Path, shape: Shape, found: Shape) -> None:
    """A picture no larger than the requested sample, in one direction or both, is the sample."""
    assert Images(picture).render(shape, np.random.default_rng(0)).image.shape == (*found, 3)


def test_again_is_disjoint(picture: Path) -> None:
    """Over streams the oracle's region takes every place that shares no pixel with the sample, and no other."""
    plugin = Images(picture)
    texture = plugin.render((20, 30), np.random.default_rng(1))
    places = [(x, y, x + 24, y + 57) for x in range(90 - 23) for y in range(60 - 56)]
    free = {place for place in places if not _touch(place, texture.region)}
    seen = set()
    for seed in range(400):
        other = plugin.again(texture, (57, 24), np.random.default_rng(seed))
        assert other is not None and other.image.shape == (57, 24, 3)
        np.testing.assert_array_equal(other.image, _part(read_image(picture), other.region))
        seen.add(other.region)
    assert seen == free


def _touch(a: Region, b: Region) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def test_again_without_room(picture: Path) -> None:
    """None where nothing of the shape fits beside the sample, or into the picture at all."""
    plugin = Images(picture)
    texture = plugin.render((40, 60), np.random.default_rng(1))
    assert plugin.again(texture, (60, 90), np.random.default_rng(0)) is None
    assert plugin.again(texture, (61, 8), np.random.default_rng(0)) is None


@pytest.mark.parametrize(
    ("vectors", "message"),
    [({"t1": (3.0, 0.0)}, "give both t1 and t2"), ({"t1": (3.0, 0.0), "t2": (6.0, 0.0)}, "parallel")],
)
def test_bad_vectors(picture: Path, vectors: dict[str, tuple[float, float]], message: str) -> None:
    """One vector without the other, and parallel ones, are refused."""
    with pytest.raises(BadInput, match=message):
        Images(picture, **vectors)


def test_missing_picture(tmp_path: Path) -> None:
    """A picture that is not there is named."""
    with pytest.raises(BadInput, match=r"none\.png: there is no such file"):
        Images(tmp_path / "none.png").render((16, 16), np.random.default_rng(0))


def test_directory_rows(picture: Path) -> None:
    """Each picture of a directory is a row, with its lattice where truth.csv has one."""
    for name in ("a.png", "b.png"):
        write_image(picture.with_name(name), read_image(picture))
    write_image(picture.with_name("wall.old.png"), read_image(picture)).rename(picture.with_name("a.jpeg"))
    picture.with_name("notes.txt").write_text("not a picture")
    picture.with_name("truth.csv").write_text("file,t1x,t1y,t2x,t2y,notes\nwall.png,30,0,0,20.5,fine\nb.png,,,,,none\n")
    rows = Images.directory_rows(picture.parent)
    assert [row["name"] for row in rows] == ["a.jpeg", "a.png", "b", "wall"]
    assert [set(row["parameters"]) for row in rows] == [{"path"}, {"path"}, {"path"}, {"path", "t1", "t2"}]
    assert rows[3]["parameters"] == {"path": str(picture), "t1": (30.0, 0.0), "t2": (0.0, 20.5)}


def test_empty_directory(tmp_path: Path) -> None:
    """A directory without a picture is refused."""
    with pytest.raises(BadInput, match="has no picture"):
        Images.directory_rows(tmp_path)


def test_mixed_sizes(tmp_path: Path) -> None:
    """Pictures of any size, gray or color, stand side by side: each gives what it has, a broken one a failed row."""
    rng = np.random.default_rng(0)
    for name, shape in (("big", (300, 200, 3)), ("small", (30, 40, 1)), ("long", (20, 400, 3))):
        write_image(tmp_path / f"{name}.png", rng.random(shape).astype(np.float32))
    (tmp_path / "broken.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    (tmp_path / "truth.csv").write_text("file,t1x,t1y,t2x,t2y\nbig.png,10,0,0,10\n")
    drawings = {sample.row.name: sample for sample in draw_samples(load_suite(tmp_path))}
    shapes = {name: each.texture.image.shape for name, each in drawings.items() if each.texture}
    assert shapes == {"big": (100, 100, 3), "small": (30, 40, 1), "long": (20, 400, 3)}
    outputs = {name: each.shape for name, each in drawings.items() if each.texture}
    assert outputs == {"big": (200, 200), "small": (60, 80), "long": (40, 800)}
    assert "broken.png" in drawings["broken"].fault
    assert {name for name, each in drawings.items() if each.texture and each.texture.lattice} == {"big"}


LATTICES = st.builds(
    lambda a, b, shear: Lattice((a, 0.0), (shear * a, b)), st.floats(8, 200), st.floats(8, 200), st.floats(0, 0.5)
)


@given(st.tuples(st.integers(40, 2000), st.integers(40, 2000)), st.none() | LATTICES)
@settings(max_examples=200)
def test_sizes_of_a_folder(picture: Shape, lattice: Lattice | None) -> None:
    """Outputs have twice the sample's sides and 6 tiles; a smaller sample than the picture leaves the oracle room."""
    sample, output = plan_sizes(picture, lattice)
    assert all(out >= 2 * own for out, own in zip(output, sample, strict=True))
    box = np.sqrt((lattice.canonical().matrix ** 2).sum(0)) if lattice else np.full(2, 32)
    if lattice is not None:
        assert (np.array(output) >= 6 * box[::-1] - 1e-6).all()
    if sample == picture:
        return
    assert (np.array(sample) >= 4 * box[::-1]).all()
    for seed in range(4):
        corner = _region_corner(picture, sample, np.random.default_rng(seed))
        region = (*corner, corner[0] + sample[1], corner[1] + sample[0])
        assert _free_corner(picture, output, region, np.random.default_rng(0)) is not None


def test_origin_moves_with_the_crop(picture: Path) -> None:
    """Vectors stay, and a lattice point of the picture is where it was, in the crop's coordinates."""
    plugin = Images(picture, t1=(11.5, 0.2), t2=(0.0, 9.0), origin=(3.25, 1.5))
    texture = plugin.render((20, 30), np.random.default_rng(1))
    assert texture.lattice.t1 == (11.5, 0.2) and texture.lattices == (texture.lattice,)
    assert texture.lattice.origin == (3.25 - texture.region[0], 1.5 - texture.region[1])


HEADER = "file,t1x,t1y,t2x,t2y\n"


def _folder(tmp_path: Path, text: str) -> Path:
    for name in ("a.png", "b.png"):
        (tmp_path / name).touch()
    (tmp_path / "truth.csv").write_text(text, "utf-8")
    return tmp_path


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
    """Neither a truth.csv, nor a line, nor numbers in it are needed: then nothing is known of a lattice."""
    assert read_truth(tmp_path) == {}
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
        ("file,t1x,t1y,t2x\na.png,1,2,3\n", r"truth\.csv line 1: column 't2y' is missing"),
        (HEADER + "a.png,12,0,0,9\nb.png,12,zero,0,9\n", r"line 3: lattice '12,zero,0,9': give four numbers"),
        (HEADER + "c.png,12,0,0,9\n", r"line 2: there is no file 'c\.png'"),
        (HEADER + "a.png,,,,\n\na.png ,12,0,0,9\n", r"line 4: 'a\.png' occurs a second time; keep one"),
        (HEADER + "a.png,12,0,0,9,3\n", r"line 2: has 6 fields for 5 columns; quote fields that contain a comma"),
        (HEADER + "./a.png,12,0,0,9\n", r"line 2: './a\.png' is a path; give the name of a picture in the folder"),
        (HEADER + ",12,0,0,9\n", r"line 2: has no file name; give it, or delete the line"),
        ("file,t1x,t1y,t2x,t2y,originx\n", r"line 1: has only 'originx'; give both columns originx,originy, or neit"),
        (HEADER + "a.png,1,0,0,9\n", r"line 2: lattice '1,0,0,9': repeats every 1 px"),
    ],
)
def test_malformed(tmp_path: Path, text: str, message: str) -> None:
    """What is wrong is named with its file and line."""
    with pytest.raises(BadInput, match=r"truth\.csv " + message.removeprefix(r"truth\.csv ")):
        read_truth(_folder(tmp_path, text))
