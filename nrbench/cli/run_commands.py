"""The commands that start runs, and those that read, compare and publish them."""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from nrbench.api import runs
from nrbench.api.arguments import names_of
from nrbench.cli.progress import live_progress, waiting
from nrbench.cli.verbs import check_output, choose_one, verb
from nrbench.errors import BadInput
from nrbench.flags import ARGUMENT, Flag, Json, Names, Switch
from nrbench.running.options import Options, print_notice

# The help of a command imports no more than this.
if TYPE_CHECKING:
    from nrbench.running.runner import Step
    from nrbench.suites.plan import Plan

More = Annotated["tuple[Path, ...]", Flag(ARGUMENT, "", kind=Path, many=True)]
LeastMeans = Annotated["tuple[str, ...]", Flag("--fail-under", "[NAME=]NUMBER", many=True)]
SCHEDULING = ("scheduler", "worker_wait", "retry_failed", "reuse")
"""Options of a run that the commands lack which make runs by themselves."""
INTERRUPTED = "the cells that are running will end; press Ctrl-C again to stop at once"


@verb(runs.run)
def run_command(
    call: partial[Any], options: Options, no_report: Switch = False, columns: Names = "", as_json: Json = False
) -> int:
    """Run SUITE and print the comparison table.

    SUITE is the name of a suite, a TOML file, or a directory of pictures.

    Parameters
    ----------
    no_report
        Write the tables only.
    columns
        The scores of the printed table.  [default: the headlines]
    as_json
        Print JSON on standard output, and each cell as a line of JSON on standard error.
    """
    from nrbench.api.run_reports import write_reports
    from nrbench.cli import summary
    from nrbench.running.executors import ClusterLost
    from nrbench.running.runner import execute, first_interrupt

    scores = names_of(columns)
    summary.check_columns(scores)
    plan, root = _draw_samples(call, options)
    lacking = summary.left_out(root, plan)
    tell = _tell_as_json if as_json else print_notice
    if plan.suite.fresh_seed:
        tell(f"fresh seed {plan.suite.seed}; --seed {plan.suite.seed} draws the same samples again")
    lock = ExitStack()
    with show_steps(as_json) as progress, first_interrupt(lambda: tell(INTERRUPTED)) as stop:
        options = dataclasses.replace(options, argv=["nrbench", *sys.argv[1:]], stop=stop, tell=tell)
        try:
            run = execute(plan, root, options, progress, lock)
        except ClusterLost as error:
            run = runs.load(root)
            tell(f"{error}; run the same command again to resume")
    failures = Failures()
    with lock, live_progress(patience=True) as show:
        stale = summary.remove_stale_report(run) if no_report else None
        written = write_reports(run, None, no_report, None, None if as_json else show, failures.add)
    failed = summary.print_summary(run, written, as_json, scores)
    if lacking:
        tell(
            f"{root} holds {lacking} more {'cell' if lacking == 1 else 'cells'} of an earlier command, which the "
            "tables leave out; run that command again to see them, or use another --out for this one"
        )
    if stale:
        tell(f"{stale} was of an earlier command and is removed; `nrbench report {root}` writes it again")
    return int(failed or failures.any)


def _draw_samples(call: partial[Any], options: Options | None) -> tuple[Plan, Path]:
    """Return the plan of a command line, and its run directory."""
    from nrbench.running.guard import LIMITS, Limits

    given = {name: value for name, value in call.keywords.items() if name != "retry_failed"}
    limits = Limits(options.timeout, options.memory) if options else LIMITS
    with waiting("drawing the samples") as advance:
        return runs.plan_cells(**given, limits=limits, progress=advance)


class Failures:
    """Prints a sentence about each report that fails, and knows whether there was any."""

    any = False

    def add(self, text: str) -> None:
        """Print the sentence."""
        self.any = True
        print_notice(text)


def _tell_as_json(text: str) -> None:
    print(json.dumps({"event": "notice", "message": text}), file=sys.stderr, flush=True)


@contextmanager
def show_steps(as_json: bool = False) -> Iterator[Callable[[Step], None]]:
    """Show the steps of a run on standard error: as JSON lines, or as :func:`~nrbench.cli.progress.live_progress`."""
    if as_json:
        yield lambda step: print(json.dumps({"event": "cell", **dataclasses.asdict(step)}), file=sys.stderr, flush=True)
        return
    from nrbench.runs.store import FAILED

    with live_progress(estimate=False) as show:
        yield lambda step: show(step.done, step.total, _describe_step(step), step.status in FAILED)


