"""The Python functions of runs: start and plan them; read, compare, report, label and publish those on disk."""

from __future__ import annotations

import operator
import os
import re
import secrets
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nrbench import plugins
from nrbench.api.arguments import (
    Imagelike,
    Latticelike,
    Pluginlike,
    lattice_source_text,
    list_of,
    method_text,
    picture_file,
)
from nrbench.errors import BadInput, describe_error, strip_control
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.parameters import parse_spec, size_text
from nrbench.runs.records import CellRecord, Run
from nrbench.runs.store import FAILED, RunDirectory
from nrbench.storage import read_json
from nrbench.suites.cell import RESULTS_VERSION, Cell

# What runs cells and child processes is imported by the functions that need it: `status` only reads files.
if TYPE_CHECKING:
    import pandas as pd

    from nrbench.plugins.forms import Shape
    from nrbench.running.guard import Limits
    from nrbench.running.pace import Progress
    from nrbench.running.runner import Options
    from nrbench.suites.plan import Plan
    from nrbench.suites.suite import Suite

Runlike = Run | str | os.PathLike[str]
"""A run, or its directory."""


def run(
    suite: str | os.PathLike[str] | Suite = "default",
    *,
    methods: Sequence[Pluginlike] | Pluginlike = (),
    textures: Sequence[str] | str = (),
    lattice: Sequence[Latticelike] | str = (),
    out: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
    options: Options | None = None,
    **changes: Any,
) -> Run:
    """Run a suite and return the run; cells that have results on disk are not run again.

    Parameters
    ----------
    suite
        A suite, its name, a TOML file, or a directory of pictures.
    methods, textures, lattice
        They replace those of the suite. Methods are ``name:param=value``, or registered classes or instances of them;
        textures are shell patterns of names; lattices are entries of the lattice axis, or a :data:`Latticelike`. A
        single one needs no list.
    out
        The run directory. If None, ``runs/SUITE``, and ``runs/SUITE-fresh`` for a fresh seed.
    progress
        Called after each cell with a :class:`~nrbench.running.pace.Step`.
    options
        How to run: jobs, limits, and so on. An interrupt (Ctrl-C) stops at once. ``options.stop.set()``, called in
        ``progress`` or in another thread, lets the running cells end first. Both raise KeyboardInterrupt.
    **changes
        Other keys of the suite: ``seed``, ``replicates``, ``sample``, ``size``. The seed ``"fresh"`` is drawn from the
        system; ``run.info["suite"]["seed"]`` tells it.

    Returns
    -------
    Run
        The run, as :func:`load` returns it.

    Raises
    ------
    BadInput
        For an unknown suite, method, texture or lattice, or a class that is not registered: cells run in other
        processes, which find plugins by their names.

    Examples
    --------
    >>> import tempfile
    >>> from nrbench import Options, run
    >>> folder = tempfile.mkdtemp()
    >>> done = run(
    ...     "core",
    ...     methods="scatter",
    ...     textures="brick-mild",
    ...     size="64x64",
    ...     out=folder,
    ...     options=Options(jobs=0),
    ...     metrics=["cost"],
    ... )
    >>> done.cells[0].status
    'ok'
    """
    from nrbench.running.guard import Limits
    from nrbench.running.plugin_children import guarded_plugins
    from nrbench.running.runner import execute

    limits = Limits(options.timeout, options.memory) if options else None
    with guarded_plugins():
        plan, root = plan_cells(suite, methods, textures, lattice, out, limits=limits, **changes)
        return execute(plan, root, options, progress or (lambda step: None))


