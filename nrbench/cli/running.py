"""Verbs that run suites and read runs: run, plan, report, status."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

F = TypeVar("F", bound=Callable[..., Any])


def _plan_options(command: F) -> F:
    for option in reversed(
        [
            click.argument("suite", default="default"),
            click.option(
                "-m", "methods", multiple=True, metavar="METHOD[:param=value,...]", help="Method; repeatable."
            ),
            click.option("-t", "textures", multiple=True, metavar="GLOB", help="Only these textures; repeatable."),
            click.option(
                "--lattice",
                multiple=True,
                metavar="given|own|DETECTOR|x1,y1,x2,y2",
                help="Where methods get the lattice: the true one, their own, a detector's, or yours; repeatable.",
            ),
            click.option("--sample", metavar="WxH", help="Size of the samples."),
            click.option("--size", metavar="WxH", help="Size of the outputs."),
            click.option("--seed", type=click.IntRange(0), help="Seed of the suite."),
            click.option("--replicates", type=click.IntRange(1), help="Draws of each texture."),
            click.option("--out", type=click.Path(path_type=Path), help="Run directory.  [default: runs/SUITE]"),
            click.option("--retry-failed", is_flag=True, help="Run cells again that failed before."),
            click.option("--json", "as_json", is_flag=True, help="Print JSON on standard output."),
        ]
    ):
        command = option(command)
    return command


def _planned(given: dict[str, Any]) -> tuple[Any, Path]:
    """Return the plan that a command line asks for, and its run directory."""
    from nrbench.api import changed
    from nrbench.suites.plan import make_plan
    from nrbench.suites.suite import load_suite

    axes = {key: given.pop(key) for key in ("sample", "size", "seed", "replicates")}
    suite = changed(load_suite(given["suite"]), given["methods"], given["lattice"], **axes)
    return make_plan(suite, given["textures"]), given["out"] or Path("runs") / suite.name


@click.command("run")
@_plan_options
@click.option("--jobs", type=click.IntRange(0), help="Cells at the same time; 0: in this process.  [default: cores]")
@click.option("--scheduler", metavar="tcp://HOST:PORT", help="Place the cells on a Dask cluster.")
@click.option(
    "--timeout",
    type=click.FloatRange(0, 1e7, min_open=True),
    default=120.0,
    show_default=True,
    metavar="S",
    help="Wall seconds of one synthesis or metric.",
)
@click.option(
    "--memory",
    type=click.FloatRange(1, 1e7),
    default=4096.0,
    show_default=True,
    metavar="MiB",
    help="Memory of one synthesis or metric, above the idle worker.",
)
@click.option("--reuse", type=click.Path(path_type=Path), metavar="RUN", help="Copy results of another run.")
@click.option("--no-report", is_flag=True, help="Write the tables only.")
def run_command(**given: Any) -> int:
    """Run SUITE (a name, a TOML file, or a directory of pictures) and print the comparison table."""
    import os

    from nrbench.running.runner import Options, execute

    plan, root = _planned(given)
    options = Options(
        jobs=given["jobs"] if given["jobs"] is not None else os.cpu_count() or 1,
        argv=["nrbench", *sys.argv[1:]],
        **{key: given[key] for key in ("scheduler", "timeout", "memory", "retry_failed", "reuse")},
    )
    from nrbench.cli.progress import live

    with live() as progress:
        run = execute(plan, root, options, progress)
    written, broken = _write_reports(run, None, tables_only=given["no_report"])
    return max(_conclude(run, written, given["as_json"]), int(broken))


def _write_reports(
    run: Any, formats: str | None, tables_only: bool = False, labels: tuple[Path, ...] = ()
) -> tuple[list[Path], bool]:
    """Write the reports asked for (all that work, where None is); return the paths, and whether any report failed."""
    from nrbench import plugins

    wanted = formats.split(",") if formats else [p.name for p in plugins.inventory("reports") if p.cls is not None]
    written: list[Path] = []
    broken = False
    for name, report in [(name, _report(name, labels)) for name in wanted]:
        folder = getattr(report, "folder", "report")
        if folder == "tables" or not tables_only:
            try:
                written += [Path(path) for path in report.write(run, run.root / folder)]
            except (Exception, SystemExit) as error:
                broken = True
                print(f"nrbench: report {name} failed: {type(error).__name__}: {error}", file=sys.stderr)
    return written, broken


def _report(name: str, labels: tuple[Path, ...]) -> Any:
    """Return a report, with people's answers where it takes them (it has a parameter ``labels``)."""
    from dataclasses import fields

    from nrbench import plugins

    takes = "labels" in {field.name for field in fields(plugins.find("reports", name).cls)}  # type: ignore[arg-type]
    return plugins.build("reports", name, {"labels": labels} if labels and takes else {})


