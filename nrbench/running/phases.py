"""The phases of a cell: detect a lattice, synthesize, score. Each reads the cell's folder and writes into it.

A :class:`Request` says which phase runs on which folder. The phase runs in a child process and reports by messages.
:func:`nrbench.score` calls :func:`score_observation` in the caller's process.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import tempfile
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from pydantic import ValidationError

from nrbench import plugins
from nrbench.calling.bent_samples import SampleSurvey, survey_sample, synthesize_in_geometry
from nrbench.calling.method_calls import InvalidOutput, checked_synthesis, is_picture, prepare_method
from nrbench.errors import BadInput, describe_error, storage_fault
from nrbench.imaging.convert import MIN_SIDE, Image, as_image, quantize
from nrbench.imaging.masks import Mask
from nrbench.jit import find_cache
from nrbench.lattice.geometry import Lattice
from nrbench.lattice.vertices import Vertex
from nrbench.pictures.files import read_map, read_mask, write_image
from nrbench.plugins.forms import (
    Again,
    Column,
    FoundLattice,
    Observation,
    Refused,
    Score,
    Shape,
    Synthesis,
    Task,
    Texture,
    Value,
    timed_detection,
)
from nrbench.plugins.parameters import leave_user_folder
from nrbench.plugins.registry import bent_finders, in_role
from nrbench.running.guard import Message
from nrbench.runs.store import CellFolder, Result, metric_key
from nrbench.storage import read_arrays, read_json, write_arrays, write_json, write_text
from nrbench.streams import pixels_hash, stream
from nrbench.suites.cell import RESULTS_VERSION, Cell, Recipe, hash_content, reader_of
from nrbench.suites.plan import draw_texture, identify_detector
from nrbench.work import (
    MIB,
    REUSED,
    Spent,
    cpu_seconds,
    freeze,
    keep_results,
    make_once,
    measure_cost,
    peak_bytes,
    work_clock,
)

T = TypeVar("T")
PLAIN = ("family", "kind", "regular_share", "region")
"""Fields of a texture that JSON can hold."""
PREPARED = "prepared"
"""The part of a synthesis that is done when the method has prepared."""
Send = Callable[[Message], None]
"""Sends one message to the process that watches this one."""
FAULTS = (Exception, SystemExit, GeneratorExit)
"""What a plugin may raise that ends its phase. A keyboard interrupt ends a run that has no children, as it should."""


@dataclass(frozen=True)
class Request:
    """One phase of one cell, or all of them, to be run under limits.

    Parameters
    ----------
    phase
        What to do: the name of a function below: ``render``, ``detect``, ``synthesize_cell`` or ``score_cell``.
        :func:`~nrbench.running.supervisor.run_job` takes ``cell``, too: synthesize and score.
    folder
        The cell's folder, which holds ``cell.json`` and ``sample.png``.
    seconds, mib
        Limits of each phase, see :class:`~nrbench.running.guard.Limits`.
    metrics
        The metrics that score the cell.
    plugin_files
        Files of plugins.
    imports
        Kind and name of the installed third-party plugins that a worker of a cluster imports before it forks.
    built_in
        Whether it runs no third-party code: it scores by metrics of nrbench, and a dataset of nrbench drew the texture.
    own_method
        Whether the method and its detectors are nrbench's, and the method starts no programs.
    side_by_side
        1 if other cells run at the same time, else 0; it is recorded beside the costs.
    group
        Requests of one group, the cells of a texture, are best run by one worker, which learns their texture once.
    here
        Whether the method is defined in the process that plans the run, which has to synthesize itself.
    user_folder
        The folder in which the user started nrbench, which a worker of a cluster does not know: relative paths in
        parameters start from there.
    temporary
        The working directory of the phase, which is also its folder of temporary files; the worker fills it in. It does
        not lie in the cell's folder: the path of a socket has 107 bytes at most, and that of a run may be longer.
    """

    phase: str
    folder: str
    seconds: float
    mib: float
    metrics: tuple[str, ...] = ()
    plugin_files: tuple[str, ...] = ()
    imports: tuple[tuple[str, str], ...] = ()
    built_in: bool = False
    own_method: bool = False
    side_by_side: float = 0.0
    group: str = ""
    here: bool = False
    user_folder: str = dataclasses.field(default_factory=os.getcwd)
    temporary: str = ""

    @property
    def log(self) -> Path:
        """The file of what the phase prints."""
        return Path(self.folder) / "log.txt"

    def set_up_process(self) -> None:
        """Set up the calling process for the phase: its working directory, temporary files and plugins."""
        find_cache()  # it may lie among the temporary files of the user
        os.environ["TMPDIR"] = tempfile.tempdir = self.temporary
        leave_user_folder(Path(self.user_folder), Path(self.temporary))
        for file in self.plugin_files:
            plugins.add_file(file)

    def to_json(self) -> str:
        """Return the request as one line of JSON."""
        return json.dumps(vars(self))

    @classmethod
    def from_json(cls, line: str) -> Request:
        """Read a request from :meth:`to_json`."""
        content: dict[str, Any] = json.loads(line)
        tuples: dict[str, Any] = {name: tuple(value) for name, value in content.items() if isinstance(value, list)}
        return cls(**{**content, **tuples})


def perform(request: Request, send: Send) -> None:
    """Run one phase in this process, sending messages; an error that ends it is the last one."""
    before = peak_bytes()

    def send_with_memory(message: Message) -> None:
        used = {}
        if request.phase == "synthesize_cell":  # the method is sent with the peak of what it found done
            mib = max(0, peak_bytes() - before) / MIB
            used = {"peak_mib": max(mib, cast("Any", message).get("peak_mib", 0.0))}
        send(cast("Message", {**message, **used}))

    phases = {"render": render, "detect": detect, "synthesize_cell": synthesize_cell, "score_cell": score_cell}
    try:
        phases[request.phase](Path(request.folder), send_with_memory, *request.metrics)
    except FAULTS as error:
        send_error(error, send_with_memory)


def send_error(error: BaseException, send: Send) -> None:
    """Send the status and the message of an error that ended a phase.

    The status is ``refused``, ``invalid``, ``memory``, ``storage`` if a disk is full or broken, or else ``error``.
    """
    if isinstance(error, Refused):
        send({"status": "refused", "message": error.reason})
    elif isinstance(error, InvalidOutput):
        send({"status": "invalid", "message": str(error)})
    elif isinstance(error, MemoryError):
        send({"status": "memory", "message": "the system has not so much memory, whatever --memory allows"})
    else:
        with contextlib.suppress(OSError):  # the log may lie on the disk that is full
            traceback.print_exception(error)
        disk = storage_fault(error)
        if disk is None:
            send({"status": "error", "message": describe_error(error)})
        else:
            where = f"{disk.filename}: " if disk.filename else ""
            send({"status": "storage", "message": f"{where}{disk.strerror}"})


def render(folder: Path, send: Send) -> None:
    """Draw the texture whose recipe ``cell.json`` holds, write its pixels, and send what is known of it."""
    where = CellFolder(folder)
    wanted = read_json(where.cell_file) or {}
    try:
        texture, again = draw_texture(Recipe.from_dict(wanted["recipe"]), tuple(wanted["shape"]))
    except BadInput as error:
        raise InvalidOutput(str(error)) from None
    known = {name: getattr(texture, name) for name in PLAIN}
    known["lattice"] = texture.lattice.as_dict() if texture.lattice else None
    known["lattices"] = [lattice.as_dict() for lattice in texture.lattices]
    known["vertices"] = [list(vertex) for vertex in texture.vertices]
    write_image(where.sample, texture.image)
    if again is not None:
        write_image(where.again, again)
    send(cast("Message", {"status": "ok", "message": "", "texture": known}))


def _read_stored(path: Path, smallest: int = MIN_SIDE) -> Image:
    """Read a picture of the run, which is sRGB. What is to say about the file that it comes from, the plan has said."""
    return as_image(read_map(path)[0], f"picture {path}", smallest)


def _read_known(where: CellFolder, sample: Image) -> Mask | None:
    """Return which pixels of the sample count; None if all do."""
    return freeze(read_mask(where.known, sample.shape[:2])) if where.known.is_file() else None


def read_texture(folder: Path, known: Mapping[str, Any]) -> tuple[Texture, Image | None]:
    """Return the texture that :func:`render` wrote and described, and the region beside it."""
    where, plain = CellFolder(folder), {name: known[name] for name in PLAIN}
    plain["region"] = tuple(known["region"]) if known["region"] else None
    plain["vertices"] = tuple(map(Vertex._make, known.get("vertices", ())))
    lattice = Lattice.from_dict(known["lattice"]) if known["lattice"] else None
    texture = Texture(_read_stored(where.sample), lattice, tuple(map(Lattice.from_dict, known["lattices"])), **plain)
    return texture, _read_stored(where.again) if where.again.is_file() else None


def detect(folder: Path, send: Send) -> None:
    """Detect the lattice of a sample by the detector that ``cell.json`` names, and send it."""
    where = CellFolder(folder)
    cell = read_json(where.cell_file) or {}
    detector = plugins.build("detectors", cell["detector"], cell["parameters"])
    sample = freeze(_read_stored(where.sample))
    detection = timed_detection(detector, sample, _read_known(where, sample))
    send(cast("Message", {"status": "ok", "message": detection.reason, **dataclasses.asdict(detection)}))


def synthesize_cell(folder: Path, send: Send) -> None:
    """Run a cell's method, write its output, and send the costs."""
    where = CellFolder(folder)
    cell = _read_cell(where)
    method = plugins.build("synthesizers", cell.method, cell.parameters)
    folder = where.path.parents[1] / "prepared" / cell.preparation_key
    task, prepared = prepare_method(method, _task(where, cell), folder, cell.seed)
    send({"scored": PREPARED})
    wall, cpu = work_clock(), cpu_seconds()
    with keep_results():
        survey = survey_once(method, task, cell, folder.parent)
        synthesis = synthesize_in_geometry(method, task, survey)
    wall, cpu = work_clock() - wall, cpu_seconds() - cpu
    synthesis = checked_synthesis(synthesis, task.sample, cell.shape, task.known)
    _write(where, synthesis)
    result: Result = {
        "status": "ok",
        "message": "",
        "note": synthesis.note,
        "seconds": wall,
        "cpu_seconds": cpu,
        "detection_seconds": synthesis.detection_seconds,
        "peak_mib": REUSED.peak_mib,
        "lattice_used": synthesis.lattice.as_dict() if synthesis.lattice else None,
        "output_hash": pixels_hash(synthesis.image),
        "made": {
            file.relative_to(where.path).as_posix(): file.stat().st_size
            for file in (where.output, where.source, *sorted(where.extras.glob("*")))
            if file.is_file()
        },
    }
    if prepared is not None:
        result["prepare_seconds"] = prepared
    send(cast("Message", result))