def plan_cells(
    suite: str | os.PathLike[str] | Suite,
    methods: Sequence[Pluginlike] | Pluginlike = (),
    textures: Sequence[str] | str = (),
    lattice: Sequence[Latticelike] | str = (),
    out: str | os.PathLike[str] | None = None,
    *,
    limits: Limits | None = None,
    progress: Callable[[float], None] = lambda done: None,
    seed: int | str | None = None,
    **changes: Any,
) -> tuple[Plan, Path]:
    """Return the plan of a run, and its directory.

    Parameters
    ----------
    suite, methods, textures, lattice, out, seed, **changes
        As for :func:`run`.
    limits
        The limits of the drawing of one texture.
    progress
        Called with the share of the samples that are drawn, in [0, 1].

    Raises
    ------
    BadInput
        As for :func:`run`.
    """
    from nrbench.running.plugin_children import LIMITS, plan_run

    chosen = find_suite(suite)
    specs = [method_text(method) for method in list_of(methods)]
    sources = [lattice_source_text(each) for each in ([lattice] if isinstance(lattice, Lattice) else list_of(lattice))]
    root = run_directory(out, chosen, seed)
    changes |= choose_seed(seed, root)
    return plan_run(changed(chosen, specs, sources, **changes), list_of(textures), limits or LIMITS, progress), root


def find_suite(suite: str | os.PathLike[str] | Suite) -> Suite:
    """Return a suite, or load it by its name or from its file or directory."""
    from nrbench.suites.suite import Suite, load_suite

    return suite if isinstance(suite, Suite) else load_suite(suite if isinstance(suite, str) else Path(suite))


def audit(
    method: Pluginlike,
    suite: str | os.PathLike[str] | Suite = "default",
    *,
    textures: Sequence[str] | str = (),
    replicates: int | None = None,
    out: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
    options: Options | None = None,
) -> Any:
    """Compare the quality of a method at the published seed of a suite with its quality at a fresh one.

    A method that knows the published samples loses its quality where it has not seen the samples. The test changes the
    sign of the difference of each texture: for any other method both draws of a texture are alike.

    Parameters
    ----------
    method
        ``name:param=value``, or a registered class or an instance of it.
    suite
        A suite of texture models, its name, or a TOML file.
    textures
        As for :func:`run`.
    replicates
        Number of draws of each texture at each seed. More draws find smaller differences.
    out
        Directory of the two runs ``published`` and ``fresh``; ``runs/audit-METHOD`` if None. If it holds an audit,
        that audit is resumed with its fresh seed.
    progress, options
        As for :func:`run`.

    Returns
    -------
    nrbench.reports.changes.RunChanges
        The changes from the published to the fresh run, one for each source of the lattice.

    Raises
    ------
    BadInput
        As for :func:`run`, and if the suite holds photographs, which no seed draws again.

    Examples
    --------
    ``audit("rsgf").changes[0].state`` is ``"worse"`` if the method is worse at the fresh seed, ``"noise"`` if its
    quality moved by no more than other draws move it, and ``"unknown"`` if fewer than six textures were run.
    """
    chosen = find_suite(suite)
    for row in chosen.texture:
        if not getattr(plugins.find("datasets", row.dataset).cls, "procedural", True):
            raise BadInput(f"texture {row.name}: is a picture, which no seed draws again; audit a suite of models")
    spec = method_text(method)
    folder = Path(out) if out is not None else Path("runs") / f"audit-{parse_spec(spec)[0]}"
    runs = [
        run(
            chosen,
            methods=spec,
            metrics=["quality"],
            textures=textures,
            out=folder / name,
            progress=progress,
            options=options,
            replicates=replicates,
            **seed,
        )
        for name, seed in (("published", {}), ("fresh", {"seed": "fresh"}))
    ]
    return compare(runs[0], runs[1], "quality.score")


def load(path: str | os.PathLike[str]) -> Run:
    """Return a run that is on disk.

    Parameters
    ----------
    path
        The run directory.

    Returns
    -------
    Run
        Its cells, tables and plot.

    Raises
    ------
    BadInput
        If the directory is no run.

    Examples
    --------
    >>> import tempfile
    >>> from nrbench import Options, load, run
    >>> folder = tempfile.mkdtemp()
    >>> _ = run(
    ...     "core",
    ...     methods="scatter",
    ...     textures="brick-mild",
    ...     size="64x64",
    ...     out=folder,
    ...     options=Options(jobs=0),
    ...     metrics=["cost"],
    ... )
    >>> load(folder).cells[0].status
    'ok'
    """
    from nrbench.runs.records import Run

    found = Run(Path(path))
    _ = found.info
    return found


