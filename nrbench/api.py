"""The Python API: one function for each verb of the command line."""

from __future__ import annotations

import dataclasses
import operator
import os
import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.imaging.convert import Image, as_image, match_channels, match_ndim, quantize
from nrbench.lattice.geometry import Lattice, Vector, require_visible
from nrbench.plugins.forms import Detection, Observation, Refused, Score, Shape, Synthesis, Task, Texture, Value
from nrbench.plugins.parameters import LARGEST_SIDE, nearest, parse_size, parse_spec, validated
from nrbench.storage import read_json
from nrbench.streams import pixels_hash, stream

# Runs, suites and their executors are imported by the functions that use them: one picture needs none of them.
if TYPE_CHECKING:
    from nrbench.running.guard import Limits
    from nrbench.running.pace import Progress
    from nrbench.running.runner import Options
    from nrbench.runs.records import Run
    from nrbench.suites.plan import Plan
    from nrbench.suites.suite import Suite
    from nrbench.tracking.bent_lattice import Deformation
    from nrbench.views.deformed import Followed

Imagelike = Any
"""An image: an array of uint8, uint16 or float in [0, 1], with or without a channel axis; the path of a picture; or a
:class:`~nrbench.plugins.forms.Texture` or :class:`~nrbench.plugins.forms.Synthesis`, whose image is taken."""
Pluginlike = str | type[Any] | Any
"""A plugin: its name; ``name:param=value,...`` as on the command line; its class; or an instance, whose parameters are
then those of the instance."""
Latticelike = Lattice | tuple[Vector, Vector] | tuple[Vector, Vector, Vector] | str | None
"""A lattice; its two vectors, and its origin; ``"x1,y1,x2,y2"`` or ``"x1,y1,x2,y2,x,y"``; or the detector that finds
it, e.g. ``"consensus"``. None: no lattice is given."""
Shapelike = Shape | str
"""(height, width) in px, or ``"WIDTHxHEIGHT"`` as on the command line."""


def texture(model: Pluginlike, shape: Shapelike = (128, 128), seed: int = 0, **parameters: Any) -> Texture:
    """Draw a texture of a model. The returned texture holds the image, the true lattice and the true departures.

    Parameters
    ----------
    model
        A dataset plugin: its name, e.g. ``"brick"``, its class, or an instance.
    shape
        (height, width) in px, or ``"WIDTHxHEIGHT"``.
    seed
        Equal seeds give equal pixels.
    **parameters
        The model's parameters.

    Returns
    -------
    Texture
        The image with its truth.

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
    plugin = _plugin("datasets", model, parameters)
    name = (
        parse_spec(model)[0]
        if isinstance(model, str)
        else plugins.name_of("datasets", type(plugin)) or type(plugin).__name__
    )
    rng = stream("render", seed, name, 0)
    drawn: Texture = plugin.render(_checked_shape(shape), rng)
    return drawn


def detect_lattice(image: Imagelike, detector: Pluginlike = "consensus", **parameters: Any) -> Detection:
    """Detect the lattice of an image.

    Parameters
    ----------
    image
        An :data:`Imagelike`.
    detector
        A detector plugin: its name, its class, or an instance.
    **parameters
        The detector's parameters. ``preset="paper"`` fills in those of its paper; given ones take precedence.

    Returns
    -------
    Detection
        The lattice, its confidence, the alternatives and the diagnostics.

    Raises
    ------
    NoLatticeFound
        When the detector finds no lattice.
    BadInput
        For a bad image, detector or parameter.

    Examples
    --------
    >>> from nrbench import detect_lattice, texture
    >>> brick = texture("brick", shape=(128, 128), seed=1)
    >>> found = detect_lattice(brick)
    >>> found.lattice.is_equivalent(brick.lattice, tolerance=0.5)
    True
    """
    detection: Detection = _plugin("detectors", detector, parameters).detect(_image(image))
    return detection


def track_lattice(
    image: Imagelike, lattice: Latticelike = None, detector: Pluginlike = "consensus", **parameters: Any
) -> Deformation:
    """Find the lattice of an image that may be bent: rows that bow, periods that shrink, a plane in perspective.

    The result holds the mean lattice, the displacement of each point from it, their amplitude, whether the image is
    bent at all, and the homography if the deformation is one. ``straighten()`` undoes the deformation.

    Parameters
    ----------
    image
        An :data:`Imagelike`.
    lattice
        The lattice, about as it is on average or somewhere in the image; its origin does not matter. If None, it is
        detected, in the whole image and in overlapping views.
    detector
        The detector that finds the lattice and confirms it on the straightened image.
    **parameters
        The detector's parameters.

    Returns
    -------
    Deformation
        The lattice, followed through the image.

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
    return follow_bent_lattice(_image(image), lattice_in(image, lattice), detector, parameters).deformation


