"""One table holds all numbers by which outputs are judged."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from nrbench import metrics
from nrbench.metrics.perception import limits
from nrbench.metrics.quality import PERILS, Quality

FOLDER = Path(metrics.__path__[0])
SEAMS = "seam_detection"
"""The lines of ``appearance.seam``, a column that is no part of a score."""
ALLOWED = {
    "COLORS": "colors of a picture",
    "_COLOR": "color of a picture",
    "_DIM": "colors of a picture",
    "_DISTANCES": "where the parts of an element are sampled",
    "_LEAST_SHOWN": "what a picture marks",
    "_LEAST_SHARE": "how much of a cell must be known",
    "_ROUGHLY": "the first of several rounds of an estimate",
    "_WITHOUT_LATTICE": "side of a window where there is no cell",
}
"""Names of fractions outside the table, with what they are: none decides how good an output is."""


def used_modules() -> dict[str, Path]:
    """Return the files of the metrics that the four perils use, by their path in the folder."""
    found: dict[str, Path] = {}
    waiting = [FOLDER / "quality.py"]
    while waiting:
        file = waiting.pop()
        name = str(file.relative_to(FOLDER))
        if name in found or name == "perception/limits.py" or name.startswith(SEAMS):
            continue
        found[name] = file
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.level:
                base = file.parents[node.level - 1].joinpath(*(node.module or "").split("."))
                waiting += [
                    path
                    for path in (base.with_suffix(".py"), *(base / f"{a.name}.py" for a in node.names))
                    if path.exists()
                ]
    return found


def find_fractions(file: Path) -> Iterator[str]:
    """Yield the upper-case names that a module binds to a value with a fraction in it."""
    for node in ast.parse(file.read_text("utf-8")).body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = [name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)]
            values = [part.value for part in ast.walk(node.value) if isinstance(part, ast.Constant)]
            if any(isinstance(value, float) for value in values):
                yield from (name for name in names if name.isupper())


def test_no_other_module_binds_a_number_that_decides() -> None:
    """Outside the table, modules of the perils bind no fractions but colors and what decides no score."""
    assert {"regularity.py", "registration/followed.py", "perception/visible.py"} <= set(used_modules())
    found = {f"{module}:{name}" for module, file in used_modules().items() for name in find_fractions(file)}
    assert {name for name in found if name.partition(":")[2] not in ALLOWED} == set()


def test_every_limit_has_a_unit_and_an_origin() -> None:
    """The table holds each number of its module once, with its value, unit and origin; there are at most 90."""
    named = {name: value for name, value in vars(limits).items() if name.isupper() and isinstance(value, float | int)}
    assert {limit.name: limit.value for limit in limits.TABLE} == named
    assert len({limit.name for limit in limits.TABLE}) == len(limits.TABLE) <= 90
    units = {"", "px", "s", "sd", "CIELAB", "JND", "20 ln", "places", "samples", "cells", "pairs"}
    for limit in limits.TABLE:
        assert limit.unit in units, limit
        assert len(limit.origin) >= 10, limit


def test_every_limit_is_used() -> None:
    """Each limit is read by a module of the perils."""
    text = "\n".join(file.read_text("utf-8") for file in used_modules().values())
    unused = {limit.name for limit in limits.TABLE if not re.search(rf"limits\.{limit.name}\b", text)}
    assert unused == set()


def test_quality_shows_the_table() -> None:
    """The metric quality lists all limits, and its perils are four."""
    assert Quality.limits == tuple(limits.TABLE)
    assert list(PERILS) == ["regularity", "integrity", "randomness", "appearance"]
