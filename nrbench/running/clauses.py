"""The clauses of the forms of plugins: what a plugin of each kind must do, each as a test that runs in a child process.

:func:`check` is a phase like those of :mod:`nrbench.running.phases`. :mod:`nrbench.running.conformance` starts it, once
for each clause. The inputs are small textures that this module draws, so a clause takes a fraction of a second.
"""

from __future__ import annotations

import dataclasses
import hashlib
import inspect
import itertools
import json
import math
import os
import random
import re
import sys
import tempfile
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from nrbench import plugins
from nrbench.errors import BadInput, describe_error
from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import (
    Again,
    Alternative,
    Detection,
    NoLatticeFound,
    Observation,
    Refused,
    Score,
    Shape,
    Synthesis,
    Task,
    Texture,
)
from nrbench.running.outputs import InvalidOutput, check_source, checked_synthesis
from nrbench.running.phases import FAULTS, Send, score_observation, send_error, write_score
from nrbench.runs.records import Run
from nrbench.runs.store import CellFolder
from nrbench.storage import read_json
from nrbench.streams import stream
from nrbench.suites.cell import Recipe
from nrbench.suites.plan import draw_texture

LATTICE = Lattice((16.0, 0.0), (0.0, 12.0), (3.0, 2.0))
"""The lattice of the textures that the clauses use."""
SAMPLE, OUTPUT, LARGE = (84, 100), (96, 112), (192, 224)
"""Shapes of a sample, of an output, and of the output whose time is measured."""
MARK = "nrbench-mark"
MARKUP = {
    ".html": f"<script>{MARK}",
    ".htm": f"<script>{MARK}",
    ".svg": f"<script>{MARK}",
    ".md": f"<script>{MARK}",
    ".tex": f"\\input{{{MARK}",
    ".csv": f"=1+{MARK}",
}
"""Text that names in the run of the reports' clauses contain, by the ending of the files in which it is markup. It must
not stand there unchanged; in CSV not at the beginning of a field."""


class Violated(Exception):
    """The plugin does not do what a clause demands; the message says what it does instead."""


class Skipped(Exception):
    """A clause does not apply to the plugin; the message says why."""


@dataclass(frozen=True)
class Clause:
    """One clause of a form.

    Parameters
    ----------
    name
        A word or two.
    demand
        What a plugin must do, in one sentence.
    test
        Returns what was seen, in a few words; raises :class:`Violated` or :class:`Skipped`.
    after
        The clause that a plugin must fulfil for this one to make sense; empty if there is none.
    twice
        Whether ``test`` runs in two interpreters; it returns a hash, and both must be equal.
    """

    name: str
    demand: str
    test: Callable[[Any], str]
    after: str = ""
    twice: bool = False


def check(folder: Path, send: Send) -> None:
    """Test the clause that ``cell.json`` names.

    Sends one message: status ``ok`` (fulfilled), ``refused`` (it does not apply), ``invalid`` (violated) or ``error``,
    with what was seen.
    """
    wanted = read_json(CellFolder(folder).cell_file) or {}
    subject = SUBJECTS[wanted["kind"]](wanted["name"], wanted["parameters"], wanted.get("run", ""))
    clause = next(clause for clause in CLAUSES[wanted["kind"]] if clause.name == wanted["clause"])
    try:
        send({"status": "ok", "message": clause.test(subject)})
    except Skipped as skipped:
        send({"status": "refused", "message": str(skipped)})
    except Violated as violated:
        send({"status": "invalid", "message": str(violated)})
    except FAULTS as error:
        send_error(error, send)


def draw_texture_of_tiles(shape: Shape, rng: np.random.Generator, channels: int = 3) -> Texture:
    """Return a wall of tiles on :data:`LATTICE`; each tile has a brightness of its own.

    Parameters
    ----------
    shape
        Height and width, px.
    rng
        The source of the brightness of the tiles and of a little noise.
    channels
        1 or 3.
    """
    cells = _cells(shape)
    tiles = cells[..., 0] + cells[..., 1] * (cells[..., 0].max() + 1)
    return _laid(shape, rng.normal(1.0, 0.1, int(tiles.max()) + 1)[tiles], rng, channels)


def _cells(shape: Shape) -> NDArray[np.int64]:
    """Return the numbers ``(H, W, 2)`` of the cell at each pixel, from 0 on."""
    places = _places(shape)
    numbers = np.floor(places).astype(np.int64)
    return np.asarray(numbers - numbers.min((0, 1)))


def _places(shape: Shape) -> NDArray[np.float64]:
    y, x = np.mgrid[: shape[0], : shape[1]]
    xy = np.stack([x, y], -1).reshape(-1, 2).astype(np.float64)
    return np.asarray(LATTICE.to_cell(xy)).reshape(*shape, 2)


