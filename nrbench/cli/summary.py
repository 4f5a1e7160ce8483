"""Print plans and runs for the commands of :mod:`nrbench.cli.run_commands`."""

from __future__ import annotations

import itertools
import json
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nrbench import plugins
from nrbench.api.run_reports import build_report, failures, status_counts, unfinished
from nrbench.errors import BadInput, describe_error, strip_control
from nrbench.plugins.parameters import nearest
from nrbench.runs.records import Run
from nrbench.runs.store import RUN_FILE
from nrbench.storage import read_json, remove

if TYPE_CHECKING:
    from nrbench.suites.plan import Plan


def check_columns(names: Sequence[str]) -> None:
    """Raise :class:`~nrbench.errors.BadInput` unless each name may be a column of the table of methods."""
    for name in names:
        metric, dot, column = name.partition(".")
        if dot and column not in getattr(plugins.find("metrics", metric).cls, "columns", {}):
            known = [f"{metric}.{each}" for each in plugins.build("metrics", metric).columns]
            raise BadInput(f"column {name!r} is not known{nearest(name, known)}")
        if not dot and name not in _PLAIN_COLUMNS:
            example = "write METRIC.COLUMN, see `nrbench show METRIC`"
            raise BadInput(f"column {name!r} is not known; {example}, or one of: {', '.join(_PLAIN_COLUMNS)}")


_PLAIN_COLUMNS = ("quality", "preserved", "seconds", "peak_mib")


def left_out(root: Path, plan: Plan) -> int:
    """Return how many cells of an earlier run in a directory are not in a plan, so that its tables will lack them."""
    known = (read_json(root / RUN_FILE) if (root / RUN_FILE).is_file() else None) or {}
    keys = {cell.key for cell, _ in plan.cells}
    return sum(cell.get("key") not in keys for cell in known.get("cells", []) if isinstance(cell, dict))


def remove_stale_report(run: Run) -> Path | None:
    """Remove the HTML report of an earlier run in the same directory; return its path, or None if there is none."""
    page = run.root / "report" / "report.html"
    if not page.is_file():
        return None
    remove(page)
    return page


def print_summary(run: Run, written: list[Path], as_json: bool, columns: Sequence[str]) -> bool:
    """Print the reports for a terminal, or JSON, and all failures; return whether anything failed.

    ``columns`` are the scores of the table; empty for the headlines.
    """
    broken = False
    if as_json:
        print(json.dumps(_summary(run, written), indent=1))
    else:
        broken = _print_terminal_reports(run, columns)
        page = next((path for path in written if path.suffix == ".html"), None)
        print(f"report: {page.resolve()}" if page else f"tables: {(run.root / 'tables').resolve()}")
    failed = failures(run.cells) + unfinished(run)
    for line in failed:
        print(f"nrbench: {strip_control(line)}", file=sys.stderr)
    return bool(failed or broken)


def _print_terminal_reports(run: Run, columns: Sequence[str]) -> bool:
    """Print each report whose class variable ``terminal`` is true; its method ``render`` returns the text.

    Such a report has the parameter ``width``, and may have ``columns``. Return whether one failed.
    """
    shared: dict[str, Any] = {"width": max(40, shutil.get_terminal_size((120, 40)).columns)}
    if columns:
        shared["columns"] = tuple(columns)
    broken = False
    for plugin in plugins.inventory("reports"):
        if getattr(plugin.cls, "terminal", False):
            try:
                report = build_report(plugin.name, shared, {})
                print(report.render(run), end="")
            except (Exception, SystemExit) as error:
                broken = True
                print(f"nrbench: report {plugin.name} failed: {describe_error(error)}", file=sys.stderr)
    return broken


def _summary(run: Run, written: list[Path]) -> dict[str, Any]:
    """Return a run for JSON: suite, counts, failures, the files written, and one entry for each cell."""
    table = run.table()
    return {
        "run": str(run.root),
        "suite": {key: run.info["suite"][key] for key in ("name", "version", "hash")},
        "status": status_counts(run.cells),
        "failures": failures(run.cells),
        "written": [str(path) for path in written],
        "cells": table.astype(object).where(table.notna(), None).to_dict("records"),
    }


def plan_lines(summary: dict[str, Any]) -> list[str]:
    """Return the summary of a plan as text, one line for each texture."""
    counts = f"{summary['cached']} cells cached, {summary['new']} new"
    head = f"suite {summary['suite']} ({summary['hash']}) -> {summary['out']}: {counts}"
    by_texture = itertools.groupby(summary["cells"], key=lambda cell: (cell["texture"], _sizes_text(cell)))
    return [
        head,
        *(f"  {texture}{sizes}: {', '.join(map(_cell_text, cells))}" for (texture, sizes), cells in by_texture),
    ]


def _sizes_text(cell: dict[str, Any]) -> str:
    """Return the sizes of sample and output; empty if the sample could not be drawn."""
    return f" ({cell['sample']} -> {cell['size']} px)" if cell["sample"] else ""


def _cell_text(cell: dict[str, Any]) -> str:
    state = "cached" if cell["cached"] else cell["fault"] or "new"
    return f"{cell['method']} ({cell['lattice_source']}) #{cell['replicate']} {state}"