def follow_bent_lattice(
    image: Image,
    lattice: Lattice | None = None,
    detector: Pluginlike = "consensus",
    parameters: Mapping[str, Any] | None = None,
    only_promising: bool = False,
) -> Followed:
    """Return the deformation of an image as :func:`track_lattice`, with the detection in the straightened image.

    Parameters
    ----------
    image, lattice, only_promising
        As for :func:`nrbench.views.deformed.find_deformation`.
    detector, parameters
        As for :func:`track_lattice`.
    """
    from nrbench.views.deformed import find_deformation

    thorough = _plugin("detectors", detector, parameters or {})
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


def lattice_in(image: Imagelike, lattice: Latticelike) -> Lattice | None:
    """Return a lattice as :func:`as_lattice`, or find it in the image if a detector is named.

    Raises
    ------
    BadInput
        If it is neither.
    NoLatticeFound
        If the detector finds none.
    """
    if not isinstance(lattice, str) or "," in lattice.partition(":")[0]:
        return as_lattice(lattice)
    known = plugins.names("detectors")
    if (name := parse_spec(lattice)[0]) not in known:
        raise BadInput(f"lattice {lattice!r}: give x1,y1,x2,y2 in px, or a detector{nearest(name, known)}")
    return detect_lattice(image, lattice).lattice


def synthesize(
    method: Pluginlike,
    image: Imagelike,
    shape: Shapelike,
    lattice: Latticelike = None,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
    tileable: bool = False,
    **parameters: Any,
) -> Synthesis:
    """Synthesize a larger texture from a sample.

    Parameters
    ----------
    method
        A synthesizer plugin: its name, e.g. ``"rsgf"`` or ``"rsgf:preset=paper"``, its class, or an instance.
    image
        The sample, an :data:`Imagelike`. Methods that find a lattice get the middle of a sample larger than 1024 px, as
        large as 16 periods or the output.
    shape
        (height, width) of the output in px, or ``"WIDTHxHEIGHT"``.
    lattice
        The sample's lattice, or the detector that finds it; if None, the method finds it.
    seed
        Equal seeds give equal pixels.
    progress
        Called with the fraction that is done, in [0, 1].
    tileable
        Make an output whose opposite edges continue each other. The sample is strained so that its lattice closes, by
        at most 2.5 %; the note says by how much.
    **parameters
        The method's parameters. ``preset="paper"`` fills in those of its paper; given ones take precedence.

    Returns
    -------
    Synthesis
        The image has the channel layout of the sample: two axes if the sample is an array of two.

    Raises
    ------
    Refused
        When the method cannot be applied to the sample, or if a tileable output would need a larger strain.
    BadInput
        For a bad image, lattice, method or parameter, or if the method cannot make tileable outputs.

    Examples
    --------
    >>> from nrbench import synthesize, texture
    >>> brick = texture("brick", shape=(96, 96))
    >>> synthesize("quilting:block=24", brick, "160x128", seed=1).image.shape
    (128, 160, 3)
    """
    from nrbench.bending.needed_part import synthesize_from_part
    from nrbench.bending.straightening import synthesize_in_geometry
    from nrbench.bending.tileable import require_wrapping, synthesize_tileable
    from nrbench.running.output_checks import checked_synthesis
    from nrbench.running.preparing import briefly_prepared

    plugin = _plugin("synthesizers", method, parameters)
    if tileable:
        require_wrapping(type(plugin))
    sample = quantize(_image(image))
    rng = stream("synthesis", seed, pixels_hash(sample), 0)
    task = Task(sample, _checked_shape(shape), lattice_in(sample, lattice), rng, progress or (lambda fraction: None))
    if float(np.ptp(sample, axis=(0, 1)).max()) == 0:
        raise Refused("the sample is constant; there is nothing to synthesize from")
    make = synthesize_tileable if tileable else synthesize_in_geometry
    with briefly_prepared(plugin, task, seed) as ready:
        synthesis = checked_synthesis(synthesize_from_part(make, plugin, ready), sample, task.shape)
    given = image if hasattr(image, "ndim") else sample
    return dataclasses.replace(synthesis, image=match_ndim(synthesis.image, given))