def _laid(shape: Shape, factors: NDArray[np.float64], rng: np.random.Generator, channels: int) -> Texture:
    """Return tiles with a factor of brightness at each pixel, and noise."""
    places = _places(shape)
    u, v = np.moveaxis(places - np.floor(places), -1, 0)
    inside = (u > 1 / 16) & (v > 1 / 12)
    relief = 0.5 + 0.2 * u - 0.15 * np.sin(2 * np.pi * u) * (1 - v)
    color = np.array([0.9, 0.7, 0.5]) if channels == 3 else np.array([0.7])
    ideal = np.where(inside, relief, 0.15)[..., np.newaxis] * color
    image = ideal * factors[..., np.newaxis] + rng.normal(0, 0.01, (*shape, 1))
    return Texture(
        quantize(np.asarray(image, np.float32)),
        LATTICE,
        (LATTICE,),
        name="tiles",
        family="tiles",
        kind="I",
        ideal=np.asarray(ideal, np.float32),
        elements={"tile": np.unique(factors)},
        regular_share=0.9,
        draw_seed=0,
    )


def _copied(array: NDArray[Any], read_only: bool) -> Any:
    """Return a copy of an array."""
    copy = np.array(array)
    copy.setflags(write=not read_only)
    return copy


def _copied_texture(texture: Texture, read_only: bool) -> Texture:
    """Return a copy of a texture and of all its arrays."""
    arrays = {name: getattr(texture, name) for name in ("image", "ideal", "displacement")}
    copies = {name: _copied(array, read_only) for name, array in arrays.items() if array is not None}
    elements = {name: _copied(array, read_only) for name, array in texture.elements.items()}
    return dataclasses.replace(texture, elements=elements, **copies)


def digest(answer: Any) -> str:
    """Return a hash of an answer: arrays by their bytes, dataclasses and containers by their content."""
    found = hashlib.blake2b(digest_size=12)
    for part in _parts(answer):
        found.update(part)
    return found.hexdigest()


def _parts(answer: Any) -> Iterator[bytes]:
    if isinstance(answer, np.ndarray):
        yield f"{answer.dtype}{answer.shape}".encode() + np.ascontiguousarray(answer).tobytes()
    elif isinstance(answer, Mapping):
        for key in sorted(answer, key=str):
            yield str(key).encode()
            yield from _parts(answer[key])
    elif isinstance(answer, tuple | list):
        for part in answer:
            yield from _parts(part)
    elif isinstance(answer, Lattice):
        yield repr(answer.numbers).encode()
    elif dataclasses.is_dataclass(answer) and not isinstance(answer, type):
        names = [item.name for item in dataclasses.fields(answer) if item.name != "detection_seconds"]
        yield from _parts({name: getattr(answer, name) for name in names})
    else:
        yield repr(answer).encode()


@dataclass(frozen=True)
class Subject(ABC):
    """A plugin that is checked. Subclasses know how a plugin of their kind is called.

    Parameters
    ----------
    name, parameters
        The plugin's name, and the parameters that differ from its defaults.
    run
        Directory of a finished run, for reports.
    """

    name: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    run: str = ""

    kind = ""

    @cached_property
    def plugin(self) -> Any:
        """The instance of the plugin."""
        return plugins.build(self.kind, self.name, self.parameters)

    @property
    def cls(self) -> type[Any]:
        """The class of the plugin."""
        return type(self.plugin)

    @abstractmethod
    def answer(self, seed: int = 0, read_only: bool = False) -> Any:
        """Return the plugin's answer to an input of its own seed, whose arrays are read-only if ``read_only``."""


def _parameters(subject: Subject) -> str:
    known = plugins.parameters_of(subject.plugin)
    try:
        back = json.loads(json.dumps(known, allow_nan=False))
        again = plugins.parameters_of(plugins.build(subject.kind, subject.name, back))
    except (TypeError, ValueError) as error:
        raise Violated(f"do not survive JSON: {error}") from None
    _demand(again == known, f"read back from JSON as {again}")
    for name, value in known.items():
        text = _as_text(value)
        if text is not None:
            given = {**known, name: text}
            try:
                found = plugins.parameters_of(plugins.build(subject.kind, subject.name, given))[name]
            except BadInput as error:
                raise Violated(f"{name}={text} is refused as text: {error}") from None
            _demand(found == value, f"{name}={text} is read as {found!r} instead of {value!r}")
    return f"{len(known)} parameter{'s' * (len(known) != 1)} survive JSON and text"


def _as_text(value: Any) -> str | None:
    """Return a value as a command line has it; None for one that it cannot have: empty or nested lists."""
    if isinstance(value, list):
        parts = [_as_text(part) for part in value if not isinstance(part, list)]
        return ",".join(map(str, parts)) if parts and len(parts) == len(value) else None
    return "none" if value is None else str(value).lower() if isinstance(value, bool) else str(value)


def _docstring(subject: Subject) -> str:
    page = inspect.getdoc(subject.cls) or ""
    described = set(re.findall(r"\w+", " ".join(re.findall(r"(?m)^\w+(?:, \w+)*(?= *:|$)", _section(page)))))
    missing = [item.name for item in dataclasses.fields(subject.cls) if item.name not in described]
    _demand(not missing, f"does not describe {', '.join(missing)}; add a section `Parameters` in NumPy style")
    return page.partition("\n")[0]


