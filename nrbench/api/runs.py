"""The Python functions of runs: start and plan them; read, compare, report, label and publish those on disk."""

from __future__ import annotations

import functools
import operator
import os
import secrets
import tempfile
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from nrbench import plugins
from nrbench.api.arguments import (
    METHOD,
    Folder,
    Latticelike,
    LatticeSources,
    Masklike,
    Methods,
    OutputFolder,
    Picture,
    Pluginlike,
    Runlike,
    SampleSize,
    Suitelike,
    SuiteSeed,
    Textures,
    as_lattice,
    lattice_source_texts,
    list_of,
    method_text,
    names_of,
    picture_file,
)
from nrbench.errors import BadInput
from nrbench.flags import ARGUMENT, Count, Flag, Number, Switch
from nrbench.plugins.parameters import parse_spec, size_text
from nrbench.storage import make_writable, read_json

# What reads and runs cells is imported by the functions that need it: the help of a command needs none of it.
if TYPE_CHECKING:
    import pandas as pd

    from nrbench.lattice.geometry import Lattice
    from nrbench.running.guard import Limits
    from nrbench.running.options import Options
    from nrbench.running.runner import OnStep
    from nrbench.runs.records import Run
    from nrbench.suites.cell import Cell
    from nrbench.suites.plan import Plan
    from nrbench.suites.suite import Suite

AuditedMethod = Annotated[Pluginlike, Flag(ARGUMENT, METHOD)]
FirstRun = Annotated[Runlike, Flag(ARGUMENT, "RUN_A", kind=Path)]
SecondRun = Annotated[Runlike, Flag(ARGUMENT, "RUN_B", kind=Path)]
Runs = Annotated["Sequence[Runlike]", Flag(ARGUMENT, "RUN...", kind=Path, many=True)]
Columns = Annotated[str | Sequence[str], Flag(metavar="NAME,...")]
Formats = Annotated[Sequence[str] | str, Flag(metavar="NAME[:param=value,...],...", many=True)]
AnswerFiles = Annotated[Sequence[str | os.PathLike[str]], Flag(metavar="FILE...", kind=Path, many=True)]
ReportFolder = Annotated["str | os.PathLike[str] | None", Flag("-o --output", "DIR", kind=Path)]
LabelFile = Annotated[str | os.PathLike[str] | None, Flag("-o", "FILE.html", kind=Path)]
SheetFile = Annotated[str | os.PathLike[str], Flag("-o --output", "SHEET.png", kind=Path)]
Share = Annotated[float, Flag(metavar="SHARE", kind=float, least=0, most=1)]


