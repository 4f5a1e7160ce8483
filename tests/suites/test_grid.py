"""Claims about grids: tables of a suite that stand for several textures."""

from __future__ import annotations

from typing import Any

import pytest

from nrbench.errors import BadInput
from nrbench.suites.suite import Suite, load_suite, validated_suite

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
        ({**GRID, "description": "{titel}"}, r"grid\.0: .*'titel'.*did you mean 'title'"),
        ({**GRID, "axes": [[]]}, r"grid\.0\.axes\.0"),
        ({**GRID, "axes": 3}, r"grid\.0\.axes"),
        (
            {**GRID, "axes": [PATTERNS, [{"strength": "mild", "level": 1, "parameters": 3}]]},
            r"grid\.0\.axes\.1\.0\.par",
        ),
        ({**GRID, "name": "{dataset}"}, "two textures have the name 'brick'"),
        ({**GRID, "size": "3"}, "write WIDTHxHEIGHT"),
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
        ("core", "780b36770bccd8c9"),
        ("default", "117e3501a8740179"),
        ("frontier", "79c6c29e9724c398"),
        ("integer", "1bf655853a8029fd"),
        ("spectrum", "59af64198089eccf"),
        ("validation", "344d40b0aed92ea3"),
    ],
)
def test_installed_suites_keep_their_content(name: str, content: str) -> None:
    """The content hashes of the suites are pinned: a run is compared with an older one by them."""
    assert load_suite(name).hash == content