def _image(image: Imagelike, where: str = "image") -> Image:
    """Return an :data:`Imagelike` as an image."""
    if isinstance(image, str | os.PathLike):
        from nrbench.imaging.files import read_image

        return read_image(Path(image))
    if isinstance(image, Texture | Synthesis):
        image = image.image
    elif not isinstance(image, np.ndarray) and np.ndim(image) < 2:
        found = type(image).__name__
        raise BadInput(f"{where}: is of type {found}; pass an array, the path of a picture, or a Texture")
    return as_image(image, where)


def picture_file(image: Imagelike, folder: Path) -> Path:
    """Return the file of an :data:`Imagelike`, which is written into a folder if it is no file yet."""
    from nrbench.imaging.files import write_image

    if isinstance(image, str | os.PathLike):
        return Path(image)
    write_image(folder / "picture.png", _image(image))
    return folder / "picture.png"


def _plugin(kind: str, plugin: Pluginlike, parameters: Mapping[str, Any]) -> Any:
    """Return the instance of a :data:`Pluginlike`; raise BadInput if it is no plugin of the kind."""
    if isinstance(plugin, str):
        name, written = parse_spec(plugin)
        return plugins.build(kind, name, {**written, **parameters})
    form = plugins.FORMS[kind]
    is_class = isinstance(plugin, type)
    fault = plugins.fault(kind, plugin if is_class else type(plugin))
    if fault:
        raise BadInput(f"{fault}. Pass the name of a {form.noun}, its class, or an instance")
    if is_class:
        return validated(plugin, parameters, f"{form.noun} {plugin.__name__}")
    if parameters:
        names = ", ".join(parameters)
        raise BadInput(f"{form.noun} {type(plugin).__name__}: is an instance already; set {names} when you make it")
    return plugin