def _section(page: str) -> str:
    """Return the section of parameters of a docstring in NumPy style."""
    after = re.split(r"(?m)^Parameters\n-+\n", page, maxsplit=1)[1:]
    return re.split(r"(?m)^\w[\w ]*\n-+\n", after[0], maxsplit=1)[0] if after else ""


def _paper(subject: Subject) -> str:
    entry = getattr(subject.cls, "paper", "")
    if not entry:
        raise Skipped("declares no paper; if there is one, set `paper: ClassVar[str]` to its BibTeX entry")
    text = inspect.cleandoc(str(entry))
    found = re.match(r"@\w+\s*\{\s*([^\s,{}]+)\s*,", text)
    _demand(found is not None, f"{text[:40]!r} is no BibTeX entry; begin with @article{{key,")
    _demand(text.count("{") == text.count("}"), "the braces of the BibTeX entry do not match")
    assert found is not None
    return found[1]


def _determinism(subject: Subject) -> str:
    first = digest(_seeded(subject, 0, 1))
    _seeded(subject, 5, 1)
    _demand(digest(_seeded(subject, 0, 1)) == first, "the same input gave another answer the second time")
    return "same input, same bytes, also after another input"


def _seeded(subject: Subject, seed: int, state: int) -> Any:
    """Return an answer after the global generators were seeded, so that only other randomness makes a difference."""
    np.random.seed(state)  # noqa: NPY002
    random.seed(state)
    return subject.answer(seed)


def _processes(subject: Subject) -> str:
    return digest(_seeded(subject, 0, 1))


def _randomness(subject: Subject) -> str:
    np.random.seed(1)  # noqa: NPY002
    random.seed(1)
    before = _states()
    subject.answer()
    changed = [name for name, state in _states().items() if state != before[name]]
    _demand(not changed, f"draws from, or seeds, {' and '.join(changed)}; draw from the generator that is passed in")
    return "the global generators of numpy and Python stay as they are"


def _states() -> dict[str, Any]:
    kind, words, *rest = cast("tuple[Any, ...]", np.random.get_state())  # noqa: NPY002
    return {"np.random": (kind, words.tobytes(), *rest), "random": random.getstate()}


def _side_effects(subject: Subject) -> str:
    subject.answer()  # imports and caches of the first call are no side effects
    before, threads = _surroundings(subject), set(threading.enumerate())
    subject.answer()
    after = _surroundings(subject)
    changed = [name for name in before if before[name] != after[name]]
    _demand(not changed, f"changes {' and '.join(changed)}")
    _demand(set(threading.enumerate()) <= threads, "leaves a thread running")
    return "parameters, files, environment and settings stay as they are"


def _surroundings(subject: Subject) -> dict[str, Any]:
    here = Path.cwd()
    files = {entry.name: (entry.stat().st_mtime_ns, entry.stat().st_size) for entry in here.iterdir() if entry.exists()}
    return {
        "its own parameters": plugins.parameters_of(subject.plugin),
        "the working directory": here,
        "files of the working directory": files,
        "environment variables": dict(os.environ),
        "numpy's handling of errors (np.seterr)": np.geterr(),
        "sys.path": list(sys.path),
    }


def _read_only(subject: Subject) -> str:
    try:
        subject.answer(read_only=True)
    except ValueError as error:
        if "read-only" not in str(error):
            raise
        raise Violated(f"writes into its input: {describe_error(error)}; copy the array first") from None
    return "leaves its input alone"


def _demand(holds: Any, message: str) -> None:
    if not holds:
        raise Violated(message)


def _common_clauses(answer: Clause) -> tuple[Clause, ...]:
    """Return the clauses that plugins of all kinds share; ``answer`` is that of a valid answer."""
    after = answer.name
    return (
        Clause("parameters", "Parameters survive JSON and text.", _parameters),
        Clause("docstring", "The docstring describes every parameter.", _docstring),
        Clause("paper", "The paper, if there is one, is a BibTeX entry.", _paper),
        answer,
        Clause("determinism", "The same input gives the same bytes.", _determinism, after),
        Clause("processes", "Two interpreters give the same bytes.", _processes, "determinism", twice=True),
        Clause("randomness", "All randomness comes from the generator that is passed in.", _randomness, after),
        Clause("side effects", "Nothing outside of the plugin changes.", _side_effects, after),
    )


def _clause_of_arrays(answer: str) -> Clause:
    return Clause("read-only", "The input is not changed.", _read_only, answer)


