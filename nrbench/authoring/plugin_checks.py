"""What a plugin of each kind must do: one function for each clause, which ``nrbench check`` and tests share.

The check of a clause is a plain function of a :class:`Subject`, the plugin that is checked. It returns what was seen,
in a few words, or None. It raises InvalidOutput if the plugin does something else, and Refused if the clause does not
apply. Its docstring says what a plugin must do. :data:`CHECKS` lists the functions, and :data:`FIXTURES` the small
inputs on which the plugins of each kind are tried.
"""

from __future__ import annotations

import dataclasses
import hashlib
import inspect
import json
import os
import random
import re
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from nrbench import plugins
from nrbench.calling.method_calls import InvalidOutput, briefly_prepared, check_source, checked_synthesis
from nrbench.errors import BadInput, describe_error
from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.plugins import forms
from nrbench.plugins.forms import Refused
from nrbench.plugins.parameters import leave_user_folder, user_path
from nrbench.running.phases import FAULTS, score_observation, write_score
from nrbench.runs.records import Run
from nrbench.runs.store import CellFolder
from nrbench.streams import stream
from nrbench.suites.cell import Recipe
from nrbench.suites.plan import draw_texture
from nrbench.work import freeze, leaves

EXAMPLES: Mapping[str, Any] = tomllib.loads(files(__package__).joinpath("templates/examples.toml").read_text("utf-8"))
WALL = EXAMPLES["wall"]
"""Parameters of the brick wall on which plugins are tried."""
SAMPLE, OUTPUT = (84, 100), (96, 112)
"""Shapes of a sample and of an output."""


def demand(holds: Any, message: str) -> None:
    """Raise InvalidOutput with a message unless a condition holds."""
    if not holds:
        raise InvalidOutput(message)


@dataclass(frozen=True)
class Subject:
    """A plugin that is checked.

    Parameters
    ----------
    kind, name, parameters
        The plugin, and the parameters that differ from its defaults.
    run
        Directory of a finished run, for reports.
    files
        The files of plugins that another interpreter has to load.
    """

    kind: str
    name: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    run: str = ""
    files: tuple[str, ...] = ()

    @cached_property
    def plugin(self) -> Any:
        """The instance of the plugin."""
        return plugins.build(self.kind, self.name, self.parameters)

    @property
    def cls(self) -> type[Any]:
        """The class of the plugin."""
        return type(self.plugin)

    def answer(self, seed: int = 0) -> Any:
        """Return the plugin's answer to the input of a seed."""
        fixture = FIXTURES[self.kind]
        return fixture.call(self, fixture.make_input(self, seed))

    def check_answer(self, **changes: Any) -> str:
        """Check the answer to a changed input; return it in a few words. Refused and errors of the plugin pass."""
        return FIXTURES[self.kind].check_answer(self, **changes)

    def to_json(self) -> str:
        """Return the subject as JSON, for another interpreter."""
        return json.dumps({item.name: getattr(self, item.name) for item in dataclasses.fields(self)}, default=str)

    @classmethod
    def from_json(cls, text: str) -> Subject:
        """Return the subject of :meth:`to_json`, and load its files."""
        content = json.loads(text)
        for file in content["files"]:
            plugins.add_file(file)
        return cls(**content)


class Fixture(NamedTuple):
    """How plugins of one kind are tried.

    Parameters
    ----------
    make_input
        Returns an input from a subject and a seed; further arguments depend on the kind.
    call
        Returns the plugin's answer to an input.
    check_answer
        Checks the answer to an input, which keyword arguments change, and returns the answer in a few words.
    """

    make_input: Callable[..., Any]
    call: Callable[[Subject, Any], Any]
    check_answer: Callable[..., str]


# ---------------------------------------------------------------------------------------------------- the inputs