def as_run(run: Run | str | os.PathLike[str]) -> Run:
    """Return a run, or that of a directory as :func:`load`."""
    return load(run) if isinstance(run, str | os.PathLike) else run


def compare(
    first: Run | str | os.PathLike[str], second: Run | str | os.PathLike[str], columns: str | Sequence[str] = ()
) -> Any:
    """Compare a run with an earlier one: which scores moved, and whether by more than draws move them.

    Parameters
    ----------
    first, second
        The earlier and the later run, or their directories.
    columns
        The scores, as a list or joined by commas; empty for the headlines, the share of preserved lattices and the
        seconds.

    Returns
    -------
    nrbench.reports.changes.RunChanges
        The changes. ``table()`` is a table with one row for each method and score, which a notebook shows; ``worse``
        lists those for the worse, ``notes`` says what the table does not.

    Raises
    ------
    BadInput
        If a directory is no run, or neither run has a score that was named.

    Examples
    --------
    >>> import tempfile
    >>> from nrbench import Options, compare, run
    >>> folder = tempfile.mkdtemp()
    >>> done = run(
    ...     "core",
    ...     methods="scatter",
    ...     textures="brick-mild",
    ...     size="64x64",
    ...     out=folder,
    ...     options=Options(jobs=0),
    ...     metrics=["cost"],
    ... )
    >>> set(compare(folder, done).table()["state"])
    {'same'}
    """
    runs = [as_run(first), as_run(second)]
    names = columns.split(",") if isinstance(columns, str) else columns
    return plugins.build("reports", "changes", {"baseline": runs[0].root, "columns": tuple(names)}).compare(runs[1])


def choose_seed(seed: int | str | None, root: Path) -> dict[str, Any]:
    """Return the changes of a suite that give it a seed: a number, or ``"fresh"`` for one that the system draws.

    A run directory that holds a run of a fresh seed keeps this seed, so that the same command resumes the run.

    Raises
    ------
    BadInput
        For another word.
    """
    if seed is None:
        return {}
    if seed != "fresh":
        try:
            return {"seed": operator.index(seed), "fresh_seed": False}  # type: ignore[arg-type]
        except TypeError:
            raise BadInput(f"seed {seed!r}: give a whole number from 0 on, or 'fresh'") from None
    from nrbench.runs.store import RUN_FILE

    content = ((read_json(root / RUN_FILE) or {}).get("suite") or {}).get("content") or {}
    drawn = content["seed"] if content.get("fresh_seed") is True else secrets.randbelow(10**12)
    return {"seed": drawn, "fresh_seed": True}


def run_directory(out: str | os.PathLike[str] | None, suite: Suite, seed: int | str | None) -> Path:
    """Return the directory of a run: ``out``, or ``runs/SUITE``, or ``runs/SUITE-fresh`` for a fresh seed."""
    return Path(out) if out is not None else Path("runs") / (suite.name + ("-fresh" if seed == "fresh" else ""))


def changed(suite: Suite, methods: Sequence[str] = (), lattice: Sequence[str] = (), **changes: Any) -> Suite:
    """Return a suite with the options of a command line applied; a size replaces that of every texture."""
    given = {key: value for key, value in changes.items() if value is not None}
    if methods:
        given["methods"] = list(methods)
    if lattice:
        given["lattice"] = list(lattice)
    own = {key: None for key in ("sample", "size") if key in given}
    if own:
        given["texture"] = [{**row.model_dump(mode="json"), **own} for row in suite.texture]
    return suite.with_changes(**given) if given else suite