class Method(Subject):
    """A synthesizer."""

    kind = "synthesizers"

    @property
    def uses_lattice(self) -> bool:
        """Whether the method uses a lattice."""
        return bool(getattr(self.plugin, "uses_lattice", True))

    def task(self, seed: int = 0, channels: int = 3, read_only: bool = False, **changes: Any) -> Task:
        """Return a task; ``changes`` are fields of :class:`~nrbench.plugins.forms.Task`."""
        sample = changes.pop("sample", None)
        if sample is None:
            sample = draw_texture_of_tiles(SAMPLE, stream("check", seed), channels).image
        fields: dict[str, Any] = {"lattice": LATTICE if self.uses_lattice else None, "shape": OUTPUT, **changes}
        if getattr(self.cls, "reference", False):
            draws = partial(_draw_again, seed, channels, read_only)
            fields |= {"again": draws, "recompose": draws}
        return Task(_copied(sample, read_only), rng=stream("check", seed, "method"), **fields)

    def answer(self, seed: int = 0, read_only: bool = False) -> Synthesis:
        """Return a synthesis of tiles whose lattice is given."""
        return cast("Synthesis", self.plugin.synthesize(self.task(seed, read_only=read_only)))

    def valid(self, task: Task) -> Synthesis:
        """Return the checked synthesis of a task, its source map unchecked; Refused and errors of the method pass."""
        made = self.plugin.synthesize(task)
        try:
            bare = dataclasses.replace(made, source=None) if isinstance(made, Synthesis) else made
            return dataclasses.replace(checked_synthesis(bare, task.sample, task.shape), source=made.source)
        except InvalidOutput as invalid:
            raise Violated(str(invalid)) from None


def _draw_again(seed: int, channels: int, read_only: bool, shape: Shape, k: int) -> Texture:
    return _copied_texture(draw_texture_of_tiles(shape, stream("check", seed, "again", k), channels), read_only)


def _output(method: Method) -> str:
    try:
        made = method.valid(method.task())
    except Refused as refusal:
        raise Skipped(f"refused: {refusal.reason}") from None
    height, width, channels = made.image.shape
    return f"{width}x{height} px, {channels} channels, in [0, 1]"


def _gray_output(method: Method) -> str:
    try:
        made = method.valid(method.task(channels=1))
    except Refused as refusal:
        raise Skipped(f"refused: {refusal.reason}") from None
    return f"{made.image.shape[2]} channel"


def _own_lattice(method: Method) -> str:
    if not method.uses_lattice:
        raise Skipped("uses no lattice")
    try:
        made = method.valid(method.task(lattice=None))
    except Refused as refusal:
        return f"refused: {refusal.reason}"
    return f"found {_numbers(made.lattice)}" if made.lattice else "answered without a lattice"


def _numbers(lattice: Lattice) -> str:
    return ",".join(f"{x:.4g}" for x in lattice.numbers[:4])


def _source_map(method: Method) -> str:
    task = method.task()
    made = method.plugin.synthesize(task)
    if made.source is None:
        raise Skipped("gives no source map")
    source = np.asarray(made.source, np.float32)
    try:
        check_source(source, quantize(np.asarray(made.image, np.float32)), task.sample)
    except InvalidOutput as invalid:
        raise Violated(str(invalid)) from None
    return f"{np.mean(source[..., 2] > 1 - 1e-6):.0%} of the pixels are copies, all equal to their sources"


def _refusals(method: Method) -> str:
    tiles = draw_texture_of_tiles(SAMPLE, stream("check", 0)).image
    noise = quantize(stream("check", "noise").random((*SAMPLE, 3), np.float32))
    cases: dict[str, dict[str, Any]] = {
        "a sample of 8x8 px": {"sample": tiles[:8, :8]},
        "a sample of one color": {"sample": np.full_like(tiles, 0.5)},
        "a strip of 8 px": {"sample": tiles[:8]},
        "an output smaller than the sample": {"shape": (24, 20)},
        "an output of one pixel": {"shape": (1, 1)},
    }
    if method.uses_lattice:
        cases |= {
            "noise, and no lattice given": {"sample": noise, "lattice": None},
            "a lattice larger than the sample": {"lattice": Lattice((200.0, 0.0), (0.0, 150.0))},
        }
    refused = 0
    for name, changes in cases.items():
        try:
            method.valid(method.task(**changes))
        except Refused as refusal:
            _demand(isinstance(refusal.reason, str) and refusal.reason, f"{name}: refused without a reason")
            refused += 1
        except Violated as violated:
            raise Violated(f"{name}: {violated}") from None
        except FAULTS as error:
            raise Violated(f"{name}: raised {describe_error(error)}; raise Refused instead") from error
    return f"{len(cases)} odd inputs: {refused} refused, {len(cases) - refused} valid"


def _progress(method: Method) -> str:
    seen: list[float] = []
    method.plugin.synthesize(method.task(progress=seen.append))
    if not seen:
        raise Skipped("reports no progress")
    inside = all(isinstance(x, int | float | np.number) and 0 <= x <= 1 for x in seen)
    _demand(inside, f"reports {seen[:5]}; pass fractions in [0, 1]")
    _demand(seen == sorted(seen), "the fraction goes back; it must not fall")
    return f"{len(seen)} reports, the last one {seen[-1]:.2g}"


