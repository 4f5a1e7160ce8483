"""Print plans and runs, and write reports, for the commands of :mod:`nrbench.cli.runs`."""

from __future__ import annotations

import itertools
import json
import re
import shutil
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nrbench import plugins
from nrbench.errors import BadInput, describe_error, strip_control
from nrbench.plugins.parameters import nearest, parse_spec, size_text
from nrbench.runs.records import CellRecord, Run
from nrbench.runs.store import FAILED, RUN_FILE, RunDirectory
from nrbench.storage import read_json
from nrbench.suites.cell import RESULTS_VERSION, Cell

# What runs cells and child processes is imported by the functions that need it: `status` only reads files.
if TYPE_CHECKING:
    from nrbench.running.guard import Limits
    from nrbench.suites.plan import Plan


def status_counts(cells: Sequence[CellRecord]) -> dict[str, int]:
    """Return how many cells ended in each status."""
    return dict(Counter(record.status for record in cells).most_common())


def failures(cells: Sequence[CellRecord]) -> list[str]:
    """Return one line for each cell that failed, and one for each failure of a metric, which may concern many cells."""
    lines = [f"{_where(record)}: {record.status}: {record.message}" for record in cells if record.status in FAILED]
    failed: dict[str, list[str]] = {}
    for record in cells:
        broken = {(name.partition(".")[0], why) for name, why in record.reasons.items() if why.startswith("failed:")}
        for metric, why in sorted(broken):
            failed.setdefault(f"{metric}: {why}", []).append(_where(record))
    for what, where in failed.items():
        lines.append(f"{where[0]}: {what}" + (f" (and {len(where) - 1} more cells)" if len(where) > 1 else ""))
    return lines


def unfinished(run: Run) -> list[str]:
    """Return a line if cells have no result, because a cluster was lost or something removed them."""
    missing = [_where(record) for record in run.cells if record.status == "missing"]
    if not missing:
        return []
    which = missing[0] if len(missing) == 1 else f"{len(missing)} of {len(run.cells)} cells, such as {missing[0]}"
    return [f"no result: {which}; run the same command again"]


def _where(record: CellRecord) -> str:
    return f"{record.texture} / {record.method} ({record.lattice_source}, {record.key})"


