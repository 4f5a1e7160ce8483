"""Write the reports of a run, and say how its cells ended."""

from __future__ import annotations

import contextlib
import re
import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any

from nrbench import plugins
from nrbench.errors import BadInput, describe_error, strip_control
from nrbench.plugins.parameters import parse_spec
from nrbench.runs.records import CellRecord, Run
from nrbench.runs.store import FAILED, RUN_FILE
from nrbench.storage import make_writable
from nrbench.suites.cell import RESULTS_VERSION


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
    progress: Callable[[int, int, str], None] | None = None,
    tell_failure: Callable[[str], None] = warnings.warn,
    output: Path | None = None,
) -> list[Path]:
    """Write the reports of a run.

    A report with a method ``begin(run, directory)`` begins first and ends last: its slow part is done beside others.

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
    progress
        Called after each report with the number of reports done, of all, and the name of the last one.
    tell_failure
        Called with a sentence about each report that fails.
    output
        The directory of their folders; None: that of the run.

    Returns
    -------
    list of Path
        The files that were written.

    Raises
    ------
    BadInput
        If the directory cannot be written, or is that of another run.
    """
    from nrbench.running.runner import working_plugins

    made_by = run.info.get("results_version")
    if made_by != RESULTS_VERSION:
        warnings.warn(
            f"{run.root} was made by results version {strip_control(str(made_by))}, and this nrbench has "
            f"{RESULTS_VERSION}: its scores are left out; run the same command again, or use the nrbench that made it",
            stacklevel=2,
        )
    if formats is None:
        formats = {name: {} for name in working_plugins("reports")}
    reports = {name: build_report(name, shared or {}, given) for name, given in formats.items()}
    wanted = {name: report for name, report in reports.items() if not tables_only or _folder(report) == "tables"}
    root = run.root if output is None else output
    if (root / RUN_FILE).exists() and not root.samefile(run.root):
        raise BadInput(f"-o {root}: is another run, whose reports would be lost; pass another directory")
    for folder in sorted({root / _folder(report) for report in wanted.values()}):
        make_writable(folder, "write the reports to another directory with -o DIR")
    written: dict[str, list[Path]] = {name: [] for name in wanted}
    jobs = {name: partial(report.write, run, root / _folder(report)) for name, report in wanted.items()}
    for name, report in wanted.items():
        if hasattr(report, "begin"):
            jobs[name] = jobs.pop(name)
            with contextlib.suppress(Exception):  # its method write then says why
                jobs[name] = report.begin(run, root / _folder(report))
    for number, (name, write) in enumerate(jobs.items(), 1):
        try:
            written[name] = [Path(path) for path in write()]
        except (Exception, SystemExit) as error:
            tell_failure(f"report {name} failed: {describe_error(error)}")
        if progress:
            progress(number, len(wanted), name)
    return [path for paths in written.values() for path in paths]


def _folder(report: Any) -> str:
    return str(getattr(report, "folder", "report"))


def build_report(name: str, shared: Mapping[str, Any], given: Mapping[str, Any]) -> Any:
    """Return a report with its own parameters, and those shared ones that it has."""
    cls: Any = plugins.find("reports", name).cls
    known = {field.name for field in fields(cls)}
    return plugins.build("reports", name, {**{key: shared[key] for key in shared if key in known}, **given})