def _checked_shape(shape: Shapelike) -> Shape:
    if isinstance(shape, str):
        return parse_size(shape)
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

    Examples
    --------
    >>> from nrbench import score, texture
    >>> brick = texture("brick", shape=(96, 96))
    >>> sheet = score(brick, brick, metrics="appearance")
    >>> sorted(sheet.values) == sorted(sheet.values.keys() | sheet.reasons.keys())
    True
    """

    values: Mapping[str, Value]
    reasons: Mapping[str, str]
    pictures: Mapping[str, Image]


MOST_SCORED = 2 * 2048 * 2048
"""Pixels of the largest output that :func:`score` takes. It needs about 5 GiB."""


def score(
    sample: Imagelike,
    output: Imagelike,
    lattice: Latticelike = None,
    metrics: Sequence[str] | str = (),
    progress: Callable[[int, int, str], None] | None = None,
) -> Sheet:
    """Score any tool's output against its sample.

    Parameters
    ----------
    sample, output
        The two images, each an :data:`Imagelike`, both gray or both in color; a gray one may be stored in color.
    lattice
        The sample's lattice. If None, it is that of the sample if this is a texture with a known lattice. If none is
        known, metrics that need one use the lattice that the detector ``dominance`` finds in the sample; if it finds
        none, their scores are None, with the reason.
    metrics
        Names of the metrics, as a list or joined by commas; empty for all.
    progress
        Called after each metric with the number of metrics done, of all, and the name of the last one.

    Returns
    -------
    Sheet
        The scores, and why some have no value.

    Raises
    ------
    BadInput
        For a bad image or lattice, an unknown metric, an output of more than :data:`MOST_SCORED` pixels, or if one
        image is gray and the other one in color.

    Examples
    --------
    >>> from nrbench import score, synthesize, texture
    >>> brick = texture("brick", shape=(96, 96))
    >>> tiled = synthesize("tiling", brick, (128, 128), lattice=brick.lattice)
    >>> score(brick, tiled, metrics="regularity").values["regularity.preserved"]
    True
    """
    pair = quantize(_image(sample, "sample")), quantize(_image(output, "output"))
    pair = match_channels(*pair), match_channels(*pair[::-1])
    height, width, _ = pair[1].shape
    if height * width > MOST_SCORED:
        raise BadInput(f"output: {width}x{height} px; at most {MOST_SCORED} px in all are scored: crop it")
    if pair[0].shape[2] != pair[1].shape[2]:
        raise BadInput(f"output: has {pair[1].shape[2]} channels, the sample {pair[0].shape[2]}; convert one of them")
    given = lattice_in(pair[0], lattice)
    if given is None and isinstance(sample, Texture):
        given = sample.lattice
    truth = Texture(pair[0], given, (given,) if given else ())
    names = metrics.split(",") if isinstance(metrics, str) else metrics
    return score_observation_by(Observation(*pair, truth=truth, lattice_given=given), names, progress)


def score_observation_by(
    observation: Observation,
    metrics: Sequence[str] = (),
    progress: Callable[[int, int, str], None] | None = None,
) -> Sheet:
    """Score an observation by some metrics, or by all if none are named.

    The scores of a metric that raises an error are None, with the error as the reason.

    Raises
    ------
    BadInput
        For an unknown metric.
    """
    from nrbench.running.runner import find_metrics

    names = find_metrics(metrics)
    scores = {}
    for number, metric in enumerate(names, 1):
        scores[metric] = _score_or_failure(observation, metric)
        if progress:
            progress(number, len(names), metric)
    return Sheet(
        {f"{metric}.{column}": value for metric, score in scores.items() for column, value in score.values.items()},
        {f"{metric}.{column}": why for metric, score in scores.items() for column, why in score.reasons.items()},
        {f"{metric}.{title}": image for metric, score in scores.items() for title, image in score.pictures.items()},
    )


def _score_or_failure(observation: Observation, metric: str) -> Score:
    from nrbench.running.phases import failure_reason, score_observation

    try:
        return score_observation(observation, metric)
    except Exception as error:
        columns = plugins.build("metrics", metric).columns
        return Score(dict.fromkeys(columns), dict.fromkeys(columns, failure_reason(error)))


def _texts(given: Any) -> list[Any]:
    """Return a sequence as a list; a text or a single plugin counts as one entry."""
    return list(given) if isinstance(given, Sequence) and not isinstance(given, str) else [given]


def run(
    suite: str | os.PathLike[str] | Suite = "default",
    *,
    methods: Sequence[Pluginlike] | Pluginlike = (),
    textures: Sequence[str] | str = (),
    lattice: Sequence[Latticelike] | str = (),
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
        They replace those of the suite. Methods are ``name:param=value``, or registered classes or instances of them;
        textures are shell patterns of names; lattices are entries of the lattice axis, or a :data:`Latticelike`. A
        single one needs no list.
    out
        The run directory. If None, ``runs/SUITE``, and ``runs/SUITE-fresh`` for a fresh seed.
    progress
        Called after each cell with a :class:`~nrbench.running.pace.Step`.
    options
        How to run: jobs, limits, and so on. An interrupt (Ctrl-C) stops at once. ``options.stop.set()``, called in
        ``progress`` or in another thread, lets the running cells end first. Both raise KeyboardInterrupt.
    **changes
        Other keys of the suite: ``seed``, ``replicates``, ``sample``, ``size``. The seed ``"fresh"`` is drawn from the
        system; ``run.info["suite"]["seed"]`` tells it.

    Returns
    -------
    Run
        The run, as :func:`load` returns it.

    Raises
    ------
    BadInput
        For an unknown suite, method, texture or lattice, or a class that is not registered: cells run in other
        processes, which find plugins by their names.

    Examples
    --------
    >>> import tempfile
    >>> from nrbench import Options, run
    >>> folder = tempfile.mkdtemp()
    >>> done = run(
    ...     "core",
    ...     methods="scatter",
    ...     textures="brick-mild",
    ...     size="64x64",
    ...     out=folder,
    ...     options=Options(jobs=0),
    ...     metrics=["cost"],
    ... )
    >>> done.cells[0].status
    'ok'
    """
    from nrbench.running.guard import Limits
    from nrbench.running.runner import execute

    limits = Limits(options.timeout, options.memory) if options else None
    plan, root = plan_cells(suite, methods, textures, lattice, out, limits=limits, **changes)
    return execute(plan, root, options, progress or (lambda step: None))