def _conclude(run: Any, written: list[Path], as_json: bool) -> int:
    """Print the table and where the report is; return the exit code."""
    from nrbench.cli.summary import failures, report_page, summary

    if as_json:
        print(json.dumps(summary(run, written), indent=1))
    else:
        _print_terminal_report(run)
        page = report_page(written)
        print(f"report: {page.resolve()}" if page else f"tables: {(run.root / 'tables').resolve()}")
    for line in failures(run):
        print(f"nrbench: {line}", file=sys.stderr)
    return 1 if failures(run) else 0


def _print_terminal_report(run: Any) -> None:
    """Print each report that declares itself made for the terminal (``terminal``: it has ``width`` and ``render``)."""
    import shutil

    from nrbench import plugins

    width = max(40, shutil.get_terminal_size((120, 40)).columns)
    for plugin in plugins.inventory("reports"):
        if getattr(plugin.cls, "terminal", False):
            print(plugins.build("reports", plugin.name, {"width": width}).render(run), end="")


@click.command("plan")
@_plan_options
def plan_command(**given: Any) -> None:
    """Show what `run` would do: cells cached and new; nothing is started."""
    from nrbench.cli.summary import plan_lines, plan_summary

    plan, root = _planned(given)
    found = plan_summary(plan, root, given["retry_failed"])
    print(json.dumps(found, indent=1) if given["as_json"] else "\n".join(plan_lines(found)))


@click.command("report")
@click.argument("run", type=click.Path(path_type=Path))
@click.argument("more", nargs=-1, type=click.Path(path_type=Path), metavar="")
@click.option("--format", "formats", metavar="html,csv,...", help="Which reports.  [default: all]")
@click.option(
    "--labels",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="FILE...",
    help="People's answers, one file a person: adds how judge and people agree.",
)
def report_command(run: Path, more: tuple[Path, ...], formats: str | None, labels: tuple[Path, ...]) -> int:
    """Write the reports of RUN again, from what is on disk; nothing is computed."""
    from nrbench.labelling.labels import read_people
    from nrbench.runs.records import Run

    if more and not labels:
        raise click.UsageError(f"{more[0]}: only one run is reported; files of answers come after --labels")
    found = Run(run)
    read_people(found, files := (*labels, *more))
    written, broken = _write_reports(found, formats, labels=files) if found.info else ([], False)
    for path in written:
        print(path)
    return int(broken)


@click.command("status")
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print JSON on standard output.")
def status_command(run: Path, as_json: bool) -> None:
    """Say how far RUN is, and what failed."""
    from nrbench.cli.summary import failures, status_counts
    from nrbench.runs.records import Run

    found = Run(run)
    counts = status_counts(found)
    if as_json:
        print(
            json.dumps(
                {"run": str(run), "cells": len(found.cells), "status": counts, "failures": failures(found)}, indent=1
            )
        )
        return
    print(f"{run}: {len(found.cells)} cells: " + ", ".join(f"{n} {status}" for status, n in counts.items()))
    print("\n".join(failures(found)) or "nothing failed")