def _task(where: CellFolder, cell: Cell) -> Task:
    sample = freeze(_read_stored(where.sample))
    rng = stream("synthesis", cell.seed, pixels_hash(sample), cell.replicate)
    again, recompose = _reference_draws(where, cell) if cell.reference else (None, None)
    known = _read_known(where, sample)
    return Task(sample, cell.shape, cell.lattice_given, rng, again=again, recompose=recompose, known=known)


def _reference_draws(where: CellFolder, cell: Cell) -> tuple[Again | None, Again | None]:
    """Return the fresh draws that a reference method may use, and those made of copies of the sample's elements.

    The fresh draw of a photograph is the region that was cut for it; it has no draws of copies.
    """
    if cell.procedural:
        texture = freeze(cell.recipe.render())
        recompose = cell.recipe.recompose(texture)
        return _frozen_draws(cell.recipe.again(texture)), recompose and _frozen_draws(recompose)
    if not where.again.is_file():
        return None, None
    region = freeze(_read_stored(where.again))

    def draw(shape: Shape, k: int) -> Texture | None:
        fits = k == 0 and region.shape[0] >= shape[0] and region.shape[1] >= shape[1]
        return Texture(region[: shape[0], : shape[1]]) if fits else None

    return draw, None


def _frozen_draws(draw: Again) -> Again:
    """Return the same draws, all their arrays made read-only."""
    return lambda shape, k: freeze(draw(shape, k))