def plan_cells(
    suite: str | os.PathLike[str] | Suite,
    methods: Sequence[Pluginlike] | Pluginlike = (),
    textures: Sequence[str] | str = (),
    lattice: Sequence[Latticelike] | str = (),
    out: str | os.PathLike[str] | None = None,
    *,
    limits: Limits | None = None,
    progress: Callable[[float], None] = lambda done: None,
    seed: int | str | None = None,
    **changes: Any,
) -> tuple[Plan, Path]:
    """Return the plan of a run, and its directory.

    Parameters
    ----------
    suite, methods, textures, lattice, out, seed, **changes
        As for :func:`run`.
    limits
        The limits of the drawing of one texture.
    progress
        Called with the share of the samples that are drawn, in [0, 1].

    Raises
    ------
    BadInput
        As for :func:`run`.
    """
    from nrbench.running.guard import LIMITS
    from nrbench.running.runner import plan_run

    chosen = _suite(suite)
    specs = [_spec(method) for method in _texts(methods)]
    sources = [_source(each) for each in ([lattice] if isinstance(lattice, Lattice) else _texts(lattice))]
    root = run_directory(out, chosen, seed)
    changes |= choose_seed(seed, root)
    return plan_run(changed(chosen, specs, sources, **changes), _texts(textures), limits or LIMITS, progress), root


def _suite(suite: str | os.PathLike[str] | Suite) -> Suite:
    """Return a suite, or load it by its name or from its file or directory."""
    from nrbench.suites.suite import Suite, load_suite

    return suite if isinstance(suite, Suite) else load_suite(suite if isinstance(suite, str) else Path(suite))