def _time_of(call: Callable[[], Any], pixels: int) -> str:
    call()
    start = time.perf_counter()
    call()
    seconds = time.perf_counter() - start
    return f"{seconds / pixels * 1e6:.3g} µs a pixel ({seconds * 1e3:.3g} ms)"


def _synthesis_time(method: Method) -> str:
    return _time_of(lambda: method.valid(method.task(shape=LARGE)), math.prod(LARGE)) + " of the output"


class LatticeDetector(Subject):
    """A detector."""

    kind = "detectors"

    def image(self, seed: int = 0, channels: int = 3) -> Image:
        """Return tiles."""
        return draw_texture_of_tiles(OUTPUT, stream("check", seed), channels).image

    def answer(self, seed: int = 0, read_only: bool = False) -> Any:
        """Return the detection in tiles, or the reason why there is none."""
        try:
            return self.plugin.detect(_copied(self.image(seed), read_only))
        except NoLatticeFound as none:
            return none.reason

    def valid(self, image: Image) -> Detection | str:
        """Return the checked detection in an image, or the reason why there is none."""
        try:
            found = self.plugin.detect(_copied(image, False))
        except NoLatticeFound as none:
            _demand(isinstance(none.reason, str) and none.reason, "raised NoLatticeFound without a reason")
            return none.reason
        _demand(isinstance(found, Detection), f"returned {type(found).__name__} instead of a Detection")
        _demand(isinstance(found.lattice, Lattice), f"returned the lattice {found.lattice!r}; it must be a Lattice")
        share = found.confidence
        number = isinstance(share, int | float | np.number) and not isinstance(share, bool)
        _demand(number and 0 <= share <= 1, f"returned the confidence {share!r}; it must be a number in [0, 1]")
        _demand(all(isinstance(name, str) for name in found.diagnostics), "diagnostics have names that are no text")
        others = isinstance(found.alternatives, tuple) and all(isinstance(o, Alternative) for o in found.alternatives)
        _demand(others, "alternatives must be a tuple of Alternative")
        return cast("Detection", found)


def _describe(found: Detection | str) -> str:
    if isinstance(found, str):
        return f"no lattice: {found}"
    return f"{_numbers(found.lattice)}, confidence {found.confidence:.2g}"


def _detection(detector: LatticeDetector) -> str:
    return _describe(detector.valid(detector.image()))


def _gray_detection(detector: LatticeDetector) -> str:
    return _describe(detector.valid(detector.image(channels=1)))


def _constant(detector: LatticeDetector) -> str:
    found = detector.valid(np.full((*OUTPUT, 3), 0.5, np.float32))
    _demand(isinstance(found, str), f"found {_describe(found)} in an image of one color; raise NoLatticeFound")
    return _describe(found)


def _odd_images(detector: LatticeDetector) -> str:
    tiles = detector.image()
    noise = quantize(stream("check", "noise").random(tiles.shape, np.float32))
    cases = {"8x8 px": tiles[:8, :8], "a strip of 8 px": tiles[:8], "noise": noise, "two values": np.rint(noise)}
    found = 0
    for name, image in cases.items():
        try:
            found += not isinstance(detector.valid(image), str)
        except Violated as violated:
            raise Violated(f"{name}: {violated}") from None
        except FAULTS as error:
            raise Violated(f"{name}: raised {describe_error(error)}; raise NoLatticeFound instead") from error
    return f"{len(cases)} odd images: a lattice in {found}, none in {len(cases) - found}"


def _detection_time(detector: LatticeDetector) -> str:
    image = draw_texture_of_tiles(LARGE, stream("check", 0)).image
    return _time_of(lambda: detector.valid(image), math.prod(LARGE))


class ScoreFamily(Subject):
    """A metric."""

    kind = "metrics"

    def observation(
        self, seed: int = 0, channels: int = 3, read_only: bool = False, known: str = "model"
    ) -> Observation:
        """Return a fresh draw as an output. ``known`` is ``"model"``, ``"lattice"`` or ``"nothing"``."""
        sample = _copied_texture(draw_texture_of_tiles(SAMPLE, stream("check", seed), channels), read_only)
        output = draw_texture_of_tiles(OUTPUT, stream("check", seed, "output"), channels).image
        again: Again | None = partial(_draw_again, seed, channels, read_only) if known == "model" else None
        bare = Texture(sample.image, LATTICE, (LATTICE,))
        return Observation(
            sample.image,
            _copied(output, read_only),
            {"model": sample, "lattice": bare}.get(known),
            lattice_given=LATTICE if known != "nothing" else None,
            seconds=0.25 if known != "nothing" else None,
            cost={"cpu_seconds": 0.25, "peak_mib": 1.0} if known != "nothing" else {},
            again=again,
        )

    def answer(self, seed: int = 0, read_only: bool = False) -> Score:
        """Return the score of a fresh draw."""
        return score_observation(self.observation(seed, read_only=read_only), self.name, self.parameters)

    def valid(self, **changes: Any) -> Score:
        """Return the checked score of an observation."""
        try:
            score = score_observation(self.observation(**changes), self.name, self.parameters)
        except (TypeError, ValueError) as error:
            raise Violated(describe_error(error)) from error
        with tempfile.TemporaryDirectory(prefix="nrbench-") as folder:
            write_score(CellFolder(Path(folder)), self.name, score)
        return score