def _write(where: CellFolder, synthesis: Synthesis) -> None:
    if synthesis.source is not None:
        write_arrays(where.source, source=synthesis.source)
    for name, array in synthesis.extras.items():
        write_arrays(where.extras / f"{Path(name).name}.npz", array=array)
        if is_picture(array):
            write_image(where.extras / f"{Path(name).name}.png", array)
    for name, describe in synthesis.files.items():
        write_text(where.extras / Path(name).name, describe(""))
    write_image(where.output, synthesis.image)


def score_cell(folder: Path, send: Send, *metrics: str) -> None:
    """Score a cell by some metrics, and write one file for each; send ``{"scored": metric}`` after each.

    The score of a metric that raises is None in every column, with the error as the reason.
    """
    where = CellFolder(folder)
    cell = _read_cell(where)
    named = [("datasets", cell.recipe.dataset), *(("metrics", metric) for metric in metrics)]
    observation = observe(where, cell, keep=all(is_built_in(kind, name) for kind, name in named))
    for metric in metrics:
        try:
            write_score(where, metric, score_observation(observation, metric))
        except FAULTS as error:
            if storage_fault(error) is not None:
                raise
            traceback.print_exc()
            where.write_failed_score(metric, failure_reason(error))
        send({"scored": metric})


@cache  # a search among all plugins for each request would touch, and so copy, much memory that children share
def is_built_in(kind: str, name: str) -> bool:
    """Return whether a plugin is known, and belongs to nrbench."""
    try:
        return plugins.lookup(kind, name).built_in
    except BadInput:
        return False