def audit(
    method: Pluginlike,
    suite: str | os.PathLike[str] | Suite = "default",
    *,
    textures: Sequence[str] | str = (),
    replicates: int | None = None,
    out: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
    options: Options | None = None,
) -> Any:
    """Compare the quality of a method at the published seed of a suite with its quality at a fresh one.

    A method that knows the published samples loses its quality where it has not seen the samples. The test changes the
    sign of the difference of each texture: for any other method both draws of a texture are alike.

    Parameters
    ----------
    method
        ``name:param=value``, or a registered class or an instance of it.
    suite
        A suite of texture models, its name, or a TOML file.
    textures
        As for :func:`run`.
    replicates
        Number of draws of each texture at each seed. More draws find smaller differences.
    out
        Directory of the two runs ``published`` and ``fresh``; ``runs/audit-METHOD`` if None. If it holds an audit,
        that audit is resumed with its fresh seed.
    progress, options
        As for :func:`run`.

    Returns
    -------
    nrbench.reports.changes.RunChanges
        The changes from the published to the fresh run, one for each source of the lattice.

    Raises
    ------
    BadInput
        As for :func:`run`, and if the suite holds photographs, which no seed draws again.

    Examples
    --------
    ``audit("rsgf").changes[0].state`` is ``"worse"`` if the method is worse at the fresh seed, ``"noise"`` if its
    quality moved by no more than other draws move it, and ``"unknown"`` if fewer than six textures were run.
    """
    chosen = _suite(suite)
    for row in chosen.texture:
        if not getattr(plugins.find("datasets", row.dataset).cls, "procedural", True):
            raise BadInput(f"texture {row.name}: is a picture, which no seed draws again; audit a suite of models")
    spec = _spec(method)
    folder = Path(out) if out is not None else Path("runs") / f"audit-{parse_spec(spec)[0]}"
    runs = [
        run(
            chosen,
            methods=spec,
            metrics=["quality"],
            textures=textures,
            out=folder / name,
            progress=progress,
            options=options,
            replicates=replicates,
            **seed,
        )
        for name, seed in (("published", {}), ("fresh", {"seed": "fresh"}))
    ]
    return compare(runs[0], runs[1], "quality.score")


def load(path: str | os.PathLike[str]) -> Run:
    """Return a run that is on disk.

    Parameters
    ----------
    path
        The run directory.

    Returns
    -------
    Run
        Its cells, tables and plot.

    Raises
    ------
    BadInput
        If the directory is no run.

    Examples
    --------
    >>> import tempfile
    >>> from nrbench import Options, load, run
    >>> folder = tempfile.mkdtemp()
    >>> _ = run(
    ...     "core",
    ...     methods="scatter",
    ...     textures="brick-mild",
    ...     size="64x64",
    ...     out=folder,
    ...     options=Options(jobs=0),
    ...     metrics=["cost"],
    ... )
    >>> load(folder).cells[0].status
    'ok'
    """
    from nrbench.runs.records import Run

    found = Run(Path(path))
    _ = found.info
    return found


def as_run(run: Run | str | os.PathLike[str]) -> Run:
    """Return a run, or that of a directory as :func:`load`."""
    return load(run) if isinstance(run, str | os.PathLike) else run


def compare(
    first: Run | str | os.PathLike[str], second: Run | str | os.PathLike[str], columns: str | Sequence[str] = ()
) -> Any:
    """Compare a run with an earlier one: which scores moved, and whether by more than draws move them.

    Parameters
    ----------
    first, second
        The earlier and the later run, or their directories.
    columns
        The scores, as a list or joined by commas; empty for the headlines, the share of preserved lattices and the
        seconds.

    Returns
    -------
    nrbench.reports.changes.RunChanges
        The changes. ``table()`` is a table with one row for each method and score, which a notebook shows; ``worse``
        lists those for the worse, ``notes`` says what the table does not.

    Raises
    ------
    BadInput
        If a directory is no run, or neither run has a score that was named.

    Examples
    --------
    >>> import tempfile
    >>> from nrbench import Options, compare, run
    >>> folder = tempfile.mkdtemp()
    >>> done = run(
    ...     "core",
    ...     methods="scatter",
    ...     textures="brick-mild",
    ...     size="64x64",
    ...     out=folder,
    ...     options=Options(jobs=0),
    ...     metrics=["cost"],
    ... )
    >>> set(compare(folder, done).table()["state"])
    {'same'}
    """
    runs = [as_run(first), as_run(second)]
    names = columns.split(",") if isinstance(columns, str) else columns
    return plugins.build("reports", "changes", {"baseline": runs[0].root, "columns": tuple(names)}).compare(runs[1])