def _describe_step(step: Step) -> str:
    """Return the cell, the counts of cached and failed cells that are not zero, and the time left."""
    counts = [f"{count} {word}" for count, word in ((step.cached, "cached"), (step.failed, "failed")) if count]
    return "; ".join([step.text, *filter(None, [", ".join(counts), step.remaining_text])])


@verb(runs.plan)
def plan_command(call: partial[Any], retry_failed: bool, as_json: Json = False) -> None:
    """List the cells that `run` would reuse and those that it would start. Nothing is started.

    Parameters
    ----------
    as_json
        Print JSON on standard output.
    """
    from nrbench.cli import summary

    cells = runs.plan_summary(*_draw_samples(call, None), retry_failed)
    print(json.dumps(cells, indent=1) if as_json else "\n".join(summary.plan_lines(cells)))


@verb(runs.report)
def report_command(
    call: Callable[..., Any],
    labels: tuple[Path, ...],
    more: More = (),
    no_tests: Switch = False,
) -> int:
    """Write the reports of RUN again from its files. No cell is run.

    Parameters
    ----------
    no_tests
        Make no statistical tests: no leading group, no p-values.
    """
    if more and not labels:
        raise click.UsageError(f"{more[0]}: only one run is reported; files of answers come after --labels")
    chosen = {"tests": False} if no_tests else {}
    failures = Failures()
    with live_progress(patience=True) as progress:
        written = call(labels=(*labels, *more), progress=progress, tell_failure=failures.add, **chosen)
    for path in written:
        print(path)
    return int(failures.any)


@verb(runs.status)
def status_command(call: Callable[..., dict[str, Any]], run: Path, as_json: Json = False) -> None:
    """Print the number of cells of RUN with each status, and the cells that failed.

    Parameters
    ----------
    as_json
        Print JSON on standard output.
    """
    found = call()
    if as_json:
        print(json.dumps(found, indent=1))
        return
    print(f"{run}: {found['cells']} cells: " + ", ".join(f"{n} {name}" for name, n in found["status"].items()))
    print("\n".join(found["failures"]) or "nothing failed")


@verb(runs.label)
def label_command(run: Path, output: Path | None, repeat: float, seed: int, questions: str) -> None:
    """Write a page on which people label the outputs of RUN, without the methods' names.

    The questions are: is the lattice kept (`lattice`), are the elements whole (`elements`), does it look like more of
    the same (`more`). `nrbench report RUN --labels FILE...` reads the answers that the page saves.
    """
    from nrbench.labelling.labels import write_page

    path, key, page = write_page(run, output, repeat, seed, names_of(questions))
    repeats = sum(item.repeated for item in page.items)
    print(f"{path}\n{len(page.items)} items, {repeats} of them second showings; questions: {', '.join(page.questions)}")
    print(f"the key {key} stays with the run")


@verb(runs.site)
def site_command(call: Callable[..., list[Path]]) -> None:
    """Write a static site that compares RUNs, such as those of several people.

    It has a leaderboard with a filter and a page for each method. Each row names the versions, the seed and the
    machine; rows of fresh seeds are marked. The pages work from a folder and from any web server.
    """
    print(*call(), sep="\n")


@verb(runs.sheet, without=SCHEDULING)
def sheet_command(call: Callable[..., Any], options: Options, output: Path, as_json: Json = False) -> int:
    """Show what all methods make of PHOTO on one sheet, the best first, with the quality and the seconds of each.

    The lattice is detected once and given to all methods that use one. These run first, since all that take long use
    none. The sheet is written when the first output is done, and again with each further one; Ctrl-C leaves it as it
    is. Methods without an output are printed with the reason. "Rank 1-3" means that the output is tied with others, and
    the line says why.

    Parameters
    ----------
    as_json
        Print JSON on standard output.
    """
    from nrbench.api.photo_sheet import describe_row
    from nrbench.pictures.files import WRITTEN

    check_output(output, *WRITTEN)
    with show_steps() as progress:
        table = call(options=options, progress=progress)
    rows = table.astype(object).where(table.notna(), None).to_dict("records")
    made = [row for row in rows if row["status"] == "ok"]
    if as_json:
        print(json.dumps(rows, indent=1))
        return int(not made)
    for row in made:
        print("  ".join(filter(None, describe_row(row).split("\n"))))
    for row in rows[len(made) :]:
        print(f"{row['method']}  {row['status']}: {row['message']}")
    print(output if made else "no method has an output: no sheet is written")
    return int(not made)