def _score(metric: ScoreFamily) -> str:
    score = metric.valid()
    given = sum(value is not None for value in score.values.values())
    return f"{given} of {len(score.values)} columns have a value"


def _gray_score(metric: ScoreFamily) -> str:
    score = metric.valid(channels=1)
    return f"{sum(value is not None for value in score.values.values())} of {len(score.values)} columns have a value"


def _range(metric: ScoreFamily) -> str:
    for known in ("model", "lattice"):
        for name, value in metric.valid(known=known).values.items():
            low, high = metric.cls.columns[name].range
            _demand(value is None or low <= value <= high, f"{name} is {value}, outside its range {low} to {high}")
    return "all values are in the ranges that the columns declare"


def _little_known(metric: ScoreFamily) -> str:
    given = {}
    for known in ("lattice", "nothing"):
        try:
            score = metric.valid(known=known)
        except FAULTS as error:
            what = "no model, as of a photograph" if known == "lattice" else "nothing known of the texture"
            raise Violated(f"{what}: {describe_error(error)}; give None and a reason") from error
        given[known] = sum(value is not None for value in score.values.values())
    return f"values: {given['lattice']} without a model, {given['nothing']} without a lattice, too"


def _score_time(metric: ScoreFamily) -> str:
    return _time_of(metric.answer, math.prod(OUTPUT)) + " of the output"


class TextureModel(Subject):
    """A dataset."""

    kind = "datasets"

    def recipe(self, seed: int = 0, shape: Shape = SAMPLE) -> Recipe:
        """Return the recipe of a draw."""
        return Recipe(self.name, plugins.parameters_of(self.plugin), seed, "check", 0, shape)

    def answer(self, seed: int = 0, read_only: bool = False) -> Any:
        """Return a texture, and a fresh draw of it."""
        recipe = self.recipe(seed)
        texture = _copied_texture(recipe.render(), read_only)
        recompose = recipe.recompose(texture)
        return texture, recipe.again(texture)(SAMPLE, 0), recompose(SAMPLE, 0) if recompose else None

    def valid(self, seed: int = 0, shape: Shape = SAMPLE) -> Texture:
        """Return a checked texture."""
        try:
            return draw_texture(self.recipe(seed, shape), shape)[0]
        except BadInput as error:
            raise Violated(str(error)) from None


def _texture(model: TextureModel) -> str:
    texture = model.valid()
    height, width, channels = texture.image.shape
    known = f"lattice {_numbers(texture.lattice)}" if texture.lattice else "no lattice"
    return f"{width}x{height} px, {channels} channels, {known}"


def _shapes(model: TextureModel) -> str:
    for shape in ((8, 40), (40, 8), (101, 97)):
        texture = model.valid(shape=shape)
        _demand(max(texture.image.shape[:2]) <= max(shape), f"a texture of {shape} has shape {texture.image.shape}")
    return "strips and odd sizes"


def _truth(model: TextureModel) -> str:
    texture = model.recipe().render()
    shape = texture.image.shape
    ideal, moved = texture.ideal, texture.displacement
    _demand(ideal is None or ideal.shape == shape, f"ideal has shape {np.asarray(ideal).shape}; it must be {shape}")
    _demand(ideal is None or (ideal.min() >= 0 and ideal.max() <= 1), "ideal has values outside [0, 1]")
    wanted = (*shape[:2], 2)
    _demand(
        moved is None or moved.shape == wanted, f"displacement has shape {np.asarray(moved).shape}; it must be {wanted}"
    )
    for name, values in texture.elements.items():
        arrays = isinstance(values, np.ndarray) and values.ndim >= 1
        _demand(arrays, f"elements[{name!r}] must be an array whose first axis counts elements")
    if texture.lattice is None:
        return "no lattice"
    _demand(
        texture.lattice in texture.lattices or not texture.lattices, "lattices does not contain lattice; put it first"
    )
    if ideal is None:
        return "no ideal image"
    error = _repetition_error(np.asarray(ideal, np.float64), texture.lattice)
    if error is None:
        return "the sample is smaller than a cell"
    _demand(error < 0.5, f"the ideal image does not repeat by the lattice: {error:.2f} of its variance differs")
    return f"the ideal image repeats by the lattice ({error:.1%} of its variance differs)"