def run(
    suite: Suitelike = "default",
    *,
    methods: Methods = (),
    textures: Textures = (),
    lattice: LatticeSources = (),
    sample: SampleSize = None,
    size: SampleSize = None,
    seed: SuiteSeed = None,
    replicates: Count = None,
    out: Folder = None,
    progress: OnStep | None = None,
    options: Options | None = None,
    **changes: Any,
) -> Run:
    """Run a suite and return the run; cells that have results on disk are not run again.

    Parameters
    ----------
    suite
        A suite, its name, a TOML file, or a directory of pictures.
    methods
        A method, with parameters, preset=NAME or label=TEXT; repeatable.

        They replace those of the suite: ``name:param=value``, or classes or instances of them. A single one needs no
        list, as a single texture or lattice needs none. A class that is not registered, such as one of a notebook, runs
        in this process, without limits of time and memory.
    textures
        Run only these textures; repeatable.

        Names, or shell patterns of names. A pattern that is itself a name stands for this one.
    lattice
        The lattice that methods use: the true one, the one that each method finds, the one that a detector finds, or
        yours; repeatable.

        Entries of the lattice axis, or a :data:`Latticelike`. They replace those of the suite.
    sample
        Size of the samples.
    size
        Size of the outputs.
    seed
        Seed of the suite, or ``fresh`` for one that the system draws.

        ``run.info["suite"]["seed"]`` tells it.
    replicates
        Number of draws of each texture.
    out
        Run directory.  [default: runs/SUITE; runs/SUITE-fresh for a fresh seed]
    progress
        Called after each cell with a :class:`~nrbench.running.runner.Step`.
    options
        How to run: jobs, limits, and so on. An interrupt (Ctrl-C) stops at once. ``options.stop.set()``, called in
        ``progress`` or in another thread, lets the running cells end first. Both raise KeyboardInterrupt.
    **changes
        Other keys of the suite, such as ``metrics``.

    Returns
    -------
    Run
        The run, as :func:`load` returns it.

    Raises
    ------
    BadInput
        For an unknown suite, method, texture or lattice, or a class that is no method.

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
    from nrbench.running.runner import execute

    limits = Limits(options.timeout, options.memory) if options else None
    changes |= {"sample": sample, "size": size, "seed": seed, "replicates": replicates}
    plan, root = plan_cells(suite, methods, textures, lattice, out, limits=limits, **changes)
    return execute(plan, root, options, progress or (lambda step: None))


def plan_cells(
    suite: Suitelike = "default",
    methods: Methods = (),
    textures: Textures = (),
    lattice: LatticeSources = (),
    out: Folder = None,
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
    from nrbench.running.guard import LIMITS
    from nrbench.running.runner import plan_run

    chosen = find_suite(suite)
    specs = [method_text(method) for method in list_of(methods)]
    sources = lattice_source_texts(lattice)
    usual = Path("runs") / (chosen.name + ("-fresh" if seed == "fresh" else ""))
    root = usual if out is None else Path(out)
    changes |= choose_seed(seed, root)
    return plan_run(changed(chosen, specs, sources, **changes), list_of(textures), limits or LIMITS, progress), root


def find_suite(suite: str | os.PathLike[str] | Suite) -> Suite:
    """Return a suite, or load it by its name or from its file or directory."""
    from nrbench.suites.suite import Suite, load_suite

    return suite if isinstance(suite, Suite) else load_suite(suite if isinstance(suite, str) else Path(suite))


def audit(
    method: AuditedMethod,
    suite: Suitelike = "default",
    *,
    textures: Textures = (),
    replicates: Count = None,
    out: Folder = None,
    progress: OnStep | None = None,
    options: Options | None = None,
) -> Any:
    """Compare the quality of a method at the published seed of a suite with its quality at a fresh one.

    A method that knows the published samples loses its quality where it has not seen the samples. The test changes the
    sign of the difference of each texture: for any other method both draws of a texture are alike.

    Parameters
    ----------
    method
        ``name:param=value``, or a class or an instance of it.
    suite
        A suite of texture models, its name, or a TOML file.
    textures
        Run only these textures; repeatable.
    replicates
        Number of draws of each texture at each seed.

        More draws find smaller differences.
    out
        Directory of both runs.  [default: runs/audit-METHOD]

        It holds the runs ``published`` and ``fresh``. If it holds an audit, that audit is resumed with its fresh seed.
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


def as_run(run: Runlike) -> Run:
    """Return a run, or that of a directory as :func:`load`."""
    return load(run) if isinstance(run, str | os.PathLike) else run


def compare(first: FirstRun, second: SecondRun, columns: Columns = ()) -> Any:
    """Compare a run with an earlier one: which scores moved, and whether by more than draws move them.

    Parameters
    ----------
    first, second
        The earlier and the later run, or their directories.
    columns
        The scores.  [default: the headlines]

        As a list or joined by commas; if empty, also the share of preserved lattices and the seconds.

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
    given = {"baseline": runs[0].root, "columns": tuple(names_of(columns))}
    return plugins.build("reports", plugins.in_role("comparison"), given).compare(runs[1])


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
            digits = isinstance(seed, str) and seed.isascii() and seed.isdigit()
            return {"seed": int(seed) if digits else operator.index(seed), "fresh_seed": False}  # type: ignore[arg-type]
        except (TypeError, ValueError):
            raise BadInput(f"seed {seed!r}: give a whole number from 0 on, or 'fresh'") from None
    from nrbench.runs.store import RUN_FILE

    content = ((read_json(root / RUN_FILE) or {}).get("suite") or {}).get("content") or {}
    drawn = content["seed"] if content.get("fresh_seed") is True else secrets.randbelow(10**12)
    return {"seed": drawn, "fresh_seed": True}


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
    suite: Suitelike = "default",
    *,
    methods: Methods = (),
    textures: Textures = (),
    lattice: LatticeSources = (),
    sample: SampleSize = None,
    size: SampleSize = None,
    seed: SuiteSeed = None,
    replicates: Count = None,
    out: Folder = None,
    retry_failed: Switch = False,
    **changes: Any,
) -> pd.DataFrame:
    """List the cells that :func:`~nrbench.run` would reuse and those that it would start. Nothing is started.

    Parameters
    ----------
    suite
        As for :func:`~nrbench.run`.
    methods
        A method, with parameters, preset=NAME or label=TEXT; repeatable.
    textures
        Run only these textures; repeatable.
    lattice
        The lattice that methods use: the true one, the one that each method finds, the one that a detector finds, or
        yours; repeatable.
    sample
        Size of the samples.
    size
        Size of the outputs.
    seed
        Seed of the suite, or ``fresh`` for one that the system draws.
    replicates
        Number of draws of each texture.
    out
        Run directory.  [default: runs/SUITE; runs/SUITE-fresh for a fresh seed]
    retry_failed
        Run failed cells again.

        They then count as new ones.
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

    changes |= {"sample": sample, "size": size, "seed": seed, "replicates": replicates}
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
    from nrbench.api.run_reports import failures, status_counts

    read = as_run(run)
    cells = read.ends()
    return {
        "run": str(read.root),
        "cells": len(cells),
        "status": status_counts(cells),
        "failures": failures(cells),
    }