@lru_cache(maxsize=8)  # metrics keep what they learn of a texture by its fresh draws
def draw_wall(
    seed: int, channels: int = 3, shape: forms.Shape = SAMPLE
) -> tuple[forms.Texture, forms.Again, forms.Again]:
    """Return a brick wall with its fresh draws and its recompositions, which are read-only as in a run.

    Parameters
    ----------
    seed
        The entropy of its random streams.
    channels
        1 or 3.
    shape
        Height and width, px.
    """
    parameters = plugins.parameters_of(plugins.build("datasets", WALL["dataset"], WALL["parameters"]))
    recipe = Recipe(WALL["dataset"], parameters, seed, "check", 0, shape)
    wall = recipe.render()

    def reduced(texture: forms.Texture | None) -> forms.Texture:
        assert texture is not None and texture.ideal is not None
        image, ideal = (array[..., :channels] for array in (texture.image, texture.ideal))
        return freeze(dataclasses.replace(texture, image=quantize(image), ideal=np.ascontiguousarray(ideal)))

    draws = (recipe.again(wall), cast("forms.Again", recipe.recompose(wall)))
    again, recompose = ((lambda shape, k, draw=draw: reduced(draw(shape, k))) for draw in draws)
    return reduced(wall), again, recompose


def digest(answer: Any) -> str:
    """Return a hash of an answer: arrays by their bytes, dataclasses and containers by their content."""
    found = hashlib.blake2b(digest_size=12)
    for part in leaves(
        dataclasses.replace(answer, detection_seconds=0) if isinstance(answer, forms.Synthesis) else answer
    ):
        if isinstance(part, np.ndarray):
            found.update(f"{part.dtype}{part.shape}".encode() + np.ascontiguousarray(part).tobytes())
        else:
            found.update(repr(part).encode())
    return found.hexdigest()


# -------------------------------------------------------------------------------------- the plugins of each kind


def uses_lattice(method: Subject) -> bool:
    """Return whether a method uses a lattice."""
    return bool(getattr(method.plugin, "uses_lattice", True))


def make_task(method: Subject, seed: int = 0, channels: int = 3, **changes: Any) -> forms.Task:
    """Return a task; ``changes`` are fields of :class:`~nrbench.plugins.forms.Task`."""
    wall, again, recompose = draw_wall(seed, channels)
    fields: dict[str, Any] = {
        "sample": wall.image.copy(),
        "lattice": wall.lattice if uses_lattice(method) else None,
        "shape": OUTPUT,
        "rng": stream("check", seed, "method"),
        **changes,
    }
    if getattr(method.cls, "reference", False):
        fields |= {"again": again, "recompose": recompose}
    return forms.Task(**fields)


def call_method(method: Subject, given: forms.Task) -> forms.Synthesis:
    """Return the synthesis of a task."""
    with briefly_prepared(method.plugin, given, 0) as task:
        return cast("forms.Synthesis", method.plugin.synthesize(task))


def verify_output(method: Subject, **changes: Any) -> str:
    """Check that the output has the shape, the channels and the range of an image."""
    task = make_task(method, **changes)
    made = call_method(method, task)
    bare = dataclasses.replace(made, source=None) if isinstance(made, forms.Synthesis) else made
    height, width, channels = checked_synthesis(bare, task.sample, task.shape).image.shape
    return f"{width}x{height} px, channels: {channels}, {_numbers(made.lattice)}"


def _numbers(lattice: Lattice | None) -> str:
    return f"lattice {','.join(f'{x:.4g}' for x in lattice.numbers[:4])}" if lattice else "no lattice"


def make_image(detector: Subject, seed: int = 0, channels: int = 3, image: Image | None = None) -> Image:
    """Return the image of a wall, or a copy of another one."""
    return (draw_wall(seed, channels, OUTPUT)[0].image if image is None else image).copy()


def call_detector(detector: Subject, given: Image) -> forms.Detection | None:
    """Return the detection in an image; None if there is none."""
    try:
        return cast("forms.Detection", detector.plugin.detect(given))
    except forms.NoLatticeFound as none:
        demand(isinstance(none.reason, str) and none.reason, "raised NoLatticeFound without a reason")
        return None


def verify_detection(detector: Subject, **changes: Any) -> str:
    """Check that the detector returns a Detection or finds no lattice."""
    found: Any = call_detector(detector, make_image(detector, **changes))
    if found is None:
        return "no lattice"
    demand(isinstance(found, forms.Detection), f"returned {type(found).__name__} instead of a Detection")
    demand(isinstance(found.lattice, Lattice), f"returned the lattice {found.lattice!r}; it must be a Lattice")
    share = found.confidence
    number = isinstance(share, int | float | np.number) and not isinstance(share, bool)
    demand(number and 0 <= share <= 1, f"returned the confidence {share!r}; it must be a number in [0, 1]")
    others = isinstance(found.alternatives, tuple) and all(
        isinstance(other, forms.Alternative) for other in found.alternatives
    )
    demand(others, "alternatives must be a tuple of Alternative")
    return f"{_numbers(found.lattice)}, confidence {share:.2g}"


