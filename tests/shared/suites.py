"""Suites of one wall, for tests of runs."""

from pathlib import Path
from typing import Any

from nrbench.runs.records import Run
from nrbench.suites.suite import Suite, validated_suite

WALL = {"name": "wall", "dataset": "brick", "parameters": {"color": 0.2}}


def wall_suite(methods: list[str], *metrics: str, **more: Any) -> Suite:
    """Return a suite of one brick wall, 64 x 64 px, scored by some metrics."""
    content = {"name": "small", "sample": "64x64", "size": "64x64", "methods": methods, "metrics": list(metrics)}
    return validated_suite({**content, "texture": [WALL], **more}, "test")


def write_sleepers(folder: Path, replicates: int) -> Path:
    """Write a suite of cells that sleep until the folder has a file ``awake``; return its path."""
    suite = folder / "s.toml"
    suite.write_text(
        f'name = "s"\nsample = "64x64"\nsize = "64x64"\nmethods = ["sleeper:until={folder / "awake"}"]\n'
        f'metrics = ["cost"]\nreplicates = {replicates}\ntexture = [{{ name = "wall", dataset = "brick" }}]\n'
    )
    return suite


def scores(found: Run, *left_out: str) -> list[tuple[object, ...]]:
    """Return all that a table holds of each cell, but what it cost and some columns."""
    table, left_out = found.table(), ("seconds", "peak_mib", *left_out)
    kept = [name for name in table.columns if not name.startswith("cost.") and name not in left_out]
    return list(table[kept].astype(object).where(table[kept].notna(), None).itertuples(index=False, name=None))
