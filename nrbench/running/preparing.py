"""The preparation of a method for a sample, such as training: done once, and found again by all cells of the sample."""

from __future__ import annotations

import contextlib
import time
import uuid
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from nrbench.plugins.forms import Task
from nrbench.storage import read_json, remove, temporary_folder, write_json
from nrbench.streams import pixels_hash, stream

RECORD = ".prepared.json"
"""The file of a prepared folder that says how long the preparation took."""


def prepare_method(method: Any, task: Task, folder: Path, seed: int) -> tuple[Task, float | None]:
    """Let a method with ``prepare(task)`` prepare for a sample, unless it has done so before.

    The method works in another folder, which is renamed at the end: a preparation that is interrupted leaves nothing,
    and of two at the same time one counts.

    Parameters
    ----------
    method
        The method.
    task
        The task of the synthesis.
    folder
        The folder that ``task.cache`` is to be.
    seed
        The seed of the run.

    Returns
    -------
    task
        The task with the folder; as it was if the method has no ``prepare``.
    seconds
        Wall seconds of the preparation, also of an earlier one; None if the method has none.
    """
    if not hasattr(method, "prepare"):
        return task, None
    seconds = _read_seconds(folder)
    if seconds is None:
        remove(folder)  # it is damaged, if it is there
        aside = folder.with_name(f".{folder.name}-{uuid.uuid4().hex}")
        aside.mkdir(parents=True)
        rng, start = stream("prepare", seed, pixels_hash(task.sample)), time.perf_counter()
        given = replace(task, shape=task.sample.shape[:2], rng=rng, cache=aside, again=None, recompose=None)
        try:
            method.prepare(given)
            seconds = time.perf_counter() - start
            write_json(aside / RECORD, {"seconds": seconds})
            with contextlib.suppress(OSError):  # that of another cell is there
                aside.rename(folder)
        finally:
            remove(aside)
    return replace(task, cache=folder), seconds


@contextlib.contextmanager
def briefly_prepared(method: Any, task: Task, seed: int) -> Iterator[Task]:
    """Yield the task of a method outside of a run, for which it has prepared; the folder does not last."""
    with contextlib.ExitStack() as stack:
        lasting = hasattr(method, "prepare")
        folder = stack.enter_context(temporary_folder()) if lasting else Path()
        yield prepare_method(method, task, folder / "prepared", seed)[0]


def _read_seconds(folder: Path) -> float | None:
    """Return how long the preparation of a folder took; None if the folder is not complete."""
    seconds = (read_json(folder / RECORD) or {}).get("seconds")
    return seconds if isinstance(seconds, float) and 0 <= seconds < float("inf") else None
