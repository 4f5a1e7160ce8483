"""Write the comparison as JSON: the tree form of the tables that :mod:`.csv` writes as files."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from nrbench.errors import strip_control
from nrbench.runs.records import Run
from nrbench.storage import write_files

from .statistics.expectations import compare_with_published
from .statistics.frames import improvements_table, print_patches, published_tables
from .statistics.method_comparison import Comparison, ComparisonOptions
from .statistics.summaries import MethodSummary, describe_scores


@dataclass(frozen=True)
class JsonSummary(ComparisonOptions):
    """``comparison.json``: suite, methods with all their means, textures, differences and tests.

    ``tables`` holds the rows of further tables under the names of their CSV files: the methods as published beside the
    same methods by default, table 1 of the report of 2004, and the verdicts that it published, if the run has them.

    A mean has ``value``, ``low`` and ``high`` (its 95 % interval), ``n`` and ``of``, and ``at_most``: whether it is an
    upper bound. What is not known is null. Numbers are rounded to 10 digits.
    """

    version: ClassVar[str] = "1"
    folder: ClassVar[str] = "tables"

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write ``comparison.json`` and return its path."""
        return write_files(directory, {"comparison.json": self.render(run)})

    def render(self, run: Run) -> str:
        """Return the comparison as JSON; it ends in a newline."""
        content = _content(run, self.comparison(run))
        return json.dumps(_plain(content), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _content(run: Run, comparison: Comparison) -> dict[str, Any]:
    suite = run.info.get("suite", {})
    tests, published = comparison.tests, compare_with_published(run, comparison)
    tables = {"improvements": improvements_table(comparison), "patches": print_patches(run).frame()}
    tables |= published_tables(published) if published else {}
    return {
        "suite": {name: suite.get(name) for name in ("name", "version", "hash")},
        "created": run.info.get("created"),
        "versions": {name: run.info.get("versions", {}).get(name) for name in ("nrbench", "python", "numpy", "scipy")},
        "cells": dict(comparison.counts),
        "score": comparison.score,
        "estimand": comparison.estimand,
        "leading": comparison.leading_legend,
        "columns": {
            name: {"meaning": one.meaning, "unit": one.unit, "range": one.range, "better": one.better}
            for name, one in describe_scores(run).items()
        },
        "methods": [_method(one) for one in comparison.summaries],
        "textures": [
            {
                "texture": row.texture,
                "family": row.family,
                "kind": row.kind,
                "regular_share": row.regular_share,
                "entries": {
                    method.label: {"verdict": entry.verdict, "score": entry.score, "replicates": len(entry.records)}
                    | {"upper_bound": entry.upper_bound}
                    for method, entry in zip(comparison.methods, row.entries, strict=True)
                    if entry
                },
            }
            for row in comparison.rows
        ],
        "baseline": comparison.baseline.label if comparison.baseline else None,
        "differences": [
            {"method": one.first.label, "quality": vars(one.estimate), "p": one.p} for one in comparison.against
        ],
        "tables": {name: frame.to_dict("records") for name, frame in tables.items()},
        "tests": None
        if tests is None
        else {
            "methods": [one.label for one in comparison.ranked],
            "common_textures": tests.common.tolist(),
            "cliques": tests.cliques,
            "p": tests.p.tolist(),
        },
    }


def _method(one: MethodSummary) -> dict[str, Any]:
    return {
        "method": one.method.name,
        "lattice_source": one.method.lattice_source,
        "parameters": dict(one.method.parameters),
        "reference": one.method.reference,
        "rank": one.rank,
        "leading": one.leading if one.rank else None,
        "cells": dict(one.counts),
        "means": {name: vars(mean) for name, mean in one.all_means.items()},
    }


def _plain(value: Any) -> Any:
    """Return a value that JSON can hold: rounded floats, null for what is not finite, text without control codes."""
    if isinstance(value, dict):
        return {strip_control(str(name)): _plain(one) for name, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    if isinstance(value, (bool, int)) or value is None:
        return value
    if isinstance(value, float):
        return float(f"{value:.10g}") if math.isfinite(value) else None
    return strip_control(str(value))