def report(
    run: Runlike,
    format: Formats = (),
    *,
    output: ReportFolder = None,
    labels: AnswerFiles = (),
    single_file: Switch = False,
    population: Switch = False,
    progress: Callable[[int, int, str], None] | None = None,
    tell_failure: Callable[[str], None] = warnings.warn,
    **parameters: Any,
) -> list[Path]:
    """Write the reports of a run again from its files. No cell is run.

    Parameters
    ----------
    run
        The run, or its directory.
    format
        The reports to write, e.g. html,latex:labels=...; repeatable.  [default: all]

        As ``"html,latex:width=column"`` or as a list of such texts.
    output
        Directory of the reports, for a run that cannot be written.  [default: RUN]

        It is made if it does not exist.
    labels
        Files with answers to pages, one for each labeler. The reports then compare the verdicts with them.
    single_file
        Embed all pixels of all pictures in the HTML page.
    population
        Intervals over a population of textures, of which the suite is a sample.
    progress
        Called after each report with the number of reports done, of all, and the name of the last one.
    tell_failure
        Called with a sentence about each report that fails; by default a warning.
    **parameters
        Parameters of all reports that have them, such as ``tests``.

    Returns
    -------
    list of Path
        The files. A report that fails is left out with a warning.

    Raises
    ------
    BadInput
        If the directory is no run, for an unknown report, parameter or file of answers, or if no report can be written
        there.

    Examples
    --------
    ``report("runs/default", "html,latex:width=column")`` writes the page and the tables of an article.
    """
    from nrbench.api.run_reports import parse_formats, write_reports
    from nrbench.labelling.labels import read_labels

    read, files = as_run(run), tuple(map(Path, labels))
    read_labels(read, files)
    wanted = parse_formats(list_of(format)) if format else None
    shared = {"labels": files, "single_file": single_file, "population": population, **parameters}
    place = None if output is None else Path(output)
    return write_reports(read, wanted, False, shared, progress, tell_failure, place)


def label(
    run: Runlike,
    output: LabelFile = None,
    *,
    repeat: Share = 0.1,
    seed: Number = 0,
    questions: Columns = "lattice,elements,more",
) -> Path:
    """Write a page on which people label the outputs of a run, without the methods' names.

    Parameters
    ----------
    run
        The run, or its directory.
    output
        The page.  [default: RUN/labels/...]

        By default it lies beside its key.
    repeat
        Share of the outputs that are shown twice.
    seed
        Seed of the items' order and ids.
    questions
        The questions about each output, in this order.

        As a list or joined by commas.

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

    place = None if output is None else Path(output)
    return write_page(as_run(run).root, place, repeat, seed, names_of(questions))[0]


def site(runs: Runs, output: OutputFolder) -> list[Path]:
    """Write a static site that compares runs, such as those of several people.

    Parameters
    ----------
    runs
        The runs, or their directories.
    output
        Directory of the pages.

        It is made if it does not exist.

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
    make_writable(folder, "pass another -o")
    given = {"runs": tuple(each.root for each in loaded)}
    written: list[Path] = plugins.build("reports", plugins.in_role("run-site"), given).write(loaded[0], folder)
    return written


