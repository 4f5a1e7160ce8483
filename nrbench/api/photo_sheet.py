"""What all methods make of one photograph, on one sheet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.imaging.convert import Image
from nrbench.pictures.files import read_image
from nrbench.pictures.overlays import contact_sheet, draw_lattice
from nrbench.plugins.parameters import parse_size, size_text
from nrbench.runs.records import CellRecord
from nrbench.suites.suite import Suite, validated_suite

_COLUMNS = (4, 5, 6)
"""Numbers of columns of which one is chosen."""
_LETTERS = 15
"""px; height of the letters."""
_PERILS = ("regularity", "integrity", "randomness", "appearance")


def photo_suite(photo: Path, sample: Any, size: Any) -> Suite:
    """Return a suite of one photograph with all methods that are no references and need no parameter."""
    height, width = map(min, read_image(photo).shape[:2], parse_size(sample))
    row = {"name": "photo", "dataset": plugins.in_role("pictures"), "parameters": {"path": str(photo.absolute())}}
    content = {
        "name": "sheet",
        "sample": f"{width}x{height}",
        "size": size_text(parse_size(size)),
        "metrics": ["quality"],
        "methods": [name for name in plugins.names("synthesizers") if _runs_alone(name)],
        "texture": [row],
    }
    return validated_suite(content, "sheet")


def _runs_alone(name: str) -> bool:
    """Return whether a method is no reference and can be built without a parameter."""
    try:
        return not getattr(plugins.build("synthesizers", name), "reference", False)
    except BadInput:
        return False


def rate_outputs(records: Sequence[CellRecord]) -> list[tuple[CellRecord, dict[str, Any]]]:
    """Return each cell and its row of the sheet's table: the best first, then those without an output."""
    rated = [(one, _rate(one)) for one in records]
    return sorted(rated, key=lambda pair: (pair[0].status != "ok", -(pair[1]["quality"] or 0)))


def _rate(one: CellRecord) -> dict[str, Any]:
    perils = {name: one.values.get(f"quality.{name}") for name in _PERILS}
    scores = {name: float(score) for name, score in perils.items() if score is not None}
    bound = one.values.get("quality.complete") is False
    return {
        "method": one.method,
        "status": one.status,
        "quality": one.values.get("quality.score"),
        "upper_bound": bound,
        "worst": [name for name, score in scores.items() if score == min(scores.values()) < 1],
        "not_measured": [name for name in perils if name not in scores] if bound else [],
        "seconds": one.seconds,
        "message": one.message,
    }


def describe_row(row: Mapping[str, Any]) -> str:
    """Return the method, its quality and its seconds, and what limits the quality, in three lines."""
    value, bound = row["quality"], "at most " if row["upper_bound"] else ""
    quality = "quality not measured" if value is None else f"quality {bound}{value:.2f}"
    words = (("worst: ", row["worst"]), ("not measured: ", row["not_measured"]))
    why = "; ".join(title + ", ".join(names) for title, names in words if names)
    return f"{row['method']}\n{quality}, {row['seconds'] or 0:.1f} s\n{why}"


def draw_sheet(made: Sequence[tuple[CellRecord, Mapping[str, Any]]]) -> Image:
    """Return the sample with its lattice, and the outputs, each below its caption."""
    records = [one for one, _ in made]
    sample = read_image(records[0].folder / "sample.png")
    lattice = next((one.cell.lattice_given for one in records if one.cell.lattice_given), None)
    first = sample if lattice is None else draw_lattice(sample, lattice)
    found = "no lattice" if lattice is None else "lattice " + ",".join(f"{x:.2f}" for x in (*lattice.t1, *lattice.t2))
    columns = min(_COLUMNS, key=lambda count: (-(len(made) + 1) % count, count))  # the fewest empty places
    outputs = [read_image(one.folder / "output.png") for one in records]
    captions = [f"sample\n{found}", *(describe_row(row) for _, row in made)]
    return contact_sheet([first, *outputs], captions, columns, _LETTERS)