def plan(
    suite: str | os.PathLike[str] | Suite = "default",
    *,
    methods: Sequence[Pluginlike] | Pluginlike = (),
    textures: Sequence[str] | str = (),
    lattice: Sequence[Latticelike] | str = (),
    out: str | os.PathLike[str] | None = None,
    retry_failed: bool = False,
    **changes: Any,
) -> pd.DataFrame:
    """List the cells that :func:`~nrbench.run` would reuse and those that it would start. Nothing is started.

    Parameters
    ----------
    suite, methods, textures, lattice, out
        As for :func:`~nrbench.run`.
    retry_failed
        Whether failed cells would run again.
    **changes
        As for :func:`~nrbench.run`.

    Returns
    -------
    pandas.DataFrame
        One row for each cell, whose results are on disk if it is ``cached``. ``fault`` says why a cell cannot run.

    Raises
    ------
    BadInput
        As for :func:`~nrbench.run`.

    Examples
    --------
    >>> from nrbench import plan
    >>> plan("core", methods="scatter", textures="brick-mild", out="runs/mine")["cached"].tolist()
    [False]
    """
    import pandas as pd

    from nrbench.running.plugin_children import guarded_plugins

    with guarded_plugins():
        planned, root = plan_cells(suite, methods, textures, lattice, out, **changes)
        return pd.DataFrame(plan_summary(planned, root, retry_failed)["cells"])


def status(run: Runlike) -> dict[str, Any]:
    """Return the number of cells of a run with each status, and the cells that failed.

    Parameters
    ----------
    run
        The run, or its directory.

    Returns
    -------
    dict
        The ``run``, the number of its ``cells``, their number by ``status``, and a line for each of the ``failures``.

    Raises
    ------
    BadInput
        If the directory is no run.

    Examples
    --------
    ``status("runs/default")["status"]`` is ``{"ok": 741, "refused": 3}``.
    """
    read = as_run(run)
    cells = read.ends()
    return {
        "run": str(read.root),
        "cells": len(cells),
        "status": status_counts(cells),
        "failures": failures(cells),
    }


def report(
    run: Runlike, format: Sequence[str] | str = (), *, labels: Sequence[str | os.PathLike[str]] = (), **parameters: Any
) -> list[Path]:
    """Write the reports of a run again from its files. No cell is run.

    Parameters
    ----------
    run
        The run, or its directory.
    format
        The reports, as ``"html,latex:width=column"`` or as a list of such texts; all if empty.
    labels
        Files with answers to pages of :func:`label`, one for each labeler.
    **parameters
        Parameters of all reports that have them: ``single_file``, ``tests``, ``population``, and so on.

    Returns
    -------
    list of Path
        The files. A report that fails is left out with a warning.

    Raises
    ------
    BadInput
        If the directory is no run, or for an unknown report, parameter or file of answers.

    Examples
    --------
    ``report("runs/default", "html,latex:width=column")`` writes the page and the tables of an article.
    """
    from nrbench.labelling.labels import read_labelers

    read, files = as_run(run), tuple(map(Path, labels))
    read_labelers(read, files)
    wanted = parse_formats([format] if isinstance(format, str) else format) if format else None
    return write_reports(read, wanted, shared={"labels": files, **parameters})[0]


def label(
    run: Runlike,
    output: str | os.PathLike[str] | None = None,
    *,
    repeat: float = 0.1,
    seed: int = 0,
    questions: Sequence[str] | str = "lattice,elements,more",
) -> Path:
    """Write a page on which people label the outputs of a run, without the methods' names.

    Parameters
    ----------
    run
        The run, or its directory.
    output
        The page; if None, it lies in the folder ``labels`` of the run, beside its key.
    repeat
        Share of the outputs that are shown twice.
    seed
        Seed of the items' order and ids.
    questions
        The questions about each output in this order, as a list or joined by commas.

    Returns
    -------
    Path
        The page. :func:`report` reads the answers that it saves.

    Raises
    ------
    BadInput
        If the directory is no run, or for an unknown question, or if the page cannot be written there.

    Examples
    --------
    ``label("runs/default", repeat=0.2, questions="lattice")`` asks one question, and a fifth of the outputs twice.
    """
    from nrbench.labelling.labels import write_page

    asked = questions.split(",") if isinstance(questions, str) else questions
    return write_page(as_run(run).root, None if output is None else Path(output), repeat, seed, asked)[0]