def _repetition_error(ideal: NDArray[np.float64], lattice: Lattice) -> float | None:
    """Return the mean squared difference to the copies shifted by the vectors, over twice the variance; None if small.

    The shifted copy is interpolated linearly, so edges differ a little.
    """
    from scipy import ndimage

    errors, variance = [], float(ideal.var((0, 1)).sum())
    y, x = np.mgrid[: ideal.shape[0], : ideal.shape[1]].astype(np.float64)
    reduced = lattice.reduced()
    for vector in (reduced.t1, reduced.t2):
        inside = (y + vector[1] >= 0) & (y + vector[1] <= len(ideal) - 1)
        inside &= (x + vector[0] >= 0) & (x + vector[0] <= ideal.shape[1] - 1)
        if inside.sum() >= 64:
            places = np.stack([y[inside] + vector[1], x[inside] + vector[0]])
            moved = [ndimage.map_coordinates(channel, places, order=1) for channel in np.moveaxis(ideal, -1, 0)]
            errors.append(float(np.square(np.stack(moved, -1) - ideal[inside]).sum(-1).mean()))
    return max(errors) / (2 * variance) if errors and variance > 1e-9 else None


def _again(model: TextureModel) -> str:
    texture = model.valid()
    draws = [model.recipe().again(texture)(OUTPUT, k) for k in (0, 1)]
    if draws[0] is None:
        raise Skipped("gives no fresh draws; the oracle refuses the texture")
    for drawn in draws:
        _demand(isinstance(drawn, Texture), f"returned {type(drawn).__name__} instead of a Texture or None")
        assert drawn is not None
        wanted = (*OUTPUT, texture.image.shape[2])
        _demand(drawn.image.shape == wanted, f"a draw of {wanted} has the shape {drawn.image.shape}")
        _demand(bool(np.isfinite(drawn.image).all()), "a draw has NaN or infinity")
        one, other = texture.lattice, drawn.lattice
        if one is not None and texture.region is None:
            _demand(other is not None and other.is_equivalent(one), f"a draw has another lattice: {other} after {one}")
            assert other is not None
            away = np.hypot(*one.wrap(np.subtract(other.origin, one.origin)))
            _demand(away < 1e-6, f"a draw has another origin: {other.origin} after {one.origin}")
    return f"{OUTPUT[1]}x{OUTPUT[0]} px, with the same lattice and origin"


def _recompose(model: TextureModel) -> str:
    texture = model.valid()
    recompose = model.recipe().recompose(texture)
    if recompose is None:
        raise Skipped("has no method recompose; the reference `copier` refuses the texture")
    drawn = recompose(OUTPUT, 0)
    _demand(isinstance(drawn, Texture), f"returned {type(drawn).__name__} instead of a Texture")
    assert drawn is not None
    wanted = (*OUTPUT, texture.image.shape[2])
    _demand(drawn.image.shape == wanted, f"a draw of {wanted} has the shape {drawn.image.shape}")
    return f"{OUTPUT[1]}x{OUTPUT[0]} px"


def _drawing_time(model: TextureModel) -> str:
    return _time_of(lambda: model.valid(shape=LARGE), math.prod(LARGE))


class RunReport(Subject):
    """A report."""

    kind = "reports"

    def answer(self, seed: int = 0, read_only: bool = False) -> dict[str, bytes]:
        """Return the files of the report by name."""
        return {name: path.read_bytes() for name, path in self.written()}

    def written(self, run: Path | None = None) -> Iterator[tuple[str, Path]]:
        """Write the report into a new folder of the run; yield each file, then remove the folder."""
        root = run or Path(self.run)
        with tempfile.TemporaryDirectory(prefix="check-", dir=root) as place:
            folder = Path(place, "report")
            folder.mkdir()
            paths = self.plugin.write(Run(root), folder)
            listed = not isinstance(paths, str) and hasattr(paths, "__iter__")
            _demand(listed, f"write returned {type(paths).__name__}; return the paths of the files")
            for path in paths:
                _demand(isinstance(path, str | Path), f"write returned {path!r}; return the paths of the files")
                file = Path(path).resolve()
                _demand(file.is_file(), f"write returned {path}, but there is no such file")
                inside = file.is_relative_to(folder.resolve())
                yield (str(file.relative_to(folder.resolve())) if inside else str(file)), file


@contextmanager
def _copy_of_run(report: RunReport) -> Iterator[Path]:
    """Yield a copy of the run in which no cell has ended."""
    with tempfile.TemporaryDirectory(prefix="nrbench-") as place:
        Path(place, "cells").mkdir()
        Path(place, "run.json").write_bytes(Path(report.run, "run.json").read_bytes())
        yield Path(place)


def _files(report: RunReport) -> str:
    found = {name: path.stat().st_size for name, path in report.written()}
    _demand(found, "wrote no file, or did not return its path")
    return ", ".join(f"{name} ({size / 1024:.1f} KiB)" for name, size in itertools.islice(found.items(), 3))


def _inside(report: RunReport) -> str:
    root = Path(report.run)
    before = _listed(root)
    outside = [name for name, _ in report.written() if Path(name).is_absolute()]
    _demand(not outside, f"wrote {', '.join(outside)}; write into the folder that is passed")
    _demand(_listed(root) == before, "changes other files of the run; write into the folder that is passed")
    return "all files lie in the folder that is passed"


