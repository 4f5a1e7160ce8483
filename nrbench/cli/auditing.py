"""The command audit, which tells whether a method knows the published samples."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import click

from nrbench.cli.options import limit_options
from nrbench.cli.run_commands import show_steps


@click.command("audit")
@click.argument("method", metavar="METHOD[:param=value,...]")
@click.argument("suite", default="default")
@click.option("-t", "textures", multiple=True, metavar="GLOB", help="Run only these textures; repeatable.")
@click.option("--replicates", type=click.IntRange(1), help="Number of draws of each texture at each seed.")
@click.option("--out", type=click.Path(path_type=Path), help="Directory of both runs.  [default: runs/audit-METHOD]")
@click.option("--jobs", type=click.IntRange(0), help="Number of cells at the same time.  [default: number of cores]")
@limit_options("synthesis or metric")
def audit_command(
    method: str,
    suite: str,
    textures: tuple[str, ...],
    replicates: int | None,
    out: Path | None,
    jobs: int | None,
    timeout: float,
    memory: float,
) -> int:
    """Tell whether METHOD is better at the published seed of SUITE than at a fresh one.

    The method runs at both seeds. If its quality falls at the fresh seed by more than other draws of the textures move
    it, it knows the published samples, and the exit code is 1.
    """
    from nrbench.api.runs import audit
    from nrbench.running.runner import Options

    options = Options(jobs=os.cpu_count() or 1 if jobs is None else jobs, timeout=timeout, memory=memory)
    with show_steps(False) as progress:
        found = audit(
            method, suite, textures=textures, replicates=replicates, out=out, progress=progress, options=options
        )
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
