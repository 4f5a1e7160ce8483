"""Check a plugin against every clause of its form, each in a child process under limits (``nrbench check``)."""

from __future__ import annotations

import io
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack, redirect_stderr
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.plugins.parameters import nearest
from nrbench.running.clauses import CLAUSES, MARK, MARKUP, Clause
from nrbench.running.guard import Limits
from nrbench.running.runner import Options, execute
from nrbench.running.supervisor import RequestRunner, Supervisor
from nrbench.running.worker import Request
from nrbench.runs.store import CellFolder, Result
from nrbench.storage import temporary_folder, write_json
from nrbench.suites.plan import make_plan
from nrbench.suites.suite import validated_suite

Verdict = Literal["pass", "fail", "skip"]
LIMITS = Limits(120.0, 4096.0)
"""The limits of one clause, where no others are given."""
_VERDICTS: Mapping[str, Verdict] = {"ok": "pass", "refused": "skip"}


@dataclass(frozen=True)
class Finding:
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
    verdict: Verdict
    reason: str
    log: str = ""


def check_plugin(
    kind: str,
    name: str,
    parameters: Mapping[str, Any] | None = None,
    limits: Limits = LIMITS,
    runner: RequestRunner | None = None,
    only: Collection[str] = (),
) -> Iterator[Finding]:
    """Check a plugin against every clause of its form; yield one finding for each.

    Parameters
    ----------
    kind, name
        The plugin.
    parameters
        Parameters that it is checked with, where they differ from its defaults.
    limits
        The limits of one clause.
    runner
        Runs the clauses, for tests and debuggers; the clause that needs two interpreters is then skipped. None: each
        clause runs in a child process of its own.
    only
        Names of the clauses to check, with those that they depend on; empty: all.

    Yields
    ------
    Finding
        The verdict on a clause, ``pass``, ``fail`` or ``skip``, and why.

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
    clauses = _chosen(kind, only)
    with ExitStack() as stack:
        place = stack.enter_context(temporary_folder())
        run = _make_run(place / "run") if kind == "reports" else ""
        fresh = None if runner else stack.enter_context(Supervisor(forks=False))
        first = runner or stack.enter_context(Supervisor())
        content = {"kind": kind, "name": name, "parameters": dict(parameters or {}), "run": str(run)}
        failed: dict[str, Verdict] = {}
        for clause in clauses:
            folder = place / clause.name.replace(" ", "-")
            write_json(folder / "cell.json", {**content, "clause": clause.name})
            finding = _finding(clause, failed, folder, first, fresh, limits)
            if finding.verdict != "pass":
                failed[clause.name] = finding.verdict
            yield finding


def _chosen(kind: str, only: Collection[str]) -> list[Clause]:
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


def _finding(
    clause: Clause,
    failed: Mapping[str, Verdict],
    folder: Path,
    runner: RequestRunner,
    fresh: RequestRunner | None,
    limits: Limits,
) -> Finding:
    if clause.after in failed:
        return Finding(clause.name, clause.demand, "skip", f"depends on the clause {clause.after!r}")
    if clause.twice and fresh is None:
        return Finding(clause.name, clause.demand, "skip", "needs two interpreters")
    request = Request("check", str(folder), limits.seconds, limits.mib)
    result = runner.run(request).result
    if clause.twice and result["status"] == "ok" and fresh is not None:
        result = _compared(result, fresh.run(request).result)
    verdict = _VERDICTS.get(result["status"], "fail")
    reason = " ".join((result["message"] or "ended without an answer").split())
    if result["status"] in ("timeout", "memory", "crash"):
        reason = f"{result['status']}: {reason}"
    log = CellFolder(folder).log_tail() if verdict == "fail" else ""
    return Finding(clause.name, clause.demand, verdict, reason, log)


def _compared(one: Result, other: Result) -> Result:
    """Return how two interpreters ended that each sent the hash of an answer."""
    if other["status"] != "ok":
        return other
    if one["message"] != other["message"]:
        return {
            "status": "invalid",
            "message": "another interpreter gave another answer (sets, hash() or ids of objects?)",
        }
    return {"status": "ok", "message": "two interpreters give the same bytes"}


def find_plugins(name: str, kind: str | None = None, only: Collection[str] = ()) -> list[tuple[str, str]]:
    """Return the kind and the name of each plugin that is called ``name``; of all plugins if ``name`` is empty.

    Parameters
    ----------
    name, kind
        The plugin; a kind leaves out those of other kinds.
    only
        Files. If there are any and ``name`` is empty, the plugins that they define are returned.

    Raises
    ------
    BadInput
        If there is none; the message names the nearest.
    """
    kinds = [kind] if kind else list(plugins.FORMS)
    if name:
        found = [(one, name) for one in kinds if name in plugins.names(one)]
        if not found:
            known = [each for one in kinds for each in plugins.names(one)]
            raise BadInput(f"plugin {name!r} is not known{nearest(name, known)}; load a file with --plugin FILE.py")
        return found
    found = [
        (one, item.name) for one in kinds for item in plugins.inventory(one) if not only or item.distribution in only
    ]
    if not found:
        raise BadInput("no plugin of that kind in these files; name one")
    return found


def _make_run(root: Path) -> Path:
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