def _listed(root: Path) -> dict[str, tuple[int, int]]:
    return {
        str(path.relative_to(root)): (path.stat().st_mtime_ns, path.stat().st_size)
        for path in root.rglob("*")
        if path.is_file()
    }


def _no_results(report: RunReport) -> str:
    with _copy_of_run(report) as root:
        found = list(report.written(root))
    return f"{len(found)} file{'s' * (len(found) != 1)} of a run in which no cell has ended"


def _markup(report: RunReport) -> str:
    checked = 0
    for name, path in report.written():
        active = MARKUP.get(path.suffix.lower())
        if active is None:
            continue
        checked += 1
        text = path.read_text("utf-8", "replace")
        at_start = any(
            re.match(rf'"?{re.escape(active)}', part) for line in text.splitlines() for part in line.split(",")
        )
        _demand(
            not (at_start if active.startswith("=") else active in text),
            f"{name} contains {active!r} of a name unchanged; escape names and messages",
        )
    if not checked:
        raise Skipped(f"writes no {', '.join(MARKUP)}")
    return "names and messages with markup are escaped"


def _terminal(report: RunReport) -> str:
    if not getattr(report.cls, "terminal", False):
        raise Skipped("is not printed after a run; set `terminal: ClassVar[bool] = True` if it is to be")
    try:
        made = plugins.build("reports", report.name, {**report.parameters, "width": 80})
    except BadInput as error:
        raise Violated(f"{error}; a report for the terminal has a parameter `width`") from None
    text = made.render(Run(Path(report.run)))
    _demand(isinstance(text, str), f"render returned {type(text).__name__} instead of text")
    return f"{len(text.splitlines())} lines"


def _writing_time(report: RunReport) -> str:
    report.answer()
    start = time.perf_counter()
    report.answer()
    cells = len(Run(Path(report.run)).cells)
    return f"{(time.perf_counter() - start) / cells * 1e3:.3g} ms a cell (of {cells})"


SUBJECTS: Mapping[str, type[Subject]] = {
    one.kind: one for one in (Method, LatticeDetector, ScoreFamily, TextureModel, RunReport)
}
_GRAY = "An image of one channel works."
_TIME = "The time is measured."
CLAUSES: Mapping[str, tuple[Clause, ...]] = {
    "synthesizers": (
        *_common_clauses(
            Clause("output", "The output has the shape, the channels and the range of an image.", _output)
        ),
        _clause_of_arrays("output"),
        Clause("gray", "A gray sample gives a gray output.", _gray_output, "output"),
        Clause("own lattice", "Without a given lattice the method finds it or refuses.", _own_lattice, "output"),
        Clause("source map", "Pixels that the source map calls copies equal their sources.", _source_map, "read-only"),
        Clause("refusals", "An input that the method cannot use is refused.", _refusals, "output"),
        Clause("progress", "The reported fractions rise from 0 to 1.", _progress, "output"),
        Clause("time", _TIME, _synthesis_time, "output"),
    ),
    "detectors": (
        *_common_clauses(Clause("detection", "The detector returns a Detection or finds no lattice.", _detection)),
        _clause_of_arrays("detection"),
        Clause("gray", _GRAY, _gray_detection, "detection"),
        Clause("no guess", "An image of one color has no lattice.", _constant, "detection"),
        Clause("odd images", "Small images and noise raise no error.", _odd_images, "no guess"),
        Clause("time", _TIME, _detection_time, "detection"),
    ),
    "metrics": (
        *_common_clauses(Clause("score", "Every declared column has a value, or None and a reason.", _score)),
        _clause_of_arrays("score"),
        Clause("gray", _GRAY, _gray_score, "score"),
        Clause("little known", "Without a model or a lattice there are values or reasons.", _little_known, "score"),
        Clause("range", "The values are in the declared ranges.", _range, "little known"),
        Clause("time", _TIME, _score_time, "score"),
    ),
    "datasets": (
        *_common_clauses(Clause("texture", "The texture has the shape, the channels and the range.", _texture)),
        _clause_of_arrays("texture"),
        Clause("shapes", "Strips and odd sizes can be drawn.", _shapes, "texture"),
        Clause("truth", "The truth fits the image: shapes, ranges, and the lattice.", _truth, "texture"),
        Clause("fresh draws", "Fresh draws have the same lattice and origin.", _again, "texture"),
        Clause("recomposition", "Draws of copied elements have the requested shape.", _recompose, "texture"),
        Clause("time", _TIME, _drawing_time, "texture"),
    ),
    "reports": (
        *_common_clauses(Clause("files", "The report returns the paths of the files that it wrote.", _files)),
        Clause("inside", "All files lie in the folder that is passed.", _inside, "files"),
        Clause("no results", "A run without results can be reported.", _no_results, "files"),
        Clause("markup", "Names and messages are escaped.", _markup, "files"),
        Clause("terminal", "A report for the terminal returns text.", _terminal, "files"),
        Clause("time", _TIME, _writing_time, "files"),
    ),
}
"""The clauses of each kind, in the order in which they are tested."""