def site(runs: Sequence[Runlike], output: str | os.PathLike[str]) -> list[Path]:
    """Write a static site that compares runs, such as those of several people.

    Parameters
    ----------
    runs
        The runs, or their directories.
    output
        The directory of the pages. It is made if it does not exist.

    Returns
    -------
    list of Path
        The pages, and the files that they show.

    Raises
    ------
    BadInput
        If a directory is no run.

    Examples
    --------
    ``site(["runs/mine", "runs/yours"], "site")`` writes ``site/index.html`` and the pages that it links.
    """
    loaded, folder = [as_run(each) for each in runs], Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    written: list[Path] = plugins.build("reports", "site", {"runs": tuple(each.root for each in loaded)}).write(
        loaded[0], folder
    )
    return written


def sheet(
    photo: Imagelike,
    output: str | os.PathLike[str],
    *,
    methods: Sequence[Pluginlike] | Pluginlike = (),
    sample: str | Shape = "384x384",
    size: str | Shape = "384x384",
    lattice: Latticelike = "consensus",
    seed: int = 0,
    progress: Progress | None = None,
    options: Options | None = None,
) -> pd.DataFrame:
    """Show what all methods make of a photograph on one sheet, the best first.

    The lattice is detected once and given to all methods that use one.

    Parameters
    ----------
    photo
        The photograph.
    output
        The file of the sheet. It is not written if no method has an output.
    methods
        As for :func:`~nrbench.run`. All that are no references and need no parameter if empty.
    sample, size
        The largest sample, to which the photograph is cropped, and the size of the outputs.
    lattice
        The lattice of the photograph, or the detector that finds it.
    seed
        Equal seeds give equal outputs.
    progress, options
        As for :func:`~nrbench.run`.

    Returns
    -------
    pandas.DataFrame
        One row for each method: its status, its quality, whether this is an upper bound, the perils that set it,
        where it is below 1, and those that were not measured, the seconds, and why it has no output.

    Raises
    ------
    BadInput
        For a bad photograph, size, method or lattice.

    Examples
    --------
    ``sheet("wall.png", "sheet.png", methods=["rsgf", "resample"])`` shows the sample and two outputs.
    """
    import pandas as pd

    return pd.DataFrame(sheet_rows(photo, Path(output), methods, sample, size, lattice, seed, progress, options))


def sheet_rows(
    photo: Imagelike,
    output: Path,
    methods: Sequence[Pluginlike] | Pluginlike,
    sample: str | Shape,
    size: str | Shape,
    lattice: Latticelike,
    seed: int,
    progress: Progress | None,
    options: Options | None,
) -> list[dict[str, Any]]:
    """Write the sheet of a photograph, and return the rows of :func:`sheet`; the arguments are the same."""
    from nrbench.api.photo_sheet import draw_sheet, photo_suite, rate_outputs
    from nrbench.pictures.files import write_image
    from nrbench.running.runner import execute

    with tempfile.TemporaryDirectory() as folder:
        suite = photo_suite(picture_file(photo, Path(folder)), sample, size)
        cells, root = plan_cells(suite, methods, (), [lattice], Path(folder) / "run", seed=seed)
        rated = rate_outputs(execute(cells, root, options, progress or (lambda step: None)).cells)
        made = [pair for pair in rated if pair[0].status == "ok"]
        if made:
            write_image(output, draw_sheet(made))
    return [row for _, row in rated]


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
    tell: Callable[[str], None] = warnings.warn,
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
    tell
        Called with a sentence about each report that fails.

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
        tell(
            f"{run.root} was made by results version {strip_control(str(made_by))}, and this nrbench has "
            f"{RESULTS_VERSION}: its scores are left out; run the same command again, or use the nrbench that made it"
        )
    if formats is None:
        formats = {name: {} for name in working_plugins("reports")}
    reports = {name: build_report(name, shared or {}, given) for name, given in formats.items()}
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
            tell(f"report {name} failed: {describe_error(error)}")
        if progress:
            progress(number, len(wanted), name)
    return written, broken


def _folder(report: Any) -> str:
    return str(getattr(report, "folder", "report"))


def build_report(name: str, shared: Mapping[str, Any], given: Mapping[str, Any]) -> Any:
    """Return a report with its own parameters, and those shared ones that it has."""
    cls: Any = plugins.find("reports", name).cls
    known = {field.name for field in fields(cls)}
    return plugins.build("reports", name, {**{key: shared[key] for key in shared if key in known}, **given})