def render_textures(
    what: str | Suite, directory: str | os.PathLike[str], textures: Sequence[str] | str = (), **changes: Any
) -> list[Path]:
    """Draw the textures of a model or a suite as PNG files, with their truth and a contact sheet.

    Parameters
    ----------
    what
        A model, ``name`` or ``name:param=value,...``; a suite, its name or a TOML file.
    directory
        The directory of the pictures.
    textures
        Shell patterns of names; empty for all.
    **changes
        Keys of the suite: ``seed``, ``replicates``, ``sample``.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    BadInput
        For an unknown model, suite or texture.

    Examples
    --------
    >>> import tempfile
    >>> from nrbench import render_textures
    >>> files = render_textures("brick:color=0.3", tempfile.mkdtemp(), sample="64x64")
    >>> sorted({path.suffix for path in files})
    ['.csv', '.json', '.png']
    """
    from nrbench.suites.plan import draw_samples
    from nrbench.suites.rendering import model_suite, write_textures
    from nrbench.suites.suite import builtin, load_suite

    if isinstance(what, str):
        what = load_suite(what) if what in builtin() or Path(what).exists() else model_suite(what)
    return write_textures(draw_samples(changed(what, **changes), _texts(textures)), Path(directory))


def _spec(method: Pluginlike) -> str:
    """Return a method as ``name:param=value``; raise BadInput for a class that is not registered."""
    if isinstance(method, str):
        return method
    instance = None if isinstance(method, type) else method
    cls = method if isinstance(method, type) else type(method)
    name = plugins.name_of("synthesizers", cls)
    if not name:
        raise BadInput(
            f"method {cls.__name__}: is not registered; put it into a file and call nrbench.plugins.add_file(file), "
            f"or pass it to nrbench.synthesize"
        )
    given = plugins.parameters_of(instance) if instance is not None else {}
    texts = [f"{key}={','.join(map(str, v)) if isinstance(v, list) else v}" for key, v in given.items()]
    return f"{name}:{','.join(texts)}" if texts else name


def _source(lattice: Latticelike) -> str:
    """Return an entry of the lattice axis as text."""
    if isinstance(lattice, str):
        return lattice
    given = as_lattice(lattice)
    if given is None:
        raise BadInput("lattice None: leave it out, or give 'own', 'given', a detector or a lattice")
    return ",".join(repr(float(number)) for number in given.numbers)


def choose_seed(seed: int | str | None, root: Path) -> dict[str, Any]:
    """Return the changes of a suite that give it a seed: a number, or ``"fresh"`` for one that the system draws.

    A run directory that holds a run of a fresh seed keeps this seed, so that the same command resumes the run.

    Raises
    ------
    BadInput
        For another word.
    """
    if seed is None:
        return {}
    if seed != "fresh":
        try:
            return {"seed": operator.index(seed), "fresh_seed": False}  # type: ignore[arg-type]
        except TypeError:
            raise BadInput(f"seed {seed!r}: give a whole number from 0 on, or 'fresh'") from None
    from nrbench.runs.store import RUN_FILE

    content = ((read_json(root / RUN_FILE) or {}).get("suite") or {}).get("content") or {}
    drawn = content["seed"] if content.get("fresh_seed") is True else secrets.randbelow(10**12)
    return {"seed": drawn, "fresh_seed": True}


def run_directory(out: str | os.PathLike[str] | None, suite: Suite, seed: int | str | None) -> Path:
    """Return the directory of a run: ``out``, or ``runs/SUITE``, or ``runs/SUITE-fresh`` for a fresh seed."""
    return Path(out) if out is not None else Path("runs") / (suite.name + ("-fresh" if seed == "fresh" else ""))


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
