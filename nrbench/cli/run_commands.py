"""The commands run, plan, report, status and label, which run suites and read runs."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from nrbench.cli.options import limit_options, split_names
from nrbench.cli.progress import live_progress, waiting

# The help of a command imports no more than this.
if TYPE_CHECKING:
    from nrbench.running.pace import Step
    from nrbench.suites.plan import Plan

F = TypeVar("F", bound=Callable[..., Any])
_PATH = click.Path(path_type=Path)


def _read_seed(context: click.Context, option: click.Parameter, text: str | None) -> int | str | None:
    """Return a seed of the command line: a whole number from 0 on, or the word ``fresh``."""
    if text is None or text == "fresh":
        return text
    if not text.isascii() or not text.isdigit():
        raise click.BadParameter(f"{text!r} is neither a whole number from 0 on nor `fresh`", context, option)
    return int(text)


def _plan_options(command: F) -> F:
    for option in reversed(
        [
            click.argument("suite", default="default"),
            click.option(
                "-m", "methods", multiple=True, metavar="METHOD[:param=value,...]", help="A method; repeatable."
            ),
            click.option("-t", "textures", multiple=True, metavar="GLOB", help="Run only these textures; repeatable."),
            click.option(
                "--lattice",
                multiple=True,
                metavar="given|own|DETECTOR|x1,y1,x2,y2[,x,y]",
                help="The lattice that methods use: the true one, the one that each method finds, the one that a "
                "detector finds, or yours; repeatable.",
            ),
            click.option("--sample", metavar="WxH", help="Size of the samples."),
            click.option("--size", metavar="WxH", help="Size of the outputs."),
            click.option(
                "--seed",
                callback=_read_seed,
                metavar="NUMBER|fresh",
                help="Seed of the suite, or `fresh` for one that the system draws.",
            ),
            click.option("--replicates", type=click.IntRange(1), help="Number of draws of each texture."),
            click.option(
                "--out", type=_PATH, help="Run directory.  [default: runs/SUITE; runs/SUITE-fresh for a fresh seed]"
            ),
            click.option("--retry-failed", is_flag=True, help="Run failed cells again."),
            click.option(
                "--json",
                "as_json",
                is_flag=True,
                help="Print JSON on standard output; `run` also prints each cell as a line of JSON on standard error.",
            ),
        ]
    ):
        command = option(command)
    return command


def _make_plan(arguments: dict[str, Any]) -> tuple[Plan, Path]:
    """Return the plan of a command line, and its run directory."""
    from nrbench.api.runs import plan_cells
    from nrbench.running.guard import Limits
    from nrbench.running.plugin_children import LIMITS

    limits = Limits(arguments.get("timeout", LIMITS.seconds), arguments.get("memory", LIMITS.mib))
    names = ("suite", "methods", "textures", "lattice", "out", "seed", "sample", "size", "replicates")
    with waiting("drawing the samples") as advance:
        return plan_cells(**{name: arguments[name] for name in names}, limits=limits, progress=advance)


@click.command("run")
@_plan_options
@click.option(
    "--jobs",
    type=click.IntRange(0),
    help="Number of cells that run at the same time; 0 runs them in this process.  [default: number of cores]",
)
@limit_options("synthesis, metric or report")
@click.option("--scheduler", metavar="tcp://HOST:PORT", help="Run the cells on a Dask cluster.")
@click.option(
    "--worker-wait",
    type=click.FloatRange(0, 1e7, min_open=True),
    default=600.0,
    show_default=True,
    metavar="S",
    help="End the run if the Dask cluster has no worker for so many seconds.",
)
@click.option("--reuse", type=_PATH, metavar="RUN", help="Copy the results of equal cells from another run.")
@click.option("--no-report", is_flag=True, help="Write the tables only.")
@click.option("--columns", metavar="NAME,...", help="The scores of the printed table.  [default: the headlines]")
def run_command(**arguments: Any) -> int:
    """Run SUITE and print the comparison table.

    SUITE is the name of a suite, a TOML file, or a directory of pictures.
    """
    from nrbench.api.runs import write_reports
    from nrbench.cli import summary
    from nrbench.running.cluster import ClusterLost
    from nrbench.running.guard import Limits
    from nrbench.running.pace import first_interrupt
    from nrbench.running.runner import Options, execute
    from nrbench.running.supervisor import print_notice
    from nrbench.runs.records import Run

    columns = split_names(arguments["columns"])
    summary.check_columns(columns)
    plan, root = _make_plan(arguments)
    lacking = summary.left_out(root, plan)
    tell = _tell_as_json if arguments["as_json"] else print_notice
    if plan.suite.fresh_seed:
        tell(f"fresh seed {plan.suite.seed}; --seed {plan.suite.seed} draws the same samples again")
    lock = ExitStack()
    with show_steps(arguments["as_json"]) as progress, first_interrupt(lambda: tell(_INTERRUPTED)) as stop:
        options = Options(
            jobs=arguments["jobs"] if arguments["jobs"] is not None else os.cpu_count() or 1,
            argv=["nrbench", *sys.argv[1:]],
            stop=stop,
            tell=tell,
            **{key: arguments[key] for key in _RUN_OPTIONS},
        )
        try:
            run = execute(plan, root, options, progress, lock)
        except ClusterLost as error:
            run = Run(root)
            tell(f"{error}; run the same command again to resume")
    limits = Limits(options.timeout, options.memory)
    with lock, live_progress(patience=True) as show:
        stale = summary.remove_stale_report(run) if arguments["no_report"] else None
        told = None if arguments["as_json"] else show
        written, broken = write_reports(run, None, arguments["no_report"], None, limits, told, print_notice)
    failed = summary.print_summary(run, written, arguments["as_json"], columns, limits)
    if lacking:
        tell(
            f"{root} holds {lacking} more {'cell' if lacking == 1 else 'cells'} of an earlier command, which the "
            "tables leave out; run that command again to see them, or use another --out for this one"
        )
    if stale:
        tell(f"{stale} was of an earlier command and is removed; `nrbench report {root}` writes it again")
    return int(failed or broken)


_RUN_OPTIONS = ("scheduler", "worker_wait", "timeout", "memory", "retry_failed", "reuse")
_INTERRUPTED = "the cells that are running will end; press Ctrl-C again to stop at once"


def _tell_as_json(text: str) -> None:
    print(json.dumps({"event": "notice", "message": text}), file=sys.stderr, flush=True)


@contextmanager
def show_steps(as_json: bool) -> Iterator[Callable[[Step], None]]:
    """Show the steps of a run on standard error: as JSON lines, or as :func:`~nrbench.cli.progress.live_progress`."""
    if as_json:
        yield lambda step: print(json.dumps({"event": "cell", **asdict(step)}), file=sys.stderr, flush=True)
        return
    with live_progress(estimate=False) as show:
        yield lambda step: show(step.done, step.total, _describe_step(step))


def _describe_step(step: Step) -> str:
    """Return the cell, the counts of cached and failed cells that are not zero, and the time left."""
    counts = [f"{count} {word}" for count, word in ((step.cached, "cached"), (step.failed, "failed")) if count]
    return "; ".join([step.text, *filter(None, [", ".join(counts), step.remaining_text])])


@click.command("plan")
@_plan_options
def plan_command(**arguments: Any) -> None:
    """List the cells that `run` would reuse and those that it would start. Nothing is started."""
    from nrbench.api.runs import plan_summary
    from nrbench.cli import summary

    plan, root = _make_plan(arguments)
    cells = plan_summary(plan, root, arguments["retry_failed"])
    print(json.dumps(cells, indent=1) if arguments["as_json"] else "\n".join(summary.plan_lines(cells)))


@click.command("report")
@click.argument("run", type=_PATH)
@click.argument("more", nargs=-1, type=_PATH, metavar="")
@click.option(
    "--format",
    "formats",
    multiple=True,
    metavar="NAME[:param=value,...],...",
    help="The reports to write, e.g. html,latex:labels=...; repeatable.  [default: all]",
)
@click.option(
    "--labels",
    multiple=True,
    type=_PATH,
    metavar="FILE...",
    help="Files with answers to pages, one for each labeler. The reports then compare the verdicts with them.",
)
@click.option("--single-file", is_flag=True, help="Embed all pixels of all pictures in the HTML page.")
@click.option("--no-tests", is_flag=True, help="Make no statistical tests: no leading group, no p-values.")
@click.option(
    "--population", is_flag=True, help="Intervals over a population of textures, of which the suite is a sample."
)
@limit_options("synthesis, metric or report")
def report_command(
    run: Path,
    more: tuple[Path, ...],
    formats: tuple[str, ...],
    labels: tuple[Path, ...],
    single_file: bool,
    no_tests: bool,
    population: bool,
    timeout: float,
    memory: float,
) -> int:
    """Write the reports of RUN again from its files. No cell is run.

    The limits hold for reports of other packages.
    """
    from nrbench.api.runs import parse_formats, write_reports
    from nrbench.labelling.labels import read_labelers
    from nrbench.running.guard import Limits
    from nrbench.running.supervisor import print_notice
    from nrbench.runs.records import Run

    if more and not labels:
        raise click.UsageError(f"{more[0]}: only one run is reported; files of answers come after --labels")
    record, files = Run(run), (*labels, *more)
    _ = record.cells  # a damaged run is bad input
    read_labelers(record, files)
    wanted = parse_formats(formats) if formats else None
    shared: dict[str, Any] = {"labels": files}
    if single_file:
        shared["single_file"] = True
    if no_tests:
        shared["tests"] = False
    if population:
        shared["population"] = True
    limits = Limits(timeout, memory)
    with live_progress(patience=True) as progress:
        written, broken = write_reports(record, wanted, False, shared, limits, progress, print_notice)
    for path in written:
        print(path)
    return int(broken)


@click.command("status")
@click.argument("run", type=_PATH)
@click.option("--json", "as_json", is_flag=True, help="Print JSON on standard output.")
def status_command(run: Path, as_json: bool) -> None:
    """Print the number of cells of RUN with each status, and the cells that failed."""
    from nrbench.api.runs import status

    found = status(run)
    if as_json:
        print(json.dumps(found, indent=1))
        return
    print(f"{run}: {found['cells']} cells: " + ", ".join(f"{n} {name}" for name, n in found["status"].items()))
    print("\n".join(found["failures"]) or "nothing failed")


@click.command("label")
@click.argument("run", type=_PATH)
@click.option("-o", "output", type=_PATH, metavar="FILE.html", help="The page.  [default: RUN/labels/...]")
@click.option(
    "--repeat",
    type=click.FloatRange(0, 1),
    default=0.1,
    show_default=True,
    metavar="SHARE",
    help="Share of the outputs that are shown twice.",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the items' order and ids.")
@click.option(
    "--questions",
    default="lattice,elements,more",
    show_default=True,
    metavar="NAME,...",
    help="The questions about each output, in this order.",
)
def label_command(run: Path, output: Path | None, repeat: float, seed: int, questions: str) -> None:
    """Write a page on which people label the outputs of RUN, without the methods' names.

    The questions are: is the lattice kept (`lattice`), are the elements whole (`elements`), does it look like more of
    the same (`more`). `nrbench report RUN --labels FILE...` reads the answers that the page saves.
    """
    from nrbench.labelling.labels import write_page

    path, key, page = write_page(run, output, repeat, seed, split_names(questions))
    repeats = sum(item.again for item in page.items)
    asked = ", ".join(page.questions)
    print(f"{path}\n{len(page.items)} items, {repeats} of them second showings; questions: {asked}")
    print(f"the key {key} stays with the run")
