"""The Python API, in the command line's words."""

from __future__ import annotations

import dataclasses
import operator
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.imaging.convert import Image, as_image, like_input, quantize
from nrbench.lattice.geometry import Lattice, Vector
from nrbench.plugins.forms import Detection, Observation, Refused, Score, Shape, Synthesis, Task, Texture, Value
from nrbench.running.outputs import checked_synthesis
from nrbench.running.runner import Options, Progress, execute, working_metrics
from nrbench.running.scoring import failure, scored
from nrbench.runs.records import Run
from nrbench.streams import pixels_hash, stream
from nrbench.suites.plan import make_plan
from nrbench.suites.suite import DEFAULT, LARGEST_SIDE, Suite, load_suite

Latticelike = Lattice | tuple[Vector, Vector] | str | None
"""A lattice, its two vectors, or ``"x1,y1,x2,y2"``; None where none is given."""


def texture(model: str, shape: Shape = (128, 128), seed: int = 0, **parameters: Any) -> Texture:
    """Draw a texture of a model, with its truth.

    Parameters
    ----------
    model
        Name of a dataset plugin, e.g. ``"brick"``.
    shape
        (height, width) in px.
    seed
        Equal seeds give equal pixels.
    parameters
        The model's parameters.

    Raises
    ------
    BadInput
        For a model, a parameter or a shape that is not known or not valid.

    Examples
    --------
    >>> brick = texture("brick", shape=(64, 96), seed=3, color=0.3)
    >>> brick.image.shape
    (64, 96, 3)
    """
    rng = stream("render", seed, model, 0)
    drawn: Texture = plugins.build("datasets", model, parameters).render(_checked_shape(shape), rng)
    return drawn


def detect_lattice(image: Any, detector: str = "consensus", **parameters: Any) -> Detection:
    """Return the lattice that a detector finds in an image.

    Raises
    ------
    NoLatticeFound
        Where there is none.
    """
    found: Detection = plugins.build("detectors", detector, parameters).detect(as_image(image))
    return found


def as_lattice(lattice: Latticelike) -> Lattice | None:
    """Return a lattice from any form that users write it in."""
    if lattice is None or isinstance(lattice, Lattice):
        return lattice
    return Lattice.parse(lattice) if isinstance(lattice, str) else Lattice(*lattice)


def synthesize(
    method: str,
    image: Any,
    shape: Shape,
    lattice: Latticelike = None,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
    **parameters: Any,
) -> Synthesis:
    """Synthesize a larger texture from a sample.

    Parameters
    ----------
    method
        Name of a synthesizer plugin, e.g. ``"rsgf"``.
    image
        The sample: uint8, uint16 or float in [0, 1], with or without a channel axis.
    shape
        (height, width) of the output in px.
    lattice
        The sample's lattice; None: the method finds it.
    seed
        Equal seeds give equal pixels.
    progress
        Called with the fraction done.
    parameters
        The method's parameters.

    Returns
    -------
    Synthesis
        Its image has the sample's channel layout.

    Raises
    ------
    Refused
        Where the sample lies outside the method's domain.
    BadInput
        For a bad image, lattice, method or parameter.
    """
    sample = quantize(as_image(image))
    plugin = plugins.build("synthesizers", method, parameters)
    rng = stream("synthesis", seed, pixels_hash(sample), 0)
    task = Task(sample, _checked_shape(shape), as_lattice(lattice), rng, progress or (lambda fraction: None))
    if float(np.ptp(sample, axis=(0, 1)).max()) == 0:
        raise Refused("the sample is constant; there is nothing to synthesize from")
    made = checked_synthesis(plugin.synthesize(task), sample, task.shape)
    return dataclasses.replace(made, image=like_input(made.image, image))


def _checked_shape(shape: Shape) -> Shape:
    try:
        height, width = map(operator.index, shape)
    except (TypeError, ValueError):
        raise BadInput(f"shape {shape!r}: give (height, width) in px, two whole numbers") from None
    if min(height, width) < 1 or max(height, width) > LARGEST_SIDE:
        raise BadInput(f"shape {shape}: give (height, width) in px, each at least 1 and at most {LARGEST_SIDE}")
    return height, width