def make_observation(metric: Subject, seed: int = 0, channels: int = 3, known: str = "model") -> forms.Observation:
    """Return a fresh draw as an output. ``known`` is ``"model"``, ``"lattice"`` or ``"nothing"``."""
    wall, again, _ = draw_wall(seed, channels)
    sample, output = wall.image.copy(), cast("forms.Texture", again(OUTPUT, 9)).image.copy()
    if known == "nothing":
        return forms.Observation(sample, output, None)
    return forms.Observation(
        sample,
        output,
        wall if known == "model" else forms.Texture(sample, wall.lattice, wall.lattices),
        lattice_given=wall.lattice,
        seconds=0.25,
        cost={"cpu_seconds": 0.25, "peak_mib": 1.0},
        again=again if known == "model" else None,
    )


def call_metric(metric: Subject, given: forms.Observation) -> forms.Score:
    """Return the score of an observation."""
    return score_observation(given, metric.name, metric.parameters)


def verify_score(metric: Subject, **changes: Any) -> str:
    """Check that every declared column has a value in its range, or None and a reason."""
    try:
        scored = call_metric(metric, make_observation(metric, **changes))
    except (TypeError, ValueError) as error:
        raise InvalidOutput(describe_error(error)) from error
    with tempfile.TemporaryDirectory(prefix="nrbench-") as folder:
        write_score(CellFolder(Path(folder)), metric.name, scored)
    for name, value in scored.values.items():
        low, high = metric.cls.columns[name].range
        demand(value is None or low <= value <= high, f"{name} is {value}, outside its range {low} to {high}")
    known = sum(value is not None for value in scored.values.values())
    return f"{known} of {len(scored.values)} columns have a value"


def make_recipe(model: Subject, seed: int = 0, shape: forms.Shape = SAMPLE) -> Recipe:
    """Return the recipe of a draw."""
    return Recipe(model.name, plugins.parameters_of(model.plugin), seed, "check", 0, shape)


def make_draw(model: Subject, seed: int = 0) -> tuple[Recipe, forms.Texture]:
    """Return a recipe, and its texture."""
    recipe = make_recipe(model, seed)
    return recipe, recipe.render()


def call_dataset(model: Subject, given: tuple[Recipe, forms.Texture]) -> Any:
    """Return the texture, and fresh draws of it."""
    recipe, texture = given
    recompose = recipe.recompose(texture)
    return texture, recipe.again(texture)(SAMPLE, 0), recompose(SAMPLE, 0) if recompose else None


def checked_texture(model: Subject, shape: forms.Shape = SAMPLE) -> forms.Texture:
    """Return a checked texture."""
    try:
        return draw_texture(make_recipe(model, 0, shape), shape)[0]
    except BadInput as error:
        raise InvalidOutput(str(error)) from None


def verify_texture(model: Subject) -> str:
    """Check that the texture has the shape, the channels and the range."""
    texture = checked_texture(model)
    height, width, channels = texture.image.shape
    return f"{width}x{height} px, channels: {channels}, {_numbers(texture.lattice)}"


def find_example_run(report: Subject, seed: int = 0) -> Path:
    """Return the directory of the run."""
    return Path(report.run)


def call_report(report: Subject, given: Path) -> dict[str, bytes]:
    """Return the files of the report by name."""
    with tempfile.TemporaryDirectory(prefix="nrbench-") as folder:
        paths = report.plugin.write(Run(given), Path(folder))
        listed = not isinstance(paths, str) and hasattr(paths, "__iter__")
        demand(listed, f"write returned {type(paths).__name__}; return the paths of the files")
        files = {}
        for path in paths:
            demand(isinstance(path, str | Path), f"write returned {path!r}; return the paths of the files")
            demand(Path(path).is_file(), f"write returned {path}, but there is no such file")
            files[Path(path).name] = Path(path).read_bytes()
    return files