def sheet(
    photo: Picture,
    output: SheetFile,
    *,
    methods: Methods = (),
    sample: SampleSize = "384x384",
    size: SampleSize = "384x384",
    lattice: Latticelike = None,
    seed: Number = 0,
    mask: Masklike = None,
    flatten_light: Switch = False,
    progress: OnStep | None = None,
    options: Options | None = None,
) -> pd.DataFrame:
    """Show what all methods make of a photograph on one sheet, the best first.

    The lattice is detected once and given to all methods that use one. These run first, since all that take long use
    none. The sheet is written when the first output is done, and again with each further one; an interrupt (Ctrl-C)
    leaves it as it is. A photograph in perspective, of a round surface or through a distorting lens is straightened
    first: methods and judge get it straight.

    Parameters
    ----------
    photo
        The photograph.
    output
        The sheet.

        It is not written if no method has an output.
    methods
        A method, with parameters or preset=NAME; repeatable.  [default: all]

        As for :func:`~nrbench.run`; by default all that are no references and need no parameter.
    sample
        Largest sample; PHOTO is cropped.
    size
        Size of the outputs.
    lattice
        The lattice of PHOTO, or the detector that finds it, once for all methods.  [default: consensus]
    seed
        Equal seeds give equal outputs.
    mask
        A picture of the size of PHOTO, in which white counts, and black is left out.

        Or an array, bool or in [0, 1]. Transparent pixels of PHOTO do not count either.
    flatten_light
        Divide uneven light out of PHOTO first: methods and judge get it in even light.
    progress, options
        As for :func:`~nrbench.run`.

    Returns
    -------
    pandas.DataFrame
        One row for each method: its status, its quality, whether this is an upper bound, the perils that set it,
        where it is below 1, those that were not measured, and those that do not exist on this photograph, the seconds,
        and why it has no output; the ranks that it can have, ``"2"`` or ``"1-3"``, with which methods it is tied, and
        why, or why it has no quality. Qualities that hardly differ are tied. An upper bound is compared with upper
        bounds in which the same perils were not measured. It is below measured qualities that are higher, above 0, and
        else tied.

    Raises
    ------
    BadInput
        For a bad photograph, size, method or lattice.

    Examples
    --------
    ``sheet("wall.png", "sheet.png", methods=["rsgf", "resample"])`` shows the sample and two outputs.
    """
    import pandas as pd

    from nrbench.api.photo_sheet import GrowingSheet, photo_suite, prepare_photo
    from nrbench.running.options import Options
    from nrbench.running.runner import execute

    with tempfile.TemporaryDirectory() as folder:
        file = picture_file(photo, Path(folder))
        left = None if mask is None else picture_file(mask, Path(folder), "mask.png")
        file, lattice = prepare_photo(file, lattice, flatten_light, Path(folder), left is not None)
        root, make_suite = Path(folder) / "run", functools.partial(photo_suite, file, sample, size, left)
        planned = _plan_sheet(make_suite, methods, lattice, root, seed)
        options = options or Options()
        growing = GrowingSheet(Path(output), root, options.tell, progress or (lambda step: None))
        execute(planned, root, options, growing.add)
    return pd.DataFrame([row for _, row in growing.rated])


def _plan_sheet(
    make_suite: Callable[[Lattice | None], Suite], methods: Methods, lattice: Latticelike, root: Path, seed: int
) -> Plan:
    """Return the cells of a sheet. A lattice that is given, or that the judge does not find, is the judge's, too."""
    from nrbench.api.photo_sheet import find_unjudged_lattice

    source, known = plugins.in_role("detector") if lattice is None else lattice, None
    if isinstance(source, str) and parse_spec(source)[0] in plugins.names("detectors"):
        planned, _ = plan_cells(make_suite(None), methods, (), source, root, seed=seed)
        known = find_unjudged_lattice(planned.cells[0][1]) if lattice is None else None
    else:
        known = as_lattice(source)
    return planned if known is None else plan_cells(make_suite(known), methods, (), "given", root, seed=seed)[0]


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
    cached, new = (len({cell["key"] for cell in cells if cell["cached"] is done}) for done in (True, False))
    head = {"suite": plan.suite.name, "hash": plan.suite.hash, "out": str(root)}
    return {**head, "cached": cached, "new": new, "cells": cells}


def _find_done(plan: Plan, root: Path, retry_failed: bool) -> Callable[[Cell], bool]:
    """Return a function that tells whether a run would reuse the results of a cell."""
    from nrbench.running.runner import find_metrics, is_cached
    from nrbench.runs.store import RunDirectory

    directory, metrics = RunDirectory(root), find_metrics(plan.suite.metrics)
    return lambda cell: is_cached(directory, cell, metrics, retry_failed)
