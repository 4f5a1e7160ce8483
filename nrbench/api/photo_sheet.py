"""What all methods make of one photograph, on one sheet."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from nrbench import plugins
from nrbench.api.arguments import LEAST_CONFIDENCE, Latticelike, lattice_in
from nrbench.calling.bent_samples import recognize_sample
from nrbench.calling.lighting import flatten_light, warn_of_light
from nrbench.displacement.bent_detection import LARGEST_FOLLOWED
from nrbench.errors import BadInput, require
from nrbench.imaging.convert import Image, depth_of, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.pictures.files import read_image, read_mask, read_masked, read_shape, write_image
from nrbench.pictures.overlays import contact_sheet, draw_lattice
from nrbench.plugins.forms import Task, describe_silence, find_lattice
from nrbench.plugins.parameters import parse_size, size_text
from nrbench.plugins.registry import NamedDetector
from nrbench.running.runner import OnStep, Step
from nrbench.runs.records import CellRecord, Run
from nrbench.suites.plan import PlannedSample
from nrbench.suites.suite import Suite, validated_suite

_COLUMNS = (4, 5, 6)
"""Numbers of columns of which one is chosen."""
_LETTERS = 15
"""px; height of the letters."""
_APART = 0.1
"""Least difference of two qualities of which one is called higher. If a quarter of the sample is left out, an eighth
of the smaller differences change their sign, and hardly any larger one (docs/photographs.md)."""
BAD = 0.5
"""Quality below which an output is marked as bad."""
_PERILS = ("regularity", "integrity", "randomness", "appearance")


def prepare_photo(
    photo: Path, lattice: Latticelike, flatten: bool, folder: Path, masked: bool = False
) -> tuple[Path, Latticelike]:
    """Return the file of a photograph that is straight and in even light, if this is wanted, and its lattice.

    A photograph that is to stay as it is keeps its file and the lattice that was given; so does a large one, whose bend
    is hardly seen in a sample, and one of which pixels are left out (``masked``). A warning names uneven light.
    """
    with warnings.catch_warnings(action="ignore"):  # the plan reads it again
        image, known_pixels = read_masked(photo)
    if masked or known_pixels is not None:
        require(not flatten, "--flatten-light: a sheet takes no masked photograph with it; use synth, or flatten first")
        return photo, lattice
    if max(image.shape[:2]) > LARGEST_FOLLOWED and not flatten:
        return photo, lattice
    depth = depth_of(image)
    task = Task(image, (1, 1), lattice_in(image, lattice), np.random.default_rng(0))
    survey, known = recognize_sample(None, task), lattice
    if survey.bent is not None and survey.bent.is_global:
        image, known = survey.bent.straighten()
        warnings.warn(f"{photo}: {survey.note}", stacklevel=2)
    if flatten:
        given = known if isinstance(known, Lattice) else survey.found.lattice
        image = flatten_light(None, replace(task, sample=image, lattice=given))[0].sample
    elif survey.found.lattice is not None and survey.bent is None:
        warn_of_light(image, survey.found.lattice)
    if known is lattice and not flatten:
        return photo, lattice
    return write_image(folder / "prepared.png", quantize(image, depth)), known


def find_unjudged_lattice(sample: PlannedSample) -> Lattice | None:
    """Return the lattice of a sample in which the judge's detector finds none, if it is more probable than not.

    It is given to methods and judge: without a lattice, ruined outputs would have no score.
    """
    task = Task(sample.image(), (1, 1), None, np.random.default_rng(0), known=sample.known)
    if find_lattice(task, NamedDetector(plugins.in_role("judge-detector"))).lattice is not None:
        return None
    found = find_lattice(task, NamedDetector(plugins.in_role("detector")))
    return found.lattice if (found.confidence or 0) >= LEAST_CONFIDENCE else None


def photo_suite(photo: Path, sample: Any, size: Any, mask: Path | None = None, lattice: Lattice | None = None) -> Suite:
    """Return a suite of one photograph with all methods that are no references and need no parameter.

    Those that use a lattice come first: all that take long use none. ``lattice``, if it is known, is given to methods
    and judge.
    """
    height, width = map(min, read_shape(photo), parse_size(sample))
    files: dict[str, Any] = {"path": str(photo.absolute())}
    files |= {} if mask is None else {"mask": str(mask.absolute())}
    files |= {} if lattice is None else {"t1": lattice.t1, "t2": lattice.t2, "origin": lattice.origin}
    row = {"name": "photo", "dataset": plugins.in_role("pictures"), "parameters": files}
    content = {
        "name": "sheet",
        "sample": f"{width}x{height}",
        "size": size_text(parse_size(size)),
        "metrics": ["quality"],
        "methods": sorted(filter(_runs_alone, plugins.names("synthesizers")), key=_uses_no_lattice),
        "texture": [row],
    }
    return validated_suite(content, "sheet")


def _runs_alone(name: str) -> bool:
    """Return whether a method is no reference and can be built without a parameter."""
    try:
        return not getattr(plugins.build("synthesizers", name), "reference", False)
    except BadInput:
        return False


def _uses_no_lattice(name: str) -> bool:
    return not getattr(plugins.build("synthesizers", name), "uses_lattice", True)


def rate_outputs(records: Sequence[CellRecord]) -> list[tuple[CellRecord, dict[str, Any]]]:
    """Return each cell and its row of the sheet's table, by quality, then those without a quality, without an output.

    Outputs of equal quality have the order of the alphabet.
    """
    rows = [_rate(one) for one in records]
    measured = [row for row in rows if row["quality"] is not None]
    rated = [(one, row | _rank(row, measured)) for one, row in zip(records, rows, strict=True)]
    return sorted(rated, key=lambda pair: (pair[0].status != "ok", -_shown(pair[1]), pair[1]["method"]))


def _rate(one: CellRecord) -> dict[str, Any]:
    perils = {name: one.values.get(f"quality.{name}") for name in _PERILS}
    scores = {name: float(score) for name, score in perils.items() if score is not None}
    silent = {name: describe_silence(one.reasons.get(f"quality.{name}", "")) for name in perils if name not in scores}
    bound = one.values.get("quality.complete") is False
    return {
        "method": one.method,
        "status": one.status,
        "quality": one.values.get("quality.score"),
        "upper_bound": bound,
        "worst": [name for name, score in scores.items() if score == min(scores.values()) < 1],
        "not_measured": [name for name, word in silent.items() if word == "cannot tell"] if bound else [],
        "why": one.reasons.get("quality.score", ""),
        "no_peril": [name for name, word in silent.items() if word == "no peril"] if scores else [],
        "seconds": one.seconds,
        "message": one.message,
    }


def _shown(row: Mapping[str, Any]) -> float:
    """Return the quality to the two decimals that are shown; -1 without one."""
    return -1.0 if row["quality"] is None else round(float(row["quality"]), 2)


def _is_above(row: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Return whether a quality is higher than another one, as far as both were measured, by at least :data:`_APART`.

    An upper bound is compared with those in which the same perils were not measured. It is above no measured quality
    but 0, than which nothing is lower.
    """
    alike = other["upper_bound"] and row["not_measured"] == other["not_measured"]
    higher = round(_shown(row) - _shown(other), 2) >= _APART
    return higher and (not row["upper_bound"] or alike or _shown(other) == 0)