def verify_files(report: Subject) -> str:
    """Check that the report returns the paths of the files that it wrote."""
    files = report.answer()
    demand(files, "wrote no file, or did not return its path")
    return ", ".join(f"{name} ({len(content) / 1024:.1f} KiB)" for name, content in list(files.items())[:3])


# ------------------------------------------------------------------------------- clauses of plugins of all kinds


def verify_parameters(subject: Subject) -> str:
    """Check that parameters survive JSON."""
    known = plugins.parameters_of(subject.plugin)
    try:
        back = json.loads(json.dumps(known, allow_nan=False))
        again = plugins.parameters_of(plugins.build(subject.kind, subject.name, back))
    except (TypeError, ValueError) as error:
        raise InvalidOutput(f"do not survive JSON: {error}") from None
    demand(again == known, f"read back from JSON as {again}")
    return f"{len(known)} parameter{'s' * (len(known) != 1)} survive JSON"


def verify_docstring(subject: Subject) -> str:
    """Check that the docstring describes every parameter."""
    page = inspect.getdoc(subject.cls) or ""
    section = re.split(r"(?m)^Parameters\n-+\n", page, maxsplit=1)[1:]
    entries = re.split(r"(?m)^\w[\w ]*\n-+\n", section[0], maxsplit=1)[0] if section else ""
    described = set(re.findall(r"\w+", " ".join(re.findall(r"(?m)^\w+(?:, \w+)*(?= *:|$)", entries))))
    missing = [item.name for item in dataclasses.fields(subject.cls) if item.name not in described]
    demand(not missing, f"does not describe {', '.join(missing)}; add a section `Parameters` in NumPy style")
    return page.partition("\n")[0]


def verify_paper(subject: Subject) -> str:
    """Check that the paper, if there is one, is a BibTeX entry."""
    text = inspect.cleandoc(str(getattr(subject.cls, "paper", "")))
    if not text:
        raise Refused("declares no paper; if there is one, set `paper: ClassVar[str]` to its BibTeX entry")
    found = re.match(r"@\w+\s*\{\s*([^\s,{}]+)\s*,", text)
    if found is None:
        raise InvalidOutput(f"{text[:40]!r} is no BibTeX entry; begin with @article{{key,")
    demand(text.count("{") == text.count("}"), "the braces of the BibTeX entry do not match")
    return found[1]


def verify_determinism(subject: Subject) -> str:
    """Check that the same input gives the same bytes."""
    first = hash_seeded(subject)
    hash_seeded(subject, 5)
    demand(hash_seeded(subject) == first, "the same input gave another answer the second time")
    return "same input, same bytes, also after another input"


def hash_seeded(subject: Subject, seed: int = 0) -> str:
    """Return a hash of a plugin's answer, with global generators of an equal state: only other randomness counts."""
    np.random.seed(1)  # noqa: NPY002
    random.seed(1)
    return digest(subject.answer(seed))


def verify_processes(subject: Subject) -> None:
    """Check that two interpreters give the same bytes."""
    program = f"from {__name__} import print_hash; print_hash()"
    command = [sys.executable, "-c", program, subject.to_json(), str(user_path("."))]
    environment = {**os.environ, "PYTHONHASHSEED": "7"}
    found = subprocess.run(command, stdout=subprocess.PIPE, text=True, env=environment)
    same = found.stdout.split()[-1:] == [hash_seeded(subject)]
    demand(same, "another interpreter gave another answer (sets, hash() or ids of objects?)")


def print_hash() -> None:
    """Print the hash of the answer of a subject. The arguments of the process are the subject and the user's folder."""
    leave_user_folder(Path(sys.argv[2]), Path.cwd())
    print(hash_seeded(Subject.from_json(sys.argv[1])))


def verify_randomness(subject: Subject) -> None:
    """Check that all randomness comes from the generator that is passed in."""
    before = _states()
    subject.answer()
    after = _states()
    changed = " and ".join(name for name in before if before[name] != after[name])
    demand(not changed, f"draws from, or seeds, {changed}; draw from the generator that is passed in")


def _states() -> dict[str, Any]:
    """Return the states of the global generators."""
    kind, words, *rest = cast("tuple[Any, ...]", np.random.get_state())  # noqa: NPY002
    return {"np.random": (kind, words.tobytes(), *rest), "random": random.getstate()}


