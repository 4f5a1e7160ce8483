"""The command compare, which compares two runs."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click

from nrbench.cli.options import split_names
from nrbench.errors import BadInput

_PATH = click.Path(path_type=Path)


@click.command("compare")
@click.argument("first", type=_PATH, metavar="RUN_A")
@click.argument("second", type=_PATH, metavar="RUN_B")
@click.option("--columns", metavar="NAME,...", help="The scores.  [default: the headlines]")
@click.option("--markdown", "as_markdown", is_flag=True, help="Print a Markdown table.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON on standard output.")
@click.option(
    "--fail-under",
    "limits",
    multiple=True,
    metavar="[NAME=]NUMBER",
    help="Exit with 1 if the mean of a score of any method of RUN_B is below NUMBER; repeatable.  [default NAME: "
    "quality]",
)
@click.option(
    "--fail-on-worse",
    is_flag=True,
    help="Exit with 1 if any score of a method is worse by more than draws move it, or if a cell fails now on the same "
    "sample, and with 2 if the runs cannot be compared.",
)
def compare_command(
    first: Path,
    second: Path,
    columns: str | None,
    as_markdown: bool,
    as_json: bool,
    limits: tuple[str, ...],
    fail_on_worse: bool,
) -> int:
    """Compare RUN_B with RUN_A: which scores moved, by how much, and whether by more than draws move them.

    Cells with equal samples are paired; runs with other samples are compared by their draws. All scores are tested
    together: fewer --columns find smaller changes. Reference methods and wall times are shown, but they are no reason
    to fail, except for wall times that --columns names.
    """
    from nrbench import plugins
    from nrbench.runs.records import Run

    if as_markdown and as_json:
        raise BadInput("--markdown and --json: choose one of them")
    wanted = [_read_limit(text) for text in limits]
    names = split_names(columns)
    runs = [Run(first), Run(second)]
    for run in runs:
        _ = run.info
    chosen = [*names, *(name for name, _ in wanted if names and name not in names)]
    report = plugins.build("reports", "changes", {"baseline": first, "columns": tuple(chosen)})
    changes = report.compare(runs[1])
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
        print(report.markdown(changes) if as_markdown else report.text(changes))
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
