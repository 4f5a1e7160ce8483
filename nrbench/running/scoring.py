"""What the second of a cell's two children does: read the cell's folder, and score it."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import traceback
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from nrbench import plugins
from nrbench.imaging.convert import Image, quantize
from nrbench.imaging.files import read_image, write_image
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Again, Observation, Score, Texture
from nrbench.running.phases import Send, read_cell
from nrbench.runs.store import CellFolder, read_arrays, read_json, write_json
from nrbench.streams import pixels_hash, stream
from nrbench.suites.cell import RESULTS_VERSION, Cell


def score(folder: Path, metrics: list[str], send: Send) -> None:
    """Score a cell by each of ``metrics``, one file each; sends ``{"scored": name}`` after each.

    A metric that raises is recorded as None with the error as its reason; the next one goes on.
    """
    where = CellFolder(folder)
    cell = read_cell(where)
    observation = observe(where, cell)
    for name in metrics:
        try:
            _score_one(where, observation, name)
        except (Exception, SystemExit) as error:
            traceback.print_exc()
            record_failure(where, name, failure(error))
        send({"scored": name})


def _score_one(where: CellFolder, observation: Observation, name: str) -> None:
    found = scored(observation, name)
    where.scores.mkdir(exist_ok=True)
    pictures = {}
    for title, picture in found.pictures.items():
        pictures[title] = f"{metric_key(name)}-{Path(title).name}.png"
        write_image(where.scores / pictures[title], quantize(picture))
    content = {
        "values": dict(found.values),
        "reasons": dict(found.reasons),
        "records": dict(found.records),
        "pictures": pictures,
    }
    write_json(score_file(where, name), {"metric": name, **content})


def scored(observation: Observation, name: str) -> Score:
    """Return what a metric answers, its values plain and checked.

    Raises
    ------
    ValueError
        Where a declared column is missing, None without a reason, or no finite number or truth value.
    """
    metric = plugins.build("metrics", name)
    rng = stream("metric", pixels_hash(observation.output), name)
    found: Score = metric.score(observation.with_stream(rng))
    return dataclasses.replace(found, values=_checked_values(found, metric.columns))


def failure(error: BaseException) -> str:
    """Return the reason of all columns of a metric that raised."""
    return f"failed: {type(error).__name__}: {error}"


def _checked_values(found: Score, columns: Mapping[str, Any]) -> dict[str, Any]:
    if set(found.values) != set(columns):
        odd = sorted(set(found.values) ^ set(columns))
        raise ValueError(f"values and declared columns differ in {odd}")
    values = {key: value.item() if isinstance(value, np.generic) else value for key, value in found.values.items()}
    for key, value in values.items():
        if value is None and not isinstance(found.reasons.get(key), str):
            raise ValueError(f"column {key!r} is None without a reason")
        if not (value is None or (isinstance(value, bool | int | float) and np.isfinite(float(value)))):
            raise ValueError(f"column {key!r} is {value!r}; a score is a finite number, a truth value, or None")
    return values


def observe(where: CellFolder, cell: Cell) -> Observation:
    """Return all that a metric may look at, from the cell's folder alone."""
    sample, result = read_image(where.sample), where.result() or {}
    truth, again = _truth(cell, sample)
    costs = {
        key: result[key] for key in ("cpu_seconds", "detection_seconds", "peak_mib") if result.get(key) is not None
    }
    if cell.detected is not None:
        costs["detection_seconds"] = cell.detected.seconds
    return Observation(
        sample=_frozen(sample),
        output=_frozen(read_image(where.output, smallest=1)),
        truth=truth,
        lattice_given=cell.lattice_given,
        lattice_used=_lattice(result.get("lattice_used")),
        source=read_arrays(where.source)["source"] if where.source.is_file() else None,
        extras={path.stem: read_arrays(path)["array"] for path in sorted(where.extras.glob("*.npz"))},
        seconds=result.get("seconds"),
        again=again,
        cost={**costs, "side_by_side": float(result.get("side_by_side", 0))},
        detected=cell.detected,
    )


def _frozen(image: Image) -> Image:
    """Return an image that no metric can change under the next one."""
    image.setflags(write=False)
    return image


def failed_scores(where: CellFolder, metrics: Iterable[str]) -> list[Path]:
    """Return the files of those scores that failed."""
    files = [score_file(where, name) for name in metrics]
    return [file for file in files if _failed(read_json(file) or {})]


def _failed(score: Mapping[str, Any]) -> bool:
    return any(str(reason).startswith("failed:") for reason in score.get("reasons", {}).values())


def _lattice(mapping: dict[str, Any] | None) -> Lattice | None:
    return Lattice.from_dict(mapping) if mapping else None


def _truth(cell: Cell, sample: Image) -> tuple[Texture, Again | None]:
    if not cell.procedural:
        known = (cell.lattice_truth,) if cell.lattice_truth else ()
        return Texture(sample, cell.lattice_truth, known, cell.texture, cell.family, region=cell.region), None
    texture = cell.recipe.render()
    return dataclasses.replace(texture, image=sample), cell.recipe.again(texture)


@cache
def metric_key(name: str) -> str:
    """Return a metric's name with the hash of its version and parameters: scores are keyed apart from results."""
    plugin = plugins.find("metrics", name)
    parameters = plugins.parameters_of(plugins.build("metrics", name))
    decides = json.dumps([RESULTS_VERSION, name, plugin.version, parameters], sort_keys=True)
    return f"{name}-{hashlib.blake2b(decides.encode(), digest_size=6).hexdigest()}"


def score_file(where: CellFolder, name: str) -> Path:
    """Return the file that holds a metric's score of a cell."""
    return where.scores / f"{metric_key(name)}.json"


def record_failure(where: CellFolder, name: str, reason: str) -> None:
    """Record a metric that could not answer: None in every column, with the reason."""
    columns = plugins.build("metrics", name).columns
    empty = {"values": dict.fromkeys(columns), "reasons": dict.fromkeys(columns, reason), "records": {}, "pictures": {}}
    write_json(score_file(where, name), {"metric": name, **empty})