def verify_read_only(subject: Subject) -> None:
    """Check that the input is not changed."""
    try:
        FIXTURES[subject.kind].call(subject, freeze(FIXTURES[subject.kind].make_input(subject)))
    except ValueError as error:
        if "read-only" not in str(error):
            raise
        raise InvalidOutput(f"writes into its input: {describe_error(error)}; copy the array first") from None


def verify_gray(subject: Subject) -> str:
    """Check that images of one channel work."""
    return subject.check_answer(channels=1)


def check_cases(subject: Subject, cases: Mapping[str, Mapping[str, Any]], instead: str) -> str:
    """Check the answers to odd inputs; each is valid, or refused with a reason.

    Parameters
    ----------
    subject
        The plugin.
    cases
        The changes of each input, by its name.
    instead
        What the plugin should do instead of raising an error of another kind.
    """
    refused = 0
    for name, changes in cases.items():
        try:
            subject.check_answer(**changes)
        except Refused as refusal:
            demand(isinstance(refusal.reason, str) and refusal.reason, f"{name}: refused without a reason")
            refused += 1
        except InvalidOutput as invalid:
            raise InvalidOutput(f"{name}: {invalid}") from None
        except FAULTS as error:
            raise InvalidOutput(f"{name}: raised {describe_error(error)}; {instead} instead") from error
    return f"{len(cases)} odd inputs: {refused} refused, {len(cases) - refused} valid"


# -------------------------------------------------------------------------------------------------- synthesizers


def verify_own_lattice(method: Subject) -> str:
    """Check that without a given lattice the method finds it or refuses."""
    if not uses_lattice(method):
        raise Refused("uses no lattice")
    return method.check_answer(lattice=None)


def verify_source_map(method: Subject) -> str:
    """Check that pixels that the source map calls copies equal their sources."""
    task = make_task(method)
    made = call_method(method, task)
    if made.source is None:
        raise Refused("gives no source map")
    source = np.asarray(made.source, np.float32)
    check_source(source, quantize(np.asarray(made.image, np.float32)), task.sample)
    copied = (source[..., 2] > 1 - 1e-6) & (source[..., :2] == np.rint(source[..., :2])).all(-1)
    return f"{copied.mean():.0%} of the pixels are copies, all equal to their sources"


def verify_refusals(method: Subject) -> str:
    """Check that an input that the method cannot use is refused."""
    wall, noise = draw_wall(0)[0].image.copy(), stream("check", "noise").random((*SAMPLE, 3), np.float32)
    cases: dict[str, dict[str, Any]] = {
        "a sample of 8x8 px": {"sample": wall[:8, :8]},
        "a sample of one color": {"sample": np.full_like(wall, 0.5)},
        "a strip of 8 px": {"sample": wall[:8]},
        "an output smaller than the sample": {"shape": (24, 20)},
        "an output of one pixel": {"shape": (1, 1)},
    }
    if uses_lattice(method):
        cases["noise, and no lattice given"] = {"sample": quantize(noise), "lattice": None}
        cases["a lattice larger than the sample"] = {"lattice": Lattice((200.0, 0.0), (0.0, 150.0))}
    return check_cases(method, cases, "raise Refused")


def verify_progress(method: Subject) -> str:
    """Check that the reported fractions rise from 0 to 1."""
    seen: list[float] = []
    call_method(method, make_task(method, progress=seen.append))
    if not seen:
        raise Refused("reports no progress")
    inside = all(isinstance(x, int | float | np.number) and 0 <= x <= 1 for x in seen)
    demand(inside, f"reports {seen[:5]}; pass fractions in [0, 1]")
    demand(seen == sorted(seen), "the fraction goes back; it must not fall")
    return f"{len(seen)} reports, the last one {seen[-1]:.2g}"


# ----------------------------------------------------------------------------------------------------- detectors


def verify_no_guess(detector: Subject) -> None:
    """Check that an image of one color has no lattice."""
    found = verify_detection(detector, image=np.full((*OUTPUT, 3), 0.5, np.float32))
    demand(found == "no lattice", f"found {found} in an image of one color; raise NoLatticeFound")


