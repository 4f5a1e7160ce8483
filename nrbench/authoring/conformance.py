"""Check a plugin against every clause of its form, each in a child process under limits (``nrbench check``)."""

from __future__ import annotations

import io
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack, redirect_stderr
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from nrbench import plugins
from nrbench.authoring import plugin_checks
from nrbench.authoring.plugin_checks import CLAUSES, MARK, MARKUP, Clause
from nrbench.errors import BadInput
from nrbench.plugins.parameters import nearest
from nrbench.running.guard import Limits
from nrbench.running.phases import Request
from nrbench.running.runner import Options, execute
from nrbench.running.supervisor import InProcessRunner, RequestRunner, Supervisor
from nrbench.runs.store import CellFolder, Result
from nrbench.storage import temporary_folder, write_json
from nrbench.suites.plan import make_plan
from nrbench.suites.suite import validated_suite

LIMITS = Limits(120.0, 4096.0)
"""The limits of one clause, where no others are given."""
CHECK = f"{plugin_checks.__name__}.{plugin_checks.check.__name__}"
"""The name of the phase that checks a clause."""


@dataclass(frozen=True)
class Conformance:
    """What a plugin does about one clause.

    Parameters
    ----------
    clause, demand
        The clause, and what it demands, in one sentence.
    verdict
        ``"pass"``, ``"fail"``, or ``"skip"`` if the clause does not apply or depends on one that failed.
    reason
        What was seen, in one line.
    log
        The end of what the plugin printed, and the traceback, if it failed.
    """

    clause: str
    demand: str
    verdict: Literal["pass", "fail", "skip"]
    reason: str
    log: str = ""


def check_plugin(
    kind: str,
    name: str,
    parameters: Mapping[str, Any] | None = None,
    limits: Limits = LIMITS,
    *,
    here: bool = False,
    only: Collection[str] = (),
) -> Iterator[Conformance]:
    """Check a plugin against every clause of its form.

    Parameters
    ----------
    kind, name
        The plugin.
    parameters
        Parameters that it is checked with, where they differ from its defaults.
    limits
        The limits of one clause.
    here
        Whether the clauses run in this process, for tests and debuggers; the clause that needs two interpreters is then
        skipped. Otherwise each clause runs in a child process of its own.
    only
        Names of the clauses to check, with those that they depend on; empty: all.

    Yields
    ------
    Conformance
        What the plugin does about one clause.

    Raises
    ------
    BadInput
        If there is no such plugin or clause, it does not load, or its parameters are not valid.

    Examples
    --------
    >>> from nrbench import check_plugin
    >>> [(finding.clause, finding.verdict) for finding in check_plugin("synthesizers", "scatter", only=["docstring"])]
    [('docstring', 'pass')]
    """
    plugins.build(kind, name, parameters or {})
    clauses = _choose(kind, only)
    with ExitStack() as stack:
        place = stack.enter_context(temporary_folder())
        run = make_example_run(place / "run") if kind == "reports" else ""
        subject = {"kind": kind, "name": name, "parameters": dict(parameters or {}), "run": str(run)}
        supervisors = [] if here else [stack.enter_context(Supervisor(forks=forks)) for forks in (True, False)]
        runners: list[RequestRunner] = [*supervisors] or [InProcessRunner()]
        missed: set[str] = set()
        for clause in clauses:
            folder = place / clause.name.replace(" ", "-")
            write_json(folder / "cell.json", {**subject, "clause": clause.name})
            if clause.after in missed:
                result = Result(status="refused", message=f"depends on the clause {clause.after!r}")
            else:
                result = _examine(clause, Request(CHECK, str(folder), limits.seconds, limits.mib), runners)
            if result["status"] != "ok":
                missed.add(clause.name)
            yield _conformance(clause, result, folder)


def _choose(kind: str, only: Collection[str]) -> list[Clause]:
    """Return the clauses of these names and those that they depend on."""
    known = {clause.name: clause for clause in CLAUSES[kind]}
    wanted: set[str] = set()
    for name in only or known:
        if name not in known:
            raise BadInput(f"clause {name!r} of {plugins.FORMS[kind].noun}s is not known{nearest(name, known)}")
        while name and name not in wanted:
            wanted.add(name)
            name = known[name].after
    return [clause for clause in CLAUSES[kind] if clause.name in wanted]


def _examine(clause: Clause, request: Request, runners: list[RequestRunner]) -> Result:
    """Check a clause by the first runner, or by two of them whose answers must be equal."""
    if clause.twice and len(runners) < 2:
        return {"status": "refused", "message": "needs two interpreters"}
    answers = []
    for runner in runners[: 1 + clause.twice]:
        result = runner.run(request).result
        if result["status"] != "ok":
            return result
        answers.append(result["message"])
    if len(set(answers)) > 1:
        why = "another interpreter gave another answer (sets, hash() or ids of objects?)"
        return {"status": "invalid", "message": why}
    return {"status": "ok", "message": clause.demand if clause.twice else answers[0]}


def _conformance(clause: Clause, result: Result, folder: Path) -> Conformance:
    status = result["status"]
    reason = " ".join((result["message"] or "ended without an answer").split())
    if status in ("ok", "refused"):
        return Conformance(clause.name, clause.demand, "pass" if status == "ok" else "skip", reason)
    if status in ("timeout", "memory", "crash"):
        reason = f"{status}: {reason}"
    return Conformance(clause.name, clause.demand, "fail", reason, CellFolder(folder).log_tail())


def make_example_run(root: Path) -> Path:
    """Make a small run for reports: two textures with awkward names, a method, a reference, and one that fails."""
    texts = {"family": " ".join(sorted(set(MARKUP.values()))), "description": f"<script>{MARK} \\input{{{MARK}}}"}
    names = (f"=1+{MARK} <script>{MARK}", f"{MARK} & 100% _of_ $x$ #1 \u202e")
    suite = {
        "name": f"check <script>{MARK}",
        "sample": "48x48",
        "size": "64x64",
        "lattice": ["given"],
        "methods": ["oracle", "tiling", "scatter", f"command:run=no-such-program-{MARK} {{sample}} {{output}}"],
        "metrics": ["quality", "regularity", "cost"],
        "texture": [
            {"name": name, "dataset": "brick", "parameters": {"width": 20, "height": 10, "color": 0.2}, **texts}
            for name in names
        ],
    }
    with redirect_stderr(io.StringIO()):  # the traceback of the method that fails
        execute(make_plan(validated_suite(suite, "check")), root, Options(jobs=0), lambda step: None)
    return root