def write_score(where: CellFolder, metric: str, score: Score) -> None:
    """Write the file of a score, and its pictures beside it."""
    where.scores.mkdir(parents=True, exist_ok=True)
    pictures = {}
    for title, picture in score.pictures.items():
        pictures[title] = f"{metric_key(metric)}-{Path(title).name}.png"
        write_image(where.scores / pictures[title], quantize(picture))
    content = {"values": dict(score.values), "reasons": dict(score.reasons), "records": dict(score.records)}
    write_json(where.score_file(metric), {"metric": metric, **content, "pictures": pictures})


def score_observation(observation: Observation, metric: str, parameters: Mapping[str, Any] | None = None) -> Score:
    """Return a metric's score of an observation, its values checked and converted to plain Python.

    Parameters
    ----------
    observation, metric
        What is scored, and the name of the metric.
    parameters
        Parameters of the metric that differ from its defaults.

    Raises
    ------
    ValueError
        When a declared column is missing, None without a reason, or neither a finite number nor a truth value.
    """
    plugin = plugins.build("metrics", metric, parameters)
    rng = stream("metric", observation.shared(_hash_output), metric)
    score: Score = plugin.score(observation.with_stream(rng))
    if not isinstance(score, Score):
        raise TypeError(f"returned {type(score).__name__} instead of a Score")
    return dataclasses.replace(score, values=_checked_values(score, plugin.columns))


def _hash_output(observation: Observation) -> str:
    return pixels_hash(observation.output)


def failure_reason(error: BaseException) -> str:
    """Return the reason that is written for every column of a metric that raised an error."""
    return f"failed: {describe_error(error)}"


def _checked_values(score: Score, columns: Mapping[str, Column]) -> dict[str, Value]:
    if set(score.values) != set(columns):
        odd = sorted(set(score.values) ^ set(columns))
        raise ValueError(f"values and declared columns differ in {odd}")
    values = {key: value.item() if isinstance(value, np.generic) else value for key, value in score.values.items()}
    for key, value in values.items():
        if value is None and not isinstance(score.reasons.get(key), str):
            raise ValueError(f"column {key!r} is None without a reason")
        if not (value is None or (isinstance(value, bool | int | float) and np.isfinite(float(value)))):
            raise ValueError(f"column {key!r} is {value!r}; a score is a finite number, a truth value, or None")
    return values


def observe(where: CellFolder, cell: Cell, keep: bool = False) -> Observation:
    """Return the observation that metrics score, read from the cell's folder alone.

    All its arrays are read-only, so that no metric can change them for the next one.

    Parameters
    ----------
    where, cell
        The cell.
    keep
        Whether a texture that a model draws is kept for the next cell of the same sample. Its dataset and all metrics
        must then be nrbench's, because others might change it.
    """
    sample, result = freeze(_read_stored(where.sample)), where.result() or Result()
    cut = where.cut_files(result)
    if cut and cut != [where.output.name]:  # the output is compared by its pixels
        raise InvalidOutput(f"{cut[0]} has changed since the method returned it; --retry-failed runs the cell again")
    truth, again = _truth(cell, sample, keep)
    measured: Mapping[str, Any] = result
    names = ("cpu_seconds", "detection_seconds", "prepare_seconds", "peak_mib")
    cost = {name: measured[name] for name in names if measured.get(name) is not None}
    if cell.detected is not None:
        cost["detection_seconds"] = cell.detected.seconds
    output, used = freeze(read_output(where, result)), result.get("lattice_used")
    return Observation(
        sample=sample,
        output=output,
        truth=truth,
        lattice_given=cell.lattice_given,
        lattice_used=Lattice.from_dict(used) if used else None,
        source=freeze(read_arrays(where.source)["source"]) if where.source.is_file() else None,
        extras={path.stem: freeze(read_arrays(path)["array"]) for path in sorted(where.extras.glob("*.npz"))},
        seconds=result.get("seconds"),
        again=again,
        cost={**cost, "side_by_side": float(result.get("side_by_side", 0))},
        detected=cell.detected,
        known=_read_known(where, sample),
    )