def verify_odd_images(detector: Subject) -> str:
    """Check that small images and noise raise no error."""
    wall = make_image(detector)
    noise = quantize(stream("check", "noise").random(wall.shape, np.float32))
    images = {"8x8 px": wall[:8, :8], "a strip of 8 px": wall[:8], "noise": noise, "two values": np.rint(noise)}
    return check_cases(detector, {name: {"image": image} for name, image in images.items()}, "raise NoLatticeFound")


# ------------------------------------------------------------------------------------------------------- metrics


def verify_little_known(metric: Subject) -> str:
    """Check that without a model or a lattice there are values or reasons."""
    cases = {"no model, as of a photograph": "lattice", "nothing known of the texture": "nothing"}
    changes = {name: {"known": known} for name, known in cases.items()}
    return check_cases(metric, changes, "give None and a reason")


# ------------------------------------------------------------------------------------------------------ datasets


def verify_shapes(model: Subject) -> None:
    """Check that strips and odd sizes can be drawn."""
    for shape in ((8, 40), (40, 8), (101, 97)):
        drawn = checked_texture(model, shape).image.shape
        demand(max(drawn[:2]) <= max(shape), f"a texture of {shape} has shape {drawn}")


def verify_truth(model: Subject) -> str | None:
    """Check that the truth fits the image: shapes, ranges, and the lattice."""
    texture = make_recipe(model).render()
    shape, ideal, moved = texture.image.shape, texture.ideal, texture.displacement
    demand(ideal is None or ideal.shape == shape, f"ideal has another shape than the image, {shape}")
    demand(ideal is None or (ideal.min() >= 0 and ideal.max() <= 1), "ideal has values outside [0, 1]")
    fits = moved is None or moved.shape == (*shape[:2], 2)
    demand(fits, f"displacement must have the shape {(*shape[:2], 2)}")
    for name, values in texture.elements.items():
        arrays = isinstance(values, np.ndarray) and values.ndim >= 1
        demand(arrays, f"elements[{name!r}] must be an array whose first axis counts elements")
    listed = texture.lattice in texture.lattices or not (texture.lattice and texture.lattices)
    demand(listed, "lattices does not contain lattice; put it first")
    if texture.lattice is None or ideal is None:
        return None
    error = _repetition_error(np.asarray(ideal, np.float64), texture.lattice)
    demand(error < 0.5, f"the ideal image does not repeat by the lattice: {error:.2f} of its variance differs")
    return f"the ideal image repeats by the lattice ({error:.1%} of its variance differs)"


def _repetition_error(ideal: NDArray[np.float64], lattice: Lattice) -> float:
    """Return the mean squared difference to copies shifted by the vectors, over twice the variance; 0 if too small.

    The shifted copy is interpolated linearly, so edges differ a little.
    """
    from scipy import ndimage

    reduced, errors = lattice.reduced(), [0.0]
    for x, y in (reduced.t1, reduced.t2):
        moved = ndimage.shift(ideal, (-y, -x, 0), order=1, cval=np.nan)
        squares = np.square(moved - ideal)[np.isfinite(moved)]
        if squares.size >= 64 * ideal.shape[2]:
            errors.append(float(squares.mean()) * ideal.shape[2])
    return max(errors) / (2 * max(float(ideal.var((0, 1)).sum()), 1e-9))


def verify_fresh_draws(model: Subject) -> None:
    """Check that fresh draws have the requested shape, and the same lattice and origin."""
    texture = checked_texture(model)
    draws = [make_recipe(model).again(texture)(OUTPUT, k) for k in (0, 1)]
    if draws[0] is None:
        raise Refused("gives no fresh draws; the oracle refuses the texture")
    for drawn in draws:
        _check_draw(drawn, texture)
        known, lattice = texture.lattice, cast("forms.Texture", drawn).lattice
        if known is not None and texture.region is None:
            same = lattice is not None and lattice.is_equivalent(known)
            demand(same, f"a draw has another lattice: {lattice} after {known}")
            away = np.hypot(*known.wrap(np.subtract(cast("Lattice", lattice).origin, known.origin)))
            demand(away < 1e-6, f"a draw has another origin: {cast('Lattice', lattice).origin} after {known.origin}")
    recompose = make_recipe(model).recompose(texture)
    if recompose is not None:
        _check_draw(recompose(OUTPUT, 0), texture)