def _rank(row: Mapping[str, Any], rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the ranks that a row can have among rows with a quality, with which it is tied, and why."""
    if row["quality"] is None:
        return {"rank": "", "tied": []}
    first = 1 + sum(_is_above(other, row) for other in rows)
    last = len(rows) - sum(_is_above(row, other) for other in rows)
    tied = [one for one in rows if one is not row and not _is_above(one, row) and not _is_above(row, one)]
    unknown = [name for name in _PERILS if any(name in one["not_measured"] for one in (row, *tied))]
    why = f"{' and '.join(unknown)} cannot be told" if unknown else f"less than {_APART:.2f} apart"
    return {
        "rank": f"{first}" if first == last else f"{first}-{last}",
        "tied": sorted(one["method"] for one in tied),
        "why": why if tied else "",
    }


def describe_row(row: Mapping[str, Any]) -> str:
    """Return method, quality with rank and seconds, why it is tied, and what limits it, in two to four lines."""
    value, bound = row["quality"], "at most " if row["upper_bound"] else ""
    quality = "quality not measured" if value is None else f"quality {bound}{value:.2f}, rank {row['rank']}"
    unknown = [] if row["tied"] else row["not_measured"]  # else the reason of the tie names them
    words = (
        ("BAD, worst: " if 0 <= _shown(row) < BAD else "worst: ", row["worst"]),
        ("cannot tell: ", unknown),
        ("no peril: ", row["no_peril"]),
    )
    limits = "; ".join(title + ", ".join(names) for title, names in words if names)
    tied = f"tied: {row['why']}" if row["tied"] else row["why"]
    return "\n".join(filter(None, [row["method"], f"{quality}, {row['seconds'] or 0:.1f} s", tied, limits]))


def draw_sheet(made: Sequence[tuple[CellRecord, Mapping[str, Any]]], ended: int, total: int) -> Image:
    """Return the sample with its lattice, and the outputs, each below its caption.

    Where not all methods have ended, the caption of the sample has their number and that of all.
    """
    records = [one for one, _ in made]
    sample, known = read_image(records[0].folder / "sample.png"), records[0].folder / "known.png"
    if known.is_file():
        sample[~read_mask(known, sample.shape[:2])] = 1
    lattice = next((one.cell.lattice_given for one in records if one.cell.lattice_given), None)
    first = sample if lattice is None else draw_lattice(sample, lattice)
    found = "no lattice" if lattice is None else "lattice " + ",".join(f"{x:.2f}" for x in (*lattice.t1, *lattice.t2))
    columns = min(_COLUMNS, key=lambda count: (-(len(made) + 1) % count, count))  # the fewest empty places
    outputs = [read_image(one.folder / "output.png") for one in records]
    count = f"\n{ended} of {total} methods" if ended < total else ""
    captions = [f"sample\n{found}{count}", *(describe_row(row) for _, row in made)]
    return contact_sheet([first, *outputs], captions, columns, _LETTERS)


@dataclass
class GrowingSheet:
    """A sheet that is written again whenever a method has an output.

    Parameters
    ----------
    path
        Its file.
    root
        The directory of the run.
    tell
        Called with a sentence that names the file when it holds the first of several outputs.
    progress
        Called after each cell.
    rated
        The methods that have ended, as :func:`rate_outputs` returns them.
    """

    path: Path
    root: Path
    tell: Callable[[str], None]
    progress: OnStep
    rated: list[tuple[CellRecord, dict[str, Any]]] = field(default_factory=list)
    _ended: set[str] = field(default_factory=set)

    def add(self, step: Step) -> None:
        """Rate the methods that have ended, and write the sheet if one has a further output."""
        self._ended.add(step.method)
        self.rated = rate_outputs([one for one in Run(self.root).cells if one.method in self._ended])
        made = [pair for pair in self.rated if pair[0].status == "ok"]
        if made and (step.status == "ok" or step.done == step.total):
            write_image(self.path, draw_sheet(made, step.done, step.total))
            if len(made) == 1 and step.done < step.total:
                self.tell(f"{self.path}: shows the first output, and grows with each further one")
        self.progress(step)
