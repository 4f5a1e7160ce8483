"""The survey of a sample: its lattice, and whether it is bent. It is made once, and found again by all cells."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import time
from pathlib import Path
from typing import Any

from pydantic import ConfigDict, ValidationError

from nrbench import plugins
from nrbench.calling.bent_samples import SampleSurvey, survey_sample
from nrbench.plugins.forms import FoundLattice, Task
from nrbench.plugins.registry import bent_finders, in_role
from nrbench.running.guard import MIB, cpu_seconds, peak_bytes
from nrbench.storage import read_json, write_json
from nrbench.suites.cell import RESULTS_VERSION, Cell, reader_of


@dataclasses.dataclass(frozen=True)
class Spent:
    """What an earlier survey cost, which counts as a cost of each method that uses it.

    Parameters
    ----------
    seconds, cpu_seconds
        Wall and processor seconds.
    peak_mib
        By how much it raised the peak memory of its process, MiB.
    """

    __pydantic_config__ = ConfigDict(allow_inf_nan=False)
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    peak_mib: float = 0.0


@dataclasses.dataclass(frozen=True)
class KeptSurvey:
    """The content of the file of a survey. A bent sample, whose survey holds pictures, is surveyed by each cell.

    Parameters
    ----------
    found, note
        As in :class:`~nrbench.calling.bent_samples.SampleSurvey`.
    spent
        What it cost.
    """

    found: FoundLattice
    note: str
    spent: Spent


def survey_once(method: Any, task: Task, cell: Cell, folder: Path) -> tuple[SampleSurvey | None, Spent]:
    """Return the survey of a cell's sample, and what it cost if an earlier cell made it.

    Parameters
    ----------
    method, task
        As for :func:`~nrbench.calling.bent_samples.survey_sample`.
    cell
        The cell.
    folder
        The folder of the surveys of the run.
    """
    finder = (cell.finder or (in_role("detector"),))[0]
    if not all(plugins.find("detectors", name).own for name in (finder, *bent_finders())):
        return survey_sample(method, task), Spent()
    file = folder / f"{_key(cell)}.json"
    kept = _read(file)
    if kept is not None and getattr(method, "geometry", "as-is") != "as-is" and getattr(method, "uses_lattice", True):
        return SampleSurvey(kept.found, None, kept.note, kept.spent.seconds), kept.spent
    wall, cpu, peak = time.perf_counter(), cpu_seconds(), peak_bytes()
    survey = survey_sample(method, task)
    if survey is not None and survey.bent is None:
        wall, cpu, mib = time.perf_counter() - wall, cpu_seconds() - cpu, (peak_bytes() - peak) / MIB
        write_json(file, dataclasses.asdict(KeptSurvey(survey.found, survey.note, Spent(wall, cpu, mib))))
    return survey, Spent()


def _key(cell: Cell) -> str:
    """Return a hash of all that a survey depends on."""
    given = cell.lattice_given.as_dict() if cell.lattice_given else None
    versions = [plugins.find("detectors", name).full_version for name in bent_finders()]
    text = json.dumps([RESULTS_VERSION, cell.sample_hash, given, cell.finder, versions], sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=12).hexdigest()


def _read(file: Path) -> KeptSurvey | None:
    """Return what a file holds; None where it is missing or damaged."""
    try:
        kept: KeptSurvey = reader_of(KeptSurvey).validate_python(read_json(file))
    except (OSError, ValidationError):
        return None
    return kept