def _check_draw(drawn: object, texture: forms.Texture) -> None:
    if not isinstance(drawn, forms.Texture):
        raise InvalidOutput(f"returned {type(drawn).__name__} instead of a Texture")
    wanted = (*OUTPUT, texture.image.shape[2])
    demand(drawn.image.shape == wanted, f"a draw of {wanted} has the shape {drawn.image.shape}")
    demand(np.isfinite(drawn.image).all(), "a draw has NaN or infinity")


# ------------------------------------------------------------------------------------------------------- reports


def verify_no_results(report: Subject) -> None:
    """Check that a run without results can be reported."""
    with tempfile.TemporaryDirectory(prefix="nrbench-") as place:
        Path(place, "cells").mkdir()
        Path(place, "run.json").write_bytes(Path(report.run, "run.json").read_bytes())
        call_report(report, Path(place))


def verify_terminal(report: Subject) -> str:
    """Check that a report for the terminal returns text."""
    if not getattr(report.cls, "terminal", False):
        raise Refused("is not printed after a run; set `terminal: ClassVar[bool] = True` if it is to be")
    try:
        made = plugins.build("reports", report.name, {**report.parameters, "width": 80})
    except BadInput as error:
        raise InvalidOutput(f"{error}; a report for the terminal has a parameter `width`") from None
    text = made.render(Run(Path(report.run)))
    demand(isinstance(text, str), f"render returned {type(text).__name__} instead of text")
    return f"{len(text.splitlines())} lines"


# ------------------------------------------------------------------------------------------------------ the lists

FIXTURES: Mapping[str, Fixture] = {
    "synthesizers": Fixture(make_task, call_method, verify_output),
    "detectors": Fixture(make_image, call_detector, verify_detection),
    "metrics": Fixture(make_observation, call_metric, verify_score),
    "datasets": Fixture(make_draw, call_dataset, verify_texture),
    "reports": Fixture(find_example_run, call_report, verify_files),
}
"""How plugins of each kind are tried."""
Check = Callable[[Subject], str | None]
_PAGE: tuple[Check, ...] = (verify_parameters, verify_docstring, verify_paper)
_REPEATED: tuple[Check, ...] = (verify_determinism, verify_processes, verify_randomness)
_CHECKS: Mapping[str, tuple[Check, ...]] = {
    "synthesizers": (
        *(*_PAGE, verify_output, *_REPEATED, verify_read_only, verify_gray),
        *(verify_own_lattice, verify_source_map, verify_refusals, verify_progress),
    ),
    "detectors": (
        *(*_PAGE, verify_detection, *_REPEATED, verify_read_only, verify_gray),
        *(verify_no_guess, verify_odd_images),
    ),
    "metrics": (*_PAGE, verify_score, *_REPEATED, verify_read_only, verify_gray, verify_little_known),
    "datasets": (*_PAGE, verify_texture, *_REPEATED, verify_read_only, verify_shapes, verify_truth, verify_fresh_draws),
    "reports": (*(*_PAGE, verify_files, *_REPEATED, verify_no_results, verify_terminal),),
}
CHECKS: Mapping[str, Mapping[str, Check]] = {
    kind: {check.__name__.removeprefix("verify_").replace("_", " "): check for check in checks}
    for kind, checks in _CHECKS.items()
}
"""The checks of each kind by the name of their clause, in the order in which they run."""
_AFTER = {"processes": "determinism", "source map": "read only", "odd images": "no guess"}


def earlier_clause(kind: str, clause: str) -> str:
    """Return the clause that a plugin must fulfill for another one to make sense; empty if there is none.

    The clauses about the answers of a plugin depend on that of a valid answer.
    """
    valid = next(name for name, check in CHECKS[kind].items() if check is FIXTURES[kind].check_answer)
    return "" if CHECKS[kind][clause] in (*_PAGE, CHECKS[kind][valid]) else _AFTER.get(clause, valid)


def demand_of(kind: str, clause: str) -> str:
    """Return what a clause demands, in one sentence."""
    what = (CHECKS[kind][clause].__doc__ or "").partition("\n")[0].removeprefix("Check that ")
    return what[:1].upper() + what[1:]