@verb(runs.audit, without=SCHEDULING)
def audit_command(call: Callable[..., Any], options: Options) -> int:
    """Tell whether METHOD is better at the published seed of SUITE than at a fresh one.

    The method runs at both seeds. If its quality falls at the fresh seed by more than other draws of the textures move
    it, it knows the published samples, and the exit code is 1.
    """
    with show_steps() as progress:
        found = call(options=options, progress=progress)
    for run in (found.first, found.second):
        print(f"{run.root}: {run.seed_text}")
    for change in found.changes:
        print(_sentence(change))
    return int(any(change.state == "worse" for change in found.changes))


def _sentence(change: Any) -> str:
    """Return what the audit of a method with one source of the lattice found."""
    if change.before is None or change.after is None:
        return f"{change.method}: no quality could be measured at both seeds"
    told = f"{change.method}: quality {change.before:.3f} at the published seed, {change.after:.3f} at the fresh seed"
    if change.state == "worse":
        return f"{told}: lower by more than other draws move it (p = {change.p:.2g}); report the fresh seed"
    if change.state == "unknown":
        return f"{told}: too few textures for a test, which takes six"
    least = "" if change.detectable is None else f"; a loss of {change.detectable:.2g} would be found in 80 % of cases"
    p = "" if change.p is None else f" (p = {change.p:.2g})"
    return f"{told}: no lower than other draws move it{p}{least}"


@verb(runs.compare)
def compare_command(
    call: Callable[..., Any],
    columns: str | None,
    markdown: Switch = False,
    as_json: Json = False,
    limits: LeastMeans = (),
    fail_on_worse: Switch = False,
) -> int:
    """Compare RUN_B with RUN_A: which scores moved, by how much, and whether by more than draws move them.

    Cells with equal samples are paired; runs with other samples are compared by their draws. All scores are tested
    together: fewer --columns find smaller changes. Reference methods and wall times are shown, but they are no reason
    to fail, except for wall times that --columns names.

    Parameters
    ----------
    markdown
        Print a Markdown table.
    as_json
        Print JSON on standard output.
    limits
        Exit with 1 if the mean of a score of any method of RUN_B is below NUMBER; repeatable.  [default NAME: quality]
    fail_on_worse
        Exit with 1 if any score of a method is worse by more than draws move it, or if a cell fails now on the same
        sample, and with 2 if the runs cannot be compared.
    """
    choose_one({"--markdown": markdown, "--json": as_json})
    wanted = [_read_limit(text) for text in limits]
    names = names_of(columns or "")
    changes = call(columns=[*names, *(name for name, _ in wanted if names and name not in names)])
    if fail_on_worse and changes.obstacles:
        raise BadInput(f"--fail-on-worse: {changes.obstacles[0]}")
    reasons = [
        f"{method}: {name} has the mean {value:.3g}, which is not at least {limit:g}"
        for name, limit in wanted
        for method, value in changes.below(name, limit).items()
    ]
    if fail_on_worse:
        for change in changes.worse:
            reasons.append(f"{change.method}: {change.score} is worse by {abs(change.difference.value):.3g}")
        reasons += [f"{method}: a cell fails or is refused that had an output" for method in changes.newly_failed]
    if as_json:
        print(json.dumps({**changes.as_dict(), "failures": reasons}, indent=1))
    else:
        print(changes.markdown() if markdown else changes.text())
    for reason in reasons:
        print(f"nrbench: {reason}", file=sys.stderr)
    return int(bool(reasons))


def _read_limit(text: str) -> tuple[str, float]:
    """Read ``NAME=NUMBER``, or a number for the quality."""
    name, equals, number = text.rpartition("=")
    try:
        return (name if equals else "quality"), float(number)
    except ValueError:
        raise BadInput(
            f"--fail-under {text!r}: write NUMBER or NAME=NUMBER, e.g. 0.5 or regularity.score=0.9"
        ) from None
