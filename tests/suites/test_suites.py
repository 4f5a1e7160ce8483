"""Suites: what they promise of their textures, grids, and what is wrong in a file."""

from typing import Any

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view

from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.imaging.convert import Image, to_bytes
from nrbench.plugins.parameters import parse_size
from nrbench.suites.plan import Sample, draw_samples, make_plan
from nrbench.suites.suite import Suite, builtin, load_suite, validated_suite

CORE = draw_samples(load_suite("core"))


def windows(image: Image, side: int = 16) -> set[bytes]:
    """Return every square window of an image as bytes."""
    views = sliding_window_view(to_bytes(image), (side, side), axis=(0, 1))
    return {window.tobytes() for row in views for window in row}


@pytest.mark.parametrize("sample", CORE, ids=lambda sample: sample.row.name)
def test_no_window_of_the_oracle_occurs_in_the_sample(sample: Sample) -> None:
    """A fresh draw shares no 16 x 16 window with the sample: it is independent of it, not a copy."""
    fresh = sample.recipe.again(sample.texture)((256, 256), 0)
    assert not windows(sample.texture.image) & windows(fresh.image)


@pytest.mark.parametrize("name", builtin())
def test_every_suite_loads(name: str) -> None:
    """Each installed suite is valid, says what it is, and names methods and textures."""
    suite = load_suite(name)
    assert suite.name == name and suite.description and suite.all_methods and suite.texture


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"name": "x"}, "has no texture"),
        ({"name": "x", "sed": 3, "texture": [{"name": "a", "dataset": "brick"}]}, "did you mean 'seed'"),
        ({"name": "x", "texture": [{"name": "a", "dataset": "brick"}] * 2}, "two textures have the name 'a'"),
        ({"name": "x", "texture": [{"name": "a", "data": "brick"}]}, "did you mean 'dataset'"),
        ({"name": "x", "size": "3", "texture": [{"name": "a", "dataset": "brick"}]}, "write WIDTHxHEIGHT"),
        ({"name": "x", "seed": -1, "texture": [{"name": "a", "dataset": "brick"}]}, "seed"),
        ({"name": "a/b", "texture": [{"name": "a", "dataset": "brick"}]}, "name"),
    ],
)
def test_bad_suites(content: dict[str, object], message: str) -> None:
    """Each mistake in a suite is named, with the nearest valid key where there is one."""
    with pytest.raises(BadInput, match=message):
        validated_suite(content, "suite x")


def test_sizes() -> None:
    """``WIDTHxHEIGHT`` becomes (height, width)."""
    assert parse_size("256x128") == (128, 256)
    for bad in ("256", "0x3", "x", "3x-1", "99999x3", "axb"):
        with pytest.raises(BadInput, match=r"WIDTHxHEIGHT|from 1 to"):
            parse_size(bad)


def test_samples_are_rounded_to_8_bits() -> None:
    """The sample that a method sees is the one that the PNG holds."""
    texture = CORE[0].texture
    np.testing.assert_array_equal(texture.image, to_bytes(texture.image) / np.float32(255))


PATTERNS = [{"dataset": "brick", "title": "Running bond"}, {"dataset": "weave", "title": "Plain weave", "figure": 4}]
STRENGTHS = [
    {"strength": "mild", "level": 1, "parameters": {"color": 0.1}},
    {"strength": "strong", "level": 0.5, "size": "{side}x40", "side": 30, "parameters": {"color": 0.5, "noise": 0.1}},
]
GRID = {
    "name": "{dataset}-{strength}-{level}",
    "description": "{title} with {strength} colors.",
    "parameters": {"noise": 0.02},
    "axes": [PATTERNS, STRENGTHS],
}


def _suite(*grids: Any, **more: Any) -> Suite:
    return validated_suite({"name": "x", "grid": list(grids), **more}, "suite x")


def test_a_grid_is_a_product() -> None:
    """Each combination of entries is a texture; the last axis varies fastest, and the later axis wins."""
    rows = _suite(GRID, texture=[{"name": "first", "dataset": "noise"}]).texture
    names = ["first", "brick-mild-1", "brick-strong-0.5", "weave-mild-1", "weave-strong-0.5"]
    assert [row.name for row in rows] == names
    assert [row.parameters for row in rows[1:3]] == [{"noise": 0.02, "color": 0.1}, {"noise": 0.1, "color": 0.5}]
    assert [row.figure for row in rows] == [None, None, None, 4, 4]
    assert rows[4].size == (40, 30) and rows[4].level == 0.5 and rows[3].size is None
    assert rows[3].description == "Plain weave with mild colors."


def test_a_grid_is_only_a_notation() -> None:
    """A suite written with a grid has the hash of the suite that lists the rows."""
    listed = [row.model_dump(mode="json") for row in _suite(GRID).texture]
    assert validated_suite({"name": "x", "texture": listed}, "suite x").hash == _suite(GRID).hash


def test_a_grid_without_axes_is_one_texture() -> None:
    """Such a grid puts a texture after the rows of other grids."""
    rows = _suite(GRID, {"name": "last", "dataset": "noise"}).texture
    assert len(rows) == 5 and rows[4].name == "last" and rows[4].dataset == "noise"


@pytest.mark.parametrize(
    ("grid", "message"),
    [
        ({**GRID, "parameter": {}}, r"grid\.0: key 'parameter' is not known.*did you mean 'parameters'"),
        ({**GRID, "name": "{dataset}"}, "two textures have the name 'brick'"),
        (3, "write .*grid"),
    ],
)
def test_bad_grids(grid: Any, message: str) -> None:
    """Each mistake in a grid is named with the grid's number."""
    with pytest.raises(BadInput, match=message):
        _suite(grid)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("core", "c041f4a38412f8b9"),
        ("default", "168674524b60da81"),
        ("detectors", "09c667a09afa7980"),
        ("frontier", "e4e5965bfe1e7eea"),
        ("integer", "4b1554bbac1f0b58"),
        ("papers", "8ba8b2a9e560793b"),
        ("spectrum", "b7a4da8b92db0cc7"),
        ("validation", "7694e7f2d8aef438"),
    ],
)
def test_installed_suites_keep_their_content(name: str, content: str) -> None:
    """The content hashes of the suites are pinned: a run is compared with an older one by them."""
    assert load_suite(name).hash == content


def test_the_suite_of_the_papers_has_all_presets_but_four() -> None:
    """Each method with a preset stands there twice, apart from a choice of two others and three that are slow."""
    left_out = {"auto", "texture-optimization", "gpnn", "gpdm"}
    classes = {name: plugins.find("synthesizers", name).cls for name in plugins.names("synthesizers")}
    names = {name for name, cls in classes.items() if getattr(cls, "presets", {})} - left_out
    assert sorted(load_suite("papers").methods) == sorted([*names, *(f"{name}:preset=paper" for name in names)])


def test_a_run_of_too_many_cells_is_refused_before_a_sample_is_drawn() -> None:
    """The message has the number of cells and its factors."""
    suite = load_suite("core").with_changes(replicates=100_000, methods=("tiling",))
    with pytest.raises(BadInput, match=r"this one would have 4,200,000 \(21 textures, 100,000 replicates, 1 methods"):
        make_plan(suite)
    with pytest.raises(BadInput, match=r"20,000 samples at most, this one would draw 1 textures 100,000 times"):
        make_plan(suite, ["brick-mild"])
