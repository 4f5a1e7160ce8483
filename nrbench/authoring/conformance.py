"""Check a plugin against every clause of its form, each in a child process under limits (``nrbench check``)."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import os
import resource
import signal
import subprocess
import sys
import traceback
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import psutil

from nrbench import plugins
from nrbench.authoring.plugin_checks import CHECKS, EXAMPLES, Subject, demand_of, earlier_clause
from nrbench.calling.method_calls import InvalidOutput
from nrbench.errors import BadInput, describe_error
from nrbench.jit import load_kernels
from nrbench.plugins.forms import Refused
from nrbench.plugins.parameters import leave_user_folder, nearest
from nrbench.running.guard import LIMITS, Limits, explain_exit
from nrbench.running.phases import FAULTS
from nrbench.running.runner import Options, execute
from nrbench.running.supervisor import worker_environment
from nrbench.storage import read_json, temporary_folder, write_json
from nrbench.suites.plan import make_plan
from nrbench.suites.suite import validated_suite

START = 120.0
"""Seconds that a child may take to start and to import a plugin."""
SHOWN = 4000
"""Most characters of a log that are kept."""
Verdict = Literal["pass", "fail", "skip"]


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
    verdict: Verdict
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
        Whether the clauses run in this process, for tests and debuggers. Otherwise each clause runs in a child process
        of its own.
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
    load_kernels()  # children print nothing, and this process says what it compiles
    with temporary_folder() as place:
        run = str(make_example_run(place / "run")) if kind == "reports" else ""
        subject = Subject(kind, name, dict(parameters or {}), run, tuple(map(str, plugins.files())))
        check = check_clause if here else partial(_check_in_child, limits=limits, place=place)
        missed: set[str] = set()
        for clause in clauses:
            earlier = earlier_clause(kind, clause)
            if earlier in missed:
                found = Conformance(clause, demand_of(kind, clause), "skip", f"depends on the clause {earlier!r}")
            else:
                found = check(subject, clause)
            if found.verdict != "pass":
                missed.add(clause)
            yield found


def _choose(kind: str, only: Collection[str]) -> list[str]:
    """Return the clauses of these names and those that they depend on."""
    known = CHECKS[kind]
    wanted: set[str] = set()
    for name in [name.replace("-", " ") for name in only] or known:
        if name not in known:
            raise BadInput(f"clause {name!r} of {plugins.FORMS[kind].noun}s is not known{nearest(name, known)}")
        while name and name not in wanted:
            wanted.add(name)
            name = earlier_clause(kind, name)
    return [name for name in known if name in wanted]


def check_clause(subject: Subject, clause: str) -> Conformance:
    """Check one clause in this process."""
    demand = demand_of(subject.kind, clause)
    try:
        seen = CHECKS[subject.kind][clause](subject)
    except Refused as refusal:
        return Conformance(clause, demand, "skip", refusal.reason)
    except FAULTS as error:
        reason = str(error) if isinstance(error, InvalidOutput) else describe_error(error)
        return Conformance(clause, demand, "fail", " ".join(reason.split()), traceback.format_exc()[-SHOWN:])
    return Conformance(clause, demand, "pass", seen or demand)


def _check_in_child(subject: Subject, clause: str, limits: Limits, place: Path) -> Conformance:
    """Check one clause in a new interpreter, whose files lie in a folder."""
    folder = place / clause
    folder.mkdir()
    program = f"from {__name__} import check_alone; check_alone(*__import__('sys').argv[1:])"
    words = [subject.to_json(), clause, str(Path.cwd()), str(folder), str(limits.seconds), str(limits.mib)]
    with (folder / "log.txt").open("w+b") as log:
        process = subprocess.Popen(
            [sys.executable, "-c", program, *words],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            env={**worker_environment(), "TMPDIR": str(folder)},
            start_new_session=True,
        )
        try:
            code = process.wait(START + limits.seconds)
        except subprocess.TimeoutExpired:
            code = -signal.SIGALRM
        finally:  # end the child and all that it has started
            with contextlib.suppress(OSError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        log.seek(0)
        printed = log.read().decode("utf-8", "replace")
    found = read_json(folder / "answer.json")
    if found is not None:
        log_end = (printed + found["log"])[-SHOWN:] if found["verdict"] == "fail" else ""
        return Conformance(**{**found, "log": log_end})
    late = f"timeout: took longer than {limits.seconds:g} s; raise --timeout if it may"
    reason = late if code == -signal.SIGALRM else f"crash: {explain_exit(code)}"
    return Conformance(clause, demand_of(subject.kind, clause), "fail", reason, printed[-SHOWN:])


def check_alone(subject: str, clause: str, user_folder: str, folder: str, seconds: str, mib: str) -> None:
    """Check one clause in this process, a child, and write the answer to a file.

    The kernel ends the process when its time is over, and gives it no more memory than it may have.

    Parameters
    ----------
    subject
        The subject in JSON.
    clause
        The name of the clause.
    user_folder, folder
        The folder from which relative paths start, and that of the answer.
    seconds, mib
        The limits, from the import of the plugin on.
    """
    checked = Subject.from_json(subject)
    leave_user_folder(Path(user_folder), Path(folder, "work"))
    most = getattr(psutil.Process().memory_info(), "data", 0) + int(float(mib) * 2**20)
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))
    signal.setitimer(signal.ITIMER_REAL, float(seconds))
    write_json(Path(folder, "answer.json"), dataclasses.asdict(check_clause(checked, clause)))


def make_example_run(root: Path) -> Path:
    """Make a small run for reports: two textures, a method, a reference, and a method that fails."""
    suite = {
        **EXAMPLES["run"],
        "name": "check",
        "texture": [{**EXAMPLES["texture"], "name": name} for name in ("wall", "100% _of_ $x$ & <y>")],
    }
    with contextlib.redirect_stderr(io.StringIO()):  # the traceback of the method that fails
        execute(make_plan(validated_suite(suite, "check")), root, Options(jobs=0), lambda step: None)
    return root