@dataclass(frozen=True)
class Sheet:
    """The scores of one output.

    Parameters
    ----------
    values
        By ``metric.column``.
    reasons
        Why a value is None, by ``metric.column``.
    pictures
        By ``metric.name``.
    """

    values: Mapping[str, Value]
    reasons: Mapping[str, str]
    pictures: Mapping[str, Image]


def score(sample: Any, output: Any, lattice: Latticelike = None) -> Sheet:
    """Score any tool's output against its sample.

    Parameters
    ----------
    sample, output
        The two images, same number of channels.
    lattice
        The sample's lattice; without it the detector ``dominance`` is asked for it, and where that finds none the
        scores that need one are None, with the reason.
    """
    pair = quantize(as_image(sample, "sample")), quantize(as_image(output, "output"))
    if pair[0].shape[2] != pair[1].shape[2]:
        raise BadInput(f"output: has {pair[1].shape[2]} channels, the sample {pair[0].shape[2]}; convert one of them")
    given = as_lattice(lattice)
    truth = Texture(pair[0], given, (given,) if given else ())
    return judge(Observation(*pair, truth=truth, lattice_given=given))


def judge(observation: Observation) -> Sheet:
    """Score an observation by every metric; one that raises is None in all columns, with the error as the reason."""
    values: dict[str, Value] = {}
    reasons: dict[str, str] = {}
    pictures: dict[str, Image] = {}
    for name in working_metrics():
        found = _guarded(observation, name)
        values.update({f"{name}.{column}": value for column, value in found.values.items()})
        reasons.update({f"{name}.{column}": why for column, why in found.reasons.items()})
        pictures.update({f"{name}.{title}": picture for title, picture in found.pictures.items()})
    return Sheet(values, reasons, pictures)


def _guarded(observation: Observation, name: str) -> Score:
    try:
        return scored(observation, name)
    except Exception as error:
        columns = plugins.build("metrics", name).columns
        return Score(dict.fromkeys(columns), dict.fromkeys(columns, failure(error)))


def run(
    suite: str | os.PathLike[str] | Suite = DEFAULT,
    *,
    methods: Sequence[str] = (),
    textures: Sequence[str] = (),
    lattice: Sequence[str] = (),
    out: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
    options: Options | None = None,
    **changes: Any,
) -> Run:
    """Run a suite, resuming what is there, and return the run.

    Parameters
    ----------
    suite
        A suite, its name, a TOML file, or a directory of pictures.
    methods, textures, lattice
        Instead of the suite's: methods as ``name:param=value``, shell patterns of texture names, lattice sources.
    out
        The run directory; ``runs/SUITE`` where it is not given.
    progress
        Called after each cell.
    options
        Jobs, limits, and the like.
    changes
        Other keys of the suite: ``seed``, ``replicates``, ``sample``, ``size``.
    """
    chosen = suite if isinstance(suite, Suite) else load_suite(Path(suite) if not isinstance(suite, str) else suite)
    plan = make_plan(changed(chosen, methods, lattice, **changes), textures)
    root = Path(out) if out is not None else Path("runs") / chosen.name
    return execute(plan, root, options, progress or (lambda done, total, what: None))


def changed(suite: Suite, methods: Sequence[str] = (), lattice: Sequence[str] = (), **changes: Any) -> Suite:
    """Return a suite with the options of a command applied; a size given there replaces every texture's own."""
    given = {key: value for key, value in changes.items() if value is not None}
    if methods:
        given["methods"] = list(methods)
    if lattice:
        given["lattice"] = list(lattice)
    own = {key: None for key in ("sample", "size") if key in given}
    if own:
        given["texture"] = [{**row.model_dump(mode="json"), **own} for row in suite.texture]
    return suite.with_changes(**given) if given else suite
