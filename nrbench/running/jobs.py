"""Jobs: one cell, or one detection, from its folder to its result."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

from nrbench.running import scoring
from nrbench.running.worker import Reply, Request
from nrbench.runs.store import CellFolder, write_json


class Asker(Protocol):
    """Whoever runs a request: a supervisor, or its in-process twin."""

    def ask(self, request: Request) -> Reply:
        """Run one request and return how it ended."""
        ...


def run(job: Mapping[str, Any], asker: Asker) -> dict[str, Any]:
    """Run a job: ``kind`` is ``cell`` or ``detect``; ``folder`` holds ``cell.json`` and ``sample.png``.

    Returns
    -------
    dict
        The result, as written to ``result.json``.
    """
    try:
        return _run(job, CellFolder(Path(job["folder"])), asker)
    except OSError:
        raise
    except Exception as error:
        return {"status": "crash", "message": f"{type(error).__name__}: {error}"}


def _run(job: Mapping[str, Any], where: CellFolder, asker: Asker) -> dict[str, Any]:
    if job["kind"] == "detect":
        return _detect(job, where, asker)
    result = where.result() or _synthesize(job, where, asker)
    if result["status"] == "ok":
        _score(job, where, asker)
    return result


def _request(job: Mapping[str, Any], phase: str, **more: Any) -> Request:
    return {"phase": phase, "folder": str(job["folder"]), "seconds": job["seconds"], "mib": job["mib"], **more}


def _detect(job: Mapping[str, Any], where: CellFolder, asker: Asker) -> dict[str, Any]:
    reply = asker.ask(_request(job, "detect"))
    reply.pop("scored", None)
    write_json(where.result_file, reply)
    return reply


def _synthesize(job: Mapping[str, Any], where: CellFolder, asker: Asker) -> dict[str, Any]:
    reply = asker.ask(_request(job, "synthesize"))
    reply.pop("scored", None)
    if reply["status"] == "ok" and not where.output.is_file():
        reply = {"status": "crash", "message": "ended without an output"}
    phase = {} if reply["status"] == "ok" else {"phase": "synthesize"}
    result = {**reply, **phase, "side_by_side": job["side_by_side"]}
    write_json(where.result_file, result)
    return result


def _score(job: Mapping[str, Any], where: CellFolder, asker: Asker) -> None:
    """Score by every metric that has not answered yet; one that brings the child down is skipped over."""
    left = [name for name in job["metrics"] if not scoring.score_file(where, name).is_file()]
    while left:
        reply = asker.ask(_request(job, "score", metrics=left))
        left = [name for name in left if name not in reply["scored"]]
        if left:
            why = reply["message"] or "the metric sent nothing"
            scoring.record_failure(where, left.pop(0), f"failed: {reply['status']}: {why}")
