"""The Python API: one function for each verb of the command line."""

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
from nrbench.imaging.convert import Image, as_image, match_channels, match_ndim, quantize
from nrbench.lattice.geometry import Lattice, Vector, require_visible
from nrbench.plugins.forms import Detection, Observation, Refused, Score, Shape, Synthesis, Task, Texture, Value
from nrbench.running.guard import Limits
from nrbench.running.guarded import LIMITS, plan_run
from nrbench.running.phases import checked_synthesis, failure_reason, score_observation
from nrbench.running.progress import Progress
from nrbench.running.runner import Options, execute, working_metrics
from nrbench.runs.records import Run
from nrbench.streams import pixels_hash, stream
from nrbench.suites.suite import DEFAULT, LARGEST_SIDE, Suite, load_suite
from nrbench.tracking.deformation import Deformation
from nrbench.views.deformed import Followed, find_deformation

Latticelike = Lattice | tuple[Vector, Vector] | tuple[Vector, Vector, Vector] | str | None
"""A lattice; its two vectors, and its origin; ``"x1,y1,x2,y2"`` or ``"x1,y1,x2,y2,x,y"``. None: no lattice is given."""


def texture(model: str, shape: Shape = (128, 128), seed: int = 0, **parameters: Any) -> Texture:
    """Draw a texture of a model. The returned texture holds the image, the true lattice and the true departures.

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
        For an unknown model or parameter, or a value that is not valid.

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
    """Detect the lattice of an image.

    Parameters
    ----------
    image
        uint8, uint16 or float in [0, 1], with or without a channel axis.
    detector
        Name of a detector plugin.
    parameters
        The detector's parameters. ``preset="paper"`` fills in those of its paper; given ones take precedence.

    Raises
    ------
    NoLatticeFound
        When the detector finds no lattice.
    BadInput
        For a bad image, detector or parameter.
    """
    detection: Detection = plugins.build("detectors", detector, parameters).detect(as_image(image))
    return detection


def track_lattice(
    image: Any, lattice: Latticelike = None, detector: str = "consensus", **parameters: Any
) -> Deformation:
    """Find the lattice of an image that may be bent: rows that bow, periods that shrink, a plane in perspective.

    The result holds the mean lattice, the displacement of each point from it, their amplitude, whether the image is
    bent at all, and the homography if the deformation is one. ``straighten()`` undoes the deformation.

    Parameters
    ----------
    image
        uint8, uint16 or float in [0, 1], with or without a channel axis.
    lattice
        The lattice, about as it is on average or somewhere in the image; its origin does not matter. If None, it is
        detected, in the whole image and in overlapping views.
    detector
        Name of the detector that finds the lattice and confirms it on the straightened image.
    parameters
        The detector's parameters.

    Raises
    ------
    NoLatticeFound
        If no lattice is found that can be followed through the image.
    BadInput
        For a bad image, lattice, detector or parameter, or if the image holds fewer than two cells of the lattice.

    Examples
    --------
    >>> bent = track_lattice(texture("weave", shape=(128, 128), seed=1, bend=0.5).image)
    >>> bent.bent, bent.homography is None
    (True, True)
    >>> straight, mean = bent.straighten()
    """
    return follow_lattice(as_image(image), as_lattice(lattice), detector, parameters).deformation


def follow_lattice(
    image: Image,
    lattice: Lattice | None = None,
    detector: str = "consensus",
    parameters: Mapping[str, Any] | None = None,
    only_promising: bool = False,
) -> Followed:
    """Return the deformation of an image as :func:`track_lattice`, with the detection in the straightened image.

    Parameters
    ----------
    image, lattice, only_promising
        As for :func:`nrbench.views.deformed.find_deformation`.
    detector, parameters
        The detector's name and its parameters.
    """
    thorough = plugins.build("detectors", detector, parameters or {})
    quick = plugins.build("detectors", "dominance", {"reject": "none"})
    return find_deformation(image, thorough, quick, lattice, only_promising)


def as_lattice(lattice: Latticelike) -> Lattice | None:
    """Return a lattice from any of the forms of :data:`Latticelike`.

    Raises
    ------
    BadInput
        If it has none of these forms, or repeats in less than 2 px.
    """
    if lattice is None:
        return None
    if isinstance(lattice, str):
        return Lattice.parse(lattice)
    try:
        made = lattice if isinstance(lattice, Lattice) else Lattice(*lattice)
    except TypeError:
        raise BadInput(
            f"lattice {lattice!r}: give two vectors, e.g. ((32, 0), (0, 24)), or three with the origin"
        ) from None
    return require_visible(made, lattice)


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
        The sample's lattice; if None, the method finds it.
    seed
        Equal seeds give equal pixels.
    progress
        Called with the fraction that is done, in [0, 1].
    parameters
        The method's parameters. ``preset="paper"`` fills in those of its paper; given ones take precedence.

    Returns
    -------
    Synthesis
        The image has the channel layout of the sample.

    Raises
    ------
    Refused
        When the method cannot be applied to the sample.
    BadInput
        For a bad image, lattice, method or parameter.
    """
    sample = quantize(as_image(image))
    plugin = plugins.build("synthesizers", method, parameters)
    rng = stream("synthesis", seed, pixels_hash(sample), 0)
    task = Task(sample, _checked_shape(shape), as_lattice(lattice), rng, progress or (lambda fraction: None))
    if float(np.ptp(sample, axis=(0, 1)).max()) == 0:
        raise Refused("the sample is constant; there is nothing to synthesize from")
    synthesis = checked_synthesis(plugin.synthesize(task), sample, task.shape)
    return dataclasses.replace(synthesis, image=match_ndim(synthesis.image, image))


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
        The two images, both gray or both in color; a gray one may be stored in color.
    lattice
        The sample's lattice. If None, metrics that need a lattice use the one that the detector ``dominance`` finds in
        the sample; if it finds none, their scores are None, with the reason.
    """
    pair = quantize(as_image(sample, "sample")), quantize(as_image(output, "output"))
    pair = match_channels(*pair), match_channels(*pair[::-1])
    if pair[0].shape[2] != pair[1].shape[2]:
        raise BadInput(f"output: has {pair[1].shape[2]} channels, the sample {pair[0].shape[2]}; convert one of them")
    given = as_lattice(lattice)
    truth = Texture(pair[0], given, (given,) if given else ())
    return score_by_all_metrics(Observation(*pair, truth=truth, lattice_given=given))


def score_by_all_metrics(observation: Observation) -> Sheet:
    """Score an observation by every metric; the scores of one that raises are None, with the error as the reason."""
    scores = {metric: _score_or_failure(observation, metric) for metric in working_metrics()}
    return Sheet(
        {f"{metric}.{column}": value for metric, score in scores.items() for column, value in score.values.items()},
        {f"{metric}.{column}": why for metric, score in scores.items() for column, why in score.reasons.items()},
        {f"{metric}.{title}": image for metric, score in scores.items() for title, image in score.pictures.items()},
    )


def _score_or_failure(observation: Observation, metric: str) -> Score:
    try:
        return score_observation(observation, metric)
    except Exception as error:
        columns = plugins.build("metrics", metric).columns
        return Score(dict.fromkeys(columns), dict.fromkeys(columns, failure_reason(error)))


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
    """Run a suite and return the run; cells that have results on disk are not run again.

    Parameters
    ----------
    suite
        A suite, its name, a TOML file, or a directory of pictures.
    methods, textures, lattice
        They replace those of the suite. Methods are ``name:param=value``, textures shell patterns of names.
    out
        The run directory; ``runs/SUITE`` if None.
    progress
        Called after each cell with a :class:`~nrbench.running.progress.Step`.
    options
        How to run: jobs, limits, and so on. An interrupt (Ctrl-C) stops at once. ``options.stop.set()``, called in
        ``progress`` or in another thread, lets the running cells end first. Both raise KeyboardInterrupt.
    changes
        Other keys of the suite: ``seed``, ``replicates``, ``sample``, ``size``.
    """
    chosen = suite if isinstance(suite, Suite) else load_suite(Path(suite) if not isinstance(suite, str) else suite)
    limits = Limits(options.timeout, options.memory) if options else LIMITS
    plan = plan_run(changed(chosen, methods, lattice, **changes), textures, limits)
    root = Path(out) if out is not None else Path("runs") / chosen.name
    return execute(plan, root, options, progress or (lambda step: None))


def changed(suite: Suite, methods: Sequence[str] = (), lattice: Sequence[str] = (), **changes: Any) -> Suite:
    """Return a suite with the options of a command line applied; a size replaces that of every texture."""
    given = {key: value for key, value in changes.items() if value is not None}
    if methods:
        given["methods"] = list(methods)
    if lattice:
        given["lattice"] = list(lattice)
    own = {key: None for key in ("sample", "size") if key in given}
    if own:
        given["texture"] = [{**row.model_dump(mode="json"), **own} for row in suite.texture]
    return suite.with_changes(**given) if given else suite