def read_output(where: CellFolder, result: Result) -> Image:
    """Return the output of a cell, from its file.

    Raises
    ------
    BadInput
        When the file is missing or damaged.
    InvalidOutput
        When its pixels are not those that the method returned.
    """
    output = _read_stored(where.output, smallest=1)
    if "output_hash" in result and pixels_hash(output) != result["output_hash"]:
        raise InvalidOutput("output.png has changed since the method returned it; --retry-failed runs the cell again")
    return output


def _truth(cell: Cell, sample: Image, keep: bool) -> tuple[Texture, Again | None]:
    """Return what is known of the sample's texture, and its fresh draws where a model drew it."""
    if not cell.procedural:
        known = (cell.lattice_truth,) if cell.lattice_truth else ()
        plain: dict[str, Any] = {"region": cell.region, "vertices": cell.vertices_truth}
        return Texture(sample, cell.lattice_truth, known, cell.texture, cell.family, **plain), None
    draw = _drawn_truth if keep else _drawn_truth.__wrapped__
    texture, again = draw(_as_json(cell.recipe))
    if cell.replicate and is_built_in("datasets", cell.recipe.dataset):
        again = draw(_as_json(dataclasses.replace(cell.recipe, replicate=0)))[1]
    return dataclasses.replace(texture, image=sample), again


def _as_json(recipe: Recipe) -> str:
    return json.dumps(recipe.as_dict(), sort_keys=True)


@lru_cache(maxsize=2)  # the cells of a sample follow each other; the first replicate is drawn as well
def _drawn_truth(recipe: str) -> tuple[Texture, Again]:
    """Return the texture of a recipe in JSON, and its fresh draws.

    All replicates of a texture are judged by the draws of the first one, so that what they show is learned once: two
    draws of a model of nrbench differ by chance only.
    """
    drawn = Recipe.from_dict(json.loads(recipe))
    texture = freeze(drawn.render())
    return texture, _frozen_draws(drawn.again(texture))


def _read_cell(where: CellFolder) -> Cell:
    content = read_json(where.cell_file)
    if content is None:
        raise InvalidOutput(f"{where.cell_file} has changed since it was written; --retry-failed runs the cell again")
    return Cell.from_dict(content)


@dataclasses.dataclass(frozen=True)
class KeptSurvey:
    """The content of the file of a survey. That of a bent sample, which holds pictures, is kept by the process alone.

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


def survey_once(method: Any, task: Task, cell: Cell, folder: Path) -> SampleSurvey | None:
    """Return the survey of a cell's sample. What it cost counts for each cell that uses it.

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
    if not all(plugins.find("detectors", name).built_in for name in (finder, *bent_finders())):
        return survey_sample(method, task)
    if getattr(method, "geometry", "as-is") == "as-is" or not getattr(method, "uses_lattice", True):
        return None
    key = _survey_key(cell)
    file = folder / f"{key}.json"
    kept = _read_survey(file)
    if kept is None:
        return make_once(("survey", key), _keep_survey, method, task, file)
    REUSED.count(kept.spent)
    return SampleSurvey(kept.found, None, kept.note, kept.spent.seconds)


def _keep_survey(method: Any, task: Task, file: Path) -> SampleSurvey | None:
    """Return the survey of a sample; write its file if the sample is not bent."""
    survey, spent = measure_cost(survey_sample, method, task)
    if survey is not None and survey.bent is None:
        write_json(file, dataclasses.asdict(KeptSurvey(survey.found, survey.note, spent)))
    return survey


def _survey_key(cell: Cell) -> str:
    """Return a hash of all that a survey depends on."""
    given = cell.lattice_given.as_dict() if cell.lattice_given else None
    finder = None if given else cell.finder or identify_detector(in_role("detector"))
    versions = [plugins.find("detectors", name).full_version for name in bent_finders()]
    return hash_content([RESULTS_VERSION, cell.sample_hash, given, finder, versions])


def _read_survey(file: Path) -> KeptSurvey | None:
    """Return what a file holds; None where it is missing or damaged."""
    try:
        kept: KeptSurvey = reader_of(KeptSurvey).validate_python(read_json(file))
    except (OSError, ValidationError):
        return None
    return kept
