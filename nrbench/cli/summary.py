"""What the running verbs say of a plan and of a run."""

from __future__ import annotations

import itertools
from collections import Counter
from pathlib import Path
from typing import Any

from nrbench.running.runner import is_cached, metrics_of
from nrbench.runs.records import FAILED, CellRecord, Run
from nrbench.runs.store import RunDirectory
from nrbench.suites.plan import Plan


def status_counts(run: Run) -> dict[str, int]:
    """Return how many cells ended in each status."""
    return dict(Counter(record.status for record in run.cells).most_common())


def failures(run: Run) -> list[str]:
    """Return one line for each cell or score that failed."""
    return [line for record in run.cells for line in _failures_of(record)]


def _failures_of(record: CellRecord) -> list[str]:
    where = f"{record.texture} / {record.method} ({record.lattice_source}, {record.key})"
    lines = [f"{where}: {record.status}: {record.message}"] if record.status in FAILED else []
    broken = {f"{name.partition('.')[0]}: {why}" for name, why in record.reasons.items() if why.startswith("failed:")}
    return lines + [f"{where}: {line}" for line in sorted(broken)]


def report_page(written: list[Path]) -> Path | None:
    """Return the page that a reader opens first, if one was written."""
    return next((path for path in written if path.suffix == ".html"), None)


def summary(run: Run, written: list[Path]) -> dict[str, Any]:
    """Return a run in short, JSON-ready: suite, counts, failures, the files written, and one entry a cell."""
    table = run.table()
    cells = table.astype(object).where(table.notna(), None).to_dict("records")
    suite = {key: run.info["suite"][key] for key in ("name", "version", "hash")}
    shown = {"run": str(run.root), "suite": suite, "status": status_counts(run), "failures": failures(run)}
    return {**shown, "written": [str(path) for path in written], "cells": cells}


def plan_summary(plan: Plan, root: Path, retry_failed: bool) -> dict[str, Any]:
    """Return what a run would find cached and what it would start."""
    directory, metrics = RunDirectory(root), metrics_of(plan.suite)
    cells = [
        {
            "key": cell.key,
            "texture": cell.texture,
            "method": cell.label,
            "lattice_source": cell.lattice_source,
            "replicate": cell.replicate,
            "cached": is_cached(directory, cell, metrics, retry_failed),
            "fault": cell.fault,
        }
        for cell, _ in plan.cells
    ]
    cached = sum(bool(cell["cached"]) for cell in cells)
    shown = {"suite": plan.suite.name, "hash": plan.suite.hash, "out": str(root)}
    return {**shown, "cached": cached, "new": len(cells) - cached, "cells": cells}


def plan_lines(found: dict[str, Any]) -> list[str]:
    """Return a plan's summary as text, one line a texture."""
    counts = f"{found['cached']} cells cached, {found['new']} new"
    head = f"suite {found['suite']} ({found['hash']}) -> {found['out']}: {counts}"
    by_texture = itertools.groupby(found["cells"], key=lambda cell: cell["texture"])
    return [head, *(f"  {texture}: {', '.join(map(_cell_text, cells))}" for texture, cells in by_texture)]


def _cell_text(cell: dict[str, Any]) -> str:
    state = "cached" if cell["cached"] else cell["fault"] or "new"
    return f"{cell['method']} ({cell['lattice_source']}) #{cell['replicate']} {state}"