def parse_formats(texts: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Read formats as ``html,latex:param=value,...,csv`` into their parameters by name.

    A comma starts a new format only if the name of a report follows it.

    Raises
    ------
    BadInput
        For an unknown report, or parameters that cannot be read.
    """
    names = "|".join(map(re.escape, sorted(plugins.names("reports"), key=len, reverse=True)))
    specs = [spec for text in texts for spec in re.split(rf",(?=(?:{names})(?:[:,]|$))", text)]
    formats = dict(map(parse_spec, specs))
    for name in formats:
        plugins.find("reports", name.rpartition(",")[2])
    return formats


def write_reports(
    run: Run,
    formats: Mapping[str, Mapping[str, Any]] | None = None,
    tables_only: bool = False,
    shared: Mapping[str, Any] | None = None,
    limits: Limits | None = None,
    progress: Callable[[int, int, str], None] | None = None,
) -> tuple[list[Path], bool]:
    """Write the reports of a run.

    Parameters
    ----------
    run
        The run.
    formats
        The parameters of each report, by its name; None for all reports.
    tables_only
        Whether reports other than tables are left out.
    shared
        Parameters of all reports that have them, such as the files of labelers' answers, ``labels``.
    limits
        Limits of each report of another package; None for the default ones.
    progress
        Called after each report with the number of reports done, of all, and the name of the last one.

    Returns
    -------
    written
        The paths.
    broken
        Whether any report failed.
    """
    from nrbench.running.plugin_children import LIMITS, write_guarded
    from nrbench.running.runner import working_plugins

    made_by = run.info.get("results_version")
    if made_by != RESULTS_VERSION:
        shown = strip_control(str(made_by))
        print(
            f"nrbench: {run.root} was made by results version {shown}, and this nrbench has {RESULTS_VERSION}: its "
            "scores are left out; run the same command again, or use the nrbench that made it",
            file=sys.stderr,
        )
    if formats is None:
        formats = {name: {} for name in working_plugins("reports")}
    reports = {name: _build_report(name, shared or {}, given) for name, given in formats.items()}
    wanted = {name: report for name, report in reports.items() if not tables_only or _folder(report) == "tables"}
    written: list[Path] = []
    broken, allowed = False, limits or LIMITS
    for number, (name, report) in enumerate(wanted.items(), 1):
        folder = _folder(report)
        own = plugins.find("reports", name).own
        try:
            files = report.write(run, run.root / folder) if own else write_guarded(run, name, report, folder, allowed)
            written += [Path(path) for path in files]
        except (Exception, SystemExit) as error:
            broken = True
            print(f"nrbench: report {name} failed: {describe_error(error)}", file=sys.stderr)
        if progress:
            progress(number, len(wanted), name)
    return written, broken


def _folder(report: Any) -> str:
    return str(getattr(report, "folder", "report"))


def _build_report(name: str, shared: Mapping[str, Any], given: Mapping[str, Any]) -> Any:
    """Return a report with its own parameters, and those shared ones that it has."""
    cls: Any = plugins.find("reports", name).cls
    known = {field.name for field in fields(cls)}
    return plugins.build("reports", name, {**{key: shared[key] for key in shared if key in known}, **given})


def check_columns(names: Sequence[str]) -> None:
    """Raise :class:`~nrbench.errors.BadInput` unless each name may be a column of the table of methods."""
    for name in names:
        metric, dot, column = name.partition(".")
        if dot and column not in getattr(plugins.find("metrics", metric).cls, "columns", {}):
            known = [f"{metric}.{each}" for each in plugins.build("metrics", metric).columns]
            raise BadInput(f"column {name!r} is not known{nearest(name, known)}")
        if not dot and name not in _OWN_COLUMNS:
            example = "write METRIC.COLUMN, see `nrbench show METRIC`"
            raise BadInput(f"column {name!r} is not known; {example}, or one of: {', '.join(_OWN_COLUMNS)}")


_OWN_COLUMNS = ("quality", "preserved", "seconds", "peak_mib")


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
    page.unlink()
    return page


def print_summary(run: Run, written: list[Path], as_json: bool, columns: Sequence[str] = ()) -> bool:
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
    from nrbench.running.plugin_children import write_guarded

    shared: dict[str, Any] = {"width": max(40, shutil.get_terminal_size((120, 40)).columns)}
    if columns:
        shared["columns"] = tuple(columns)
    broken = False
    for plugin in plugins.inventory("reports"):
        if getattr(plugin.cls, "terminal", False):
            try:
                report = _build_report(plugin.name, shared, {})
                text = (
                    report.render(run) if plugin.own else strip_control(write_guarded(run, plugin.name, report, None))
                )
                print(text, end="")
            except (BadInput, RuntimeError) as error:
                broken = True
                print(f"nrbench: report {plugin.name} failed: {strip_control(str(error))}", file=sys.stderr)
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


def plan_summary(plan: Plan, root: Path, retry_failed: bool) -> dict[str, Any]:
    """Return the cells of a plan for JSON, and how many a run would reuse and start."""
    # Metrics take seconds to import. No cell is cached where there is no run.
    is_done = _find_done(plan, root, retry_failed) if plan.suite.metrics or root.is_dir() else lambda cell: False
    cells = [
        {
            "key": cell.key,
            "texture": cell.texture,
            "method": cell.label,
            "lattice_source": cell.lattice_source,
            "replicate": cell.replicate,
            "sample": size_text(sample.size) if sample.size else "",
            "size": size_text(sample.shape),
            "cached": is_done(cell),
            "fault": cell.fault,
        }
        for cell, sample in plan.cells
    ]
    cached = sum(bool(cell["cached"]) for cell in cells)
    head = {"suite": plan.suite.name, "hash": plan.suite.hash, "out": str(root)}
    return {**head, "cached": cached, "new": len(cells) - cached, "cells": cells}


def _find_done(plan: Plan, root: Path, retry_failed: bool) -> Callable[[Cell], bool]:
    """Return a function that tells whether a run would reuse the results of a cell."""
    from nrbench.running.runner import find_metrics, is_cached

    directory, metrics = RunDirectory(root), find_metrics(plan.suite.metrics)
    return lambda cell: is_cached(directory, cell, metrics, retry_failed)


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
