"""The Python functions of one texture: draw it, find its lattice, synthesize from it, score it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from nrbench import plugins
from nrbench.api.arguments import (
    LEAST_CONFIDENCE,
    Detectorlike,
    Imagelike,
    Latticelike,
    Maps,
    Masklike,
    Method,
    OutputFolder,
    Picture,
    Pluginlike,
    Shapelike,
    Textures,
    detect_among,
    detector_in,
    image_in,
    lattice_in,
    layers_in,
    list_of,
    map_in,
    masked_in,
    names_of,
    plugin_in,
    shape_in,
    stored_image,
    stored_masked,
)
from nrbench.errors import BadInput, require
from nrbench.flags import ARGUMENT, Count, Flag, Number, OptionalNumber, Switch
from nrbench.plugins.parameters import parse_spec

# The help of a command imports no array library.
if TYPE_CHECKING:
    from nrbench.displacement.defects import PictureDefect
    from nrbench.displacement.deformation_field import Deformation
    from nrbench.imaging.convert import Image
    from nrbench.imaging.wallpaper_group import FoundGroup
    from nrbench.plugins.forms import Detection, Observation, Score, Shape, Synthesis, Texture, Value
    from nrbench.suites.suite import Suite


Metrics = Annotated[Sequence[str] | str, Flag(metavar="NAME,...")]
Rendered = Annotated["str | Suite", Flag(ARGUMENT, "MODEL[:param=value,...]|SUITE")]
RenderedSize = Annotated["Shape | str | None", Flag("--sample --size", "WxH")]
Tileable = Annotated[bool | str, Flag(metavar="[x|y]", choices=("both", "x", "y"), alone="both")]
Repeats = Annotated[bool, Flag("--tileable", kind=bool)]
OtherPicture = Annotated[Imagelike | None, Flag(ARGUMENT, kind=Path)]
"""A :data:`Picture` that may be left out."""
FOLLOWS_BENT = "symmetry: the detector follows bent lattices; choose another, or straighten the image first"


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
    from nrbench.streams import stream

    plugin = plugin_in("datasets", model, parameters)
    name = plugins.name_of("datasets", type(plugin)) or type(plugin).__name__
    name = parse_spec(model)[0] if isinstance(model, str) else name
    rng = stream("render", seed, name, 0)
    drawn: Texture = plugin.render(shape_in(shape), rng)
    return drawn


def detect_lattice(
    image: Imagelike, detector: Detectorlike = None, mask: Masklike = None, **parameters: Any
) -> Detection:
    """Detect the lattice of an image.

    Parameters
    ----------
    image
        An :data:`Imagelike`.
    detector
        A detector plugin: its name, its class, or an instance. If None, ``consensus``; where it finds none, the mean
        lattice of a bent image of up to 1024 px is looked for.
    mask
        A :data:`Masklike` of the size of the image: which pixels count. Transparent pixels do not count either.
    **parameters
        The detector's parameters. ``preset="paper"`` fills in those of its paper; given ones take precedence.

    Returns
    -------
    Detection
        The lattice, its confidence, the alternatives and the diagnostics. Of a bent image, ``vertices`` says where the
        points of the lattice lie.

    Raises
    ------
    NoLatticeFound
        When the detector finds no lattice.
    BadInput
        For a bad image, mask, detector or parameter, or if pixels do not count and the detector cannot leave them out.

    Examples
    --------
    >>> from nrbench import detect_lattice, texture
    >>> brick = texture("brick", shape=(128, 128), seed=1)
    >>> found = detect_lattice(brick)
    >>> found.lattice.is_equivalent(brick.lattice, tolerance=0.5)
    True
    """
    return detect_among(detector_in(detector, parameters), masked_in(image, mask), bent=detector is None)


def detect_symmetry(
    image: Imagelike, lattice: Latticelike = None, detector: Detectorlike = None, **parameters: Any
) -> FoundGroup:
    """Find the wallpaper group of an image: its rotations, mirrors and glides.

    Parameters
    ----------
    image
        An :data:`Imagelike`.
    lattice
        The smallest lattice of the image; its origin does not matter. If None, it is detected.
    detector
        The detector that finds it. If None, ``consensus``; an image in which it finds none is straightened if it is
        bent, and the places are those in the straightened image.
    **parameters
        The detector's parameters.

    Returns
    -------
    FoundGroup
        The group, or why it cannot be told, and the isometries that were tested, with their agreement.

    Raises
    ------
    NoLatticeFound
        If the detector finds no lattice.
    BadInput
        For a bad image, lattice, detector or parameter, or if the detector follows a bent lattice.

    Examples
    --------
    >>> brick = texture("brick", shape=(160, 160), seed=1)
    >>> detect_symmetry(brick, brick.lattice).group
    'cmm'
    """
    from nrbench.displacement.bent_detection import recognize
    from nrbench.imaging.wallpaper_group import find_wallpaper_group

    image = image_in(image)
    if (known := lattice_in(image, lattice)) is None:
        found = detector_in(detector, parameters)
        detection, bent = recognize(image, found) if detector is None else (found.detect(image), None)
        require(bent is not None or not detection.vertices, FOLLOWS_BENT)
        image, known = (image, detection.lattice) if bent is None else bent.deformation.straighten()
    return find_wallpaper_group(image, known)


def track_lattice(
    image: Imagelike, lattice: Latticelike = None, detector: Detectorlike = None, **parameters: Any
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
        The detector that finds the lattice and confirms it on the straightened image; if None, ``consensus``.
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
    from nrbench.displacement.bent_detection import find_deformation

    image, known = image_in(image), lattice_in(image, lattice)
    return find_deformation(image, known, detector_in(detector, parameters)).deformation


def find_defects(image: Imagelike, lattice: Latticelike = None) -> tuple[PictureDefect, ...]:
    """Find where a picture leaves its own lattice and look; an empty tuple says that nothing stands out.

    Drifts of the lattice are followed, and a picture in which it is found only where it is straightened is straightened
    first; the places are those in the picture itself.

    Parameters
    ----------
    image
        An :data:`Imagelike`.
    lattice
        Its lattice, or the detector that finds it, for a picture that is not bent; None: the default detector, if its
        confidence is at least 0.5.

    Returns
    -------
    tuple
        The defects, the worst one first: place, kind, and size in s or in standard deviations from cell to cell.

    Raises
    ------
    NoLatticeFound
        If no lattice is found, or the picture shows fewer than twelve whole cells.
    BadInput
        For a bad image, lattice or detector.

    Examples
    --------
    >>> from nrbench import find_defects, texture
    >>> wall = texture("brick", shape=(160, 160), seed=1, color=0.1)
    >>> len(find_defects(wall, wall.lattice))
    0
    >>> wall.image[70:80, 80:90] = 0
    >>> len(find_defects(wall, wall.lattice))
    1
    """
    from nrbench.displacement.bent_detection import recognize
    from nrbench.displacement.defects import find_straight_defects
    from nrbench.plugins.forms import NoLatticeFound

    picture = image_in(image)
    given = lattice_in(picture, lattice)
    if given is not None:
        return find_straight_defects(picture, given)
    found, followed = recognize(picture, detector_in(None, {}))
    if found.confidence < LEAST_CONFIDENCE:
        raise NoLatticeFound(f"one of the confidence {found.confidence:.2f}, too low to call anything a defect")
    if followed is None:
        return find_straight_defects(picture, found.lattice)
    known = followed.deformation
    return find_straight_defects(*known.straighten(), lambda points: known.locate(points + known.corner))


def synthesize(
    method: Method,
    image: Picture,
    shape: Shapelike,
    lattice: Latticelike = None,
    seed: Number = 0,
    progress: Callable[[float], None] | None = None,
    tileable: Tileable = False,
    mask: Masklike = None,
    maps: Maps = (),
    keep_alpha: Switch = False,
    flatten_light: Switch = False,
    **parameters: Any,
) -> Synthesis:
    """Synthesize a larger texture from a sample.

    Parameters
    ----------
    method
        The method.

        A synthesizer plugin: its name, e.g. ``"rsgf"`` or ``"rsgf:preset=paper"``, its class, or an instance.
    image
        The sample, an :data:`Imagelike`. Methods that find a lattice get the middle of a sample larger than 1024 px, as
        large as 16 periods or the output. The output has 8 or 16 bits a channel, as the sample; arrays of floats that
        are not exactly those of 8 bits have 16.
    shape
        Size of the output.

        (height, width) in px, or ``"WIDTHxHEIGHT"``.
    lattice
        The lattice of the sample, or the detector that finds it.  [default: the method finds it]
    seed
        Equal seeds give equal outputs.
    progress
        Called with the fraction that is done, in [0, 1].
    tileable
        Make an output that repeats without a seam, if the method can: along both axes, or along x or y only.

        True, ``"both"``, ``"x"`` or ``"y"``. Its opposite edges continue each other. The sample is strained so that its
        lattice closes, by at most 2.5 %; the note says by how much.
    mask
        A picture of the size of the sample, in which white counts, and black is left out.

        Or an array, True where a pixel counts. Transparent pixels do not count. The output holds nothing of the others.
    maps
        Another map of the sample, of its size, such as normals, heights or roughness; it gets the layout of the output.

        A list of arrays, of bool, whole numbers or floats of any range, or of the paths of pictures, whose values are
        taken as they are stored. ``maps`` of the result holds them; see also :meth:`Synthesis.apply`.
    keep_alpha
        Give the output the alpha channel of the sample, in the layout of the color.

        For pictures with holes, such as fences. Else transparent pixels do not count.
    flatten_light
        Divide uneven light out of the sample first: shadows, dark corners, slopes.

        ``extras["flattened"]`` is the sample in even light, from which the output is made, and to which ``source``
        points. Without it, a warning names light that varies much. It needs a lattice.
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
        For a bad image, mask, lattice, method or parameter, or if the method cannot make tileable outputs, or cannot
        leave out pixels, or lay out maps; the message names those that can. Also if light is to be divided out of a
        sample without a lattice.

    Examples
    --------
    >>> from nrbench import synthesize, texture
    >>> brick = texture("brick", shape=(96, 96))
    >>> synthesize("quilting:block=24", brick, "160x128", seed=1).image.shape
    (128, 160, 3)
    """
    plugin = plugin_in("synthesizers", method, parameters)
    along = ("both" if tileable else "") if isinstance(tileable, bool) else str(tileable)
    make = partial(_make_output, plugin, shape_in(shape), lattice, seed, progress, along, flatten_light)
    if keep_alpha:
        require(mask is None and not flatten_light, "--keep-alpha: works neither with --mask nor with --flatten-light")
        return _make_transparent(make, image, list_of(maps))
    return make(image, mask, list_of(maps))


def _make_transparent(make: Callable[..., Synthesis], image: Imagelike, maps: Maps) -> Synthesis:
    """Return a synthesis with the alpha channel of an image; ``make`` gets it over a flat color."""
    from nrbench.calling.sample_maps import flatten_alpha, restore_alpha
    from nrbench.imaging.convert import depth_of

    layers = layers_in(image)
    flat, hidden = flatten_alpha(layers)
    return restore_alpha(make(flat, None, [*hidden, *maps]), depth_of(layers), float(layers[..., -1].mean()))


def _make_output(
    plugin: Any,
    shape: Shape,
    lattice: Latticelike,
    seed: int,
    progress: Callable[[float], None] | None,
    along: str,
    flatten: bool,
    image: Imagelike,
    mask: Masklike,
    maps: Maps,
) -> Synthesis:
    """Return the checked synthesis, along the axes of an output that repeats, in even light if wanted."""
    import numpy as np

    from nrbench.calling.bent_samples import synthesize_in_geometry
    from nrbench.calling.lighting import flatten_light, warn_of_light
    from nrbench.calling.method_calls import briefly_prepared, synthesize_from_part
    from nrbench.calling.sample_maps import synthesize_with_maps
    from nrbench.calling.tileable import AXES, synthesize_tileable
    from nrbench.imaging.convert import match_ndim
    from nrbench.imaging.masks import MaskedImage
    from nrbench.plugins.forms import Refused, Task
    from nrbench.streams import pixels_hash, stream

    sample, known = stored_masked(image, mask)
    wanted = {"wraps": bool(along), "masks": known is not None, "maps": len(maps) > 0}
    plugins.require_abilities("synthesizers", plugin, **wanted)
    joint = wanted["maps"] and getattr(plugin, "maps", "") == "joint"
    require(not (along and joint), "--tileable with other maps: needs a method with a source map, such as tile-set")
    rng = stream("synthesis", seed, pixels_hash(sample), 0)
    given = lattice_in(MaskedImage(sample, known), lattice)
    task = Task(sample, shape, given, rng, progress or (lambda fraction: None), known=known)
    others = [map_in(each) for each in maps]
    require(along in ("", *AXES), f"tileable {along!r}: give True, or one of {', '.join(AXES)}")
    if float(np.ptp(sample, axis=(0, 1)).max()) == 0:
        where = "the sample" if known is None else "what the mask leaves of the sample"
        raise Refused(f"{where} is constant; there is nothing to synthesize from")
    make = partial(synthesize_tileable, along=along) if along else synthesize_in_geometry
    task, lit = flatten_light(plugin, task) if flatten else (task, "")
    with briefly_prepared(plugin, task, seed) as ready:
        made = synthesize_with_maps(partial(synthesize_from_part, make), plugin, ready, others)
    if flatten:
        note = "; ".join(filter(None, (made.note, lit)))
        made = dataclasses.replace(made, note=note, extras={**made.extras, "flattened": task.sample})
    elif made.lattice is not None:
        warn_of_light(sample, made.lattice, known)
    return dataclasses.replace(made, image=match_ndim(made.image, image if hasattr(image, "ndim") else sample))


def fill(
    image: Imagelike,
    mask: Masklike = None,
    method: Pluginlike | None = None,
    lattice: Latticelike = None,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
    **parameters: Any,
) -> Synthesis:
    """Fill the holes of a picture, on its own lattice and in its phase. All other pixels stay as they are.

    Parameters
    ----------
    image
        An :data:`Imagelike`. Its transparent pixels are holes.
    mask
        A :data:`Masklike` of the size of the image: white is kept, black is filled. None: the transparent pixels are.
    method
        A synthesizer plugin that can fill holes; if None, the first that can: ``rsgf``.
    lattice
        The lattice of the image; if None, the method finds it in the pixels that are kept. Where it is bent, it is
        followed. Without a lattice, patches come from anywhere.
    seed, progress
        As for :func:`synthesize`.
    **parameters
        The method's parameters.

    Returns
    -------
    Synthesis
        The image has the shape of the given one, no alpha, and 8 or 16 bits as it.

    Raises
    ------
    Refused
        If the kept pixels show nothing that equals a pixel of a hole.
    BadInput
        For a bad image, mask, lattice, method or parameter, if there is no hole, or if the method cannot fill holes;
        the message names those that can.

    Examples
    --------
    >>> import numpy as np
    >>> from nrbench import fill, texture
    >>> brick, kept = texture("brick", shape=(96, 96)), np.ones((96, 96), bool)
    >>> kept[30:60, 20:70] = False
    >>> filled = fill(brick, kept, lattice=brick.lattice).image
    >>> filled.shape, bool(np.abs(filled - brick.image)[kept].max() < 1 / 255)
    ((96, 96, 3), True)
    """
    from nrbench.calling.filling import fill_picture
    from nrbench.calling.method_calls import checked_synthesis
    from nrbench.imaging.convert import match_ndim
    from nrbench.imaging.masks import MaskedImage
    from nrbench.plugins.forms import Task
    from nrbench.streams import pixels_hash, stream

    if method is None:
        method = next(one.cls for one in plugins.inventory("synthesizers") if getattr(one.cls, "fills", False))
    plugin = plugin_in("synthesizers", method, parameters)
    plugins.require_abilities("synthesizers", plugin, fills=True)
    sample, known = stored_masked(image, mask)
    require(known is not None, "there is no hole to fill: make its pixels transparent, or black in the mask")
    rng, given = stream("synthesis", seed, pixels_hash(sample), 0), lattice_in(MaskedImage(sample, known), lattice)
    task = Task(sample, sample.shape[:2], given, rng, progress or (lambda fraction: None), known=known)
    filled = checked_synthesis(fill_picture(plugin, task), sample, task.shape)
    return dataclasses.replace(filled, image=match_ndim(filled.image, image if hasattr(image, "ndim") else sample))


@dataclass(frozen=True)
class Scores:
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
    >>> scores = score(brick, brick, metrics="appearance")
    >>> sorted(scores.values) == sorted(scores.values.keys() | scores.reasons.keys())
    True
    """

    values: Mapping[str, Value]
    reasons: Mapping[str, str]
    pictures: Mapping[str, Image]


MOST_SCORED = 4096 * 4096
"""Pixels of the largest output that :func:`score` takes. It needs about 2 GiB."""


def score(
    sample: Picture,
    output: OtherPicture = None,
    lattice: Latticelike = None,
    metrics: Metrics = (),
    progress: Callable[[int, int, str], None] | None = None,
    mask: Masklike = None,
    tileable: Repeats = False,
) -> Scores:
    """Score any tool's output against its sample, or whether one picture repeats.

    Parameters
    ----------
    sample, output
        The two images, each an :data:`Imagelike`, both gray or both in color; a gray one may be stored in color.
    lattice
        The lattice of the sample, or the detector that finds it.  [default: scores that need one use the detector
        dominance]

        If None, it is that of the sample if this is a texture with a known lattice. Where none is known and the
        detector finds none, the scores that need one are None, with the reason.
    metrics
        Compute these metrics, and print all their scores.

        Their names, as a list or joined by commas; empty for all.
    progress
        Called after each metric with the number of metrics done, of all, and the name of the last one.
    mask
        A picture of the size of the sample, in which white counts, and black is left out.

        Or an array, True where a pixel counts. Transparent pixels of the sample do not count either.
    tileable
        Judge whether one picture, SAMPLE, repeats without a seam along x and y.

        The values are those of ``tileable``, see :func:`score_edges`; no metric is computed.

    Returns
    -------
    Scores
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
    from nrbench.imaging.convert import match_channels
    from nrbench.imaging.masks import MaskedImage
    from nrbench.plugins.forms import Observation, Texture

    require(tileable == (output is None), "score: pass a sample and an output, or tileable and one picture")
    if tileable:
        require(not names_of(metrics), "score: tileable computes no metrics; leave them out")
        require(mask is None, "score: tileable judges all pixels of a picture; leave the mask out")
        return score_edges(sample, lattice)
    image, known = stored_masked(sample, mask, "sample")
    pair = image, stored_image(output, "output")
    pair = match_channels(*pair), match_channels(*pair[::-1])
    height, width, _ = pair[1].shape
    if height * width > MOST_SCORED:
        raise BadInput(f"output: {width}x{height} px; at most {MOST_SCORED} px in all are scored: crop it")
    if pair[0].shape[2] != pair[1].shape[2]:
        raise BadInput(f"output: has {pair[1].shape[2]} channels, the sample {pair[0].shape[2]}; convert one of them")
    given = lattice_in(MaskedImage(pair[0], known), lattice)
    if given is None and isinstance(sample, Texture):
        given = sample.lattice
    truth = Texture(pair[0], given, (given,) if given else ())
    seen = Observation(*pair, truth=truth, lattice_given=given, known=known)
    return score_observation_by(seen, names_of(metrics), progress)


def score_edges(picture: Picture, lattice: Latticelike = None) -> Scores:
    """Judge whether a picture repeats along x and y, across its edges.

    Parameters
    ----------
    picture
        An :data:`Imagelike`.
    lattice
        Its lattice, or the detector that finds it; None: the default detector, if its confidence is at least 0.5.

    Returns
    -------
    Scores
        For each axis, here x: ``tileable.x.repeats``; ``tileable.x.score`` in [0, 1], at least 0.5 if it repeats;
        ``tileable.x.worst``, the pixel along the edge with the largest step; and ``tileable.x.lattice``, ``step``,
        ``place``, ``color``, ``sharpness`` and ``detail``, departures over what is allowed, see
        :class:`~nrbench.imaging.wrapped_edges.WrappedEdge`. The picture ``tileable.seam`` is rolled by half, with the
        seam drawn where it breaks.
    """
    from nrbench.imaging.wrapped_edges import FLOORS, SHORTEST, measure_edges
    from nrbench.pictures.overlays import draw_seams
    from nrbench.plugins.forms import NoLatticeFound

    image = stored_image(picture, "picture")
    require(image[..., 0].size <= MOST_SCORED, f"picture: at most {MOST_SCORED} px in all are scored: crop it")
    found = lattice_in(image, lattice)
    if found is None:
        try:
            detection = detect_lattice(image)
            found = detection.lattice if detection.confidence >= LEAST_CONFIDENCE else None
            silent = f"the lattice has the confidence {detection.confidence:.2f}"
        except NoLatticeFound as none:
            silent = f"no lattice: {none.reason}"
    edges = dict(zip("xy", measure_edges(image, found), strict=True))
    values: dict[str, Value] = {}
    reasons: dict[str, str] = {}
    if found:
        silent = "the picture shows too few cells along the axis"
    for axis, edge in edges.items():
        own: dict[str, Value] = dict.fromkeys(("repeats", "score", "worst", *FLOORS))
        if edge.ratios:
            own |= {"repeats": edge.ratio <= 1, "score": edge.score, "worst": int(edge.profile.argmax())}
            own |= edge.ratios
        why = silent if edge.ratios else f"cannot tell: the side is shorter than {SHORTEST} px"
        values |= {f"tileable.{axis}.{name}": value for name, value in own.items()}
        reasons |= {f"tileable.{axis}.{name}": why for name, value in own.items() if value is None}
    seams = [edge.profile if edge.ratio > 1 else None for edge in edges.values()]
    return Scores(values, reasons, {"tileable.seam": draw_seams(image, *seams)})


def score_observation_by(
    observation: Observation,
    metrics: Sequence[str] = (),
    progress: Callable[[int, int, str], None] | None = None,
) -> Scores:
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
    return Scores(
        {f"{metric}.{column}": value for metric, score in scores.items() for column, value in score.values.items()},
        {f"{metric}.{column}": why for metric, score in scores.items() for column, why in score.reasons.items()},
        {f"{metric}.{title}": image for metric, score in scores.items() for title, image in score.pictures.items()},
    )


def _score_or_failure(observation: Observation, metric: str) -> Score:
    from nrbench.plugins.forms import Score
    from nrbench.running.phases import failure_reason, score_observation

    try:
        return score_observation(observation, metric)
    except Exception as error:
        return Score.missing(plugins.build("metrics", metric).columns, failure_reason(error))


def render_textures(
    what: Rendered,
    directory: OutputFolder,
    textures: Textures = (),
    *,
    sample: RenderedSize = None,
    seed: OptionalNumber = None,
    replicates: Count = None,
) -> list[Path]:
    """Draw the textures of a model or a suite as PNG files, with their truth and a contact sheet.

    Parameters
    ----------
    what
        A model, ``name`` or ``name:param=value,...``; a suite, its name or a TOML file.
    directory
        Directory of the pictures.
    textures
        Draw only these textures of a suite; repeatable.

        Shell patterns of names, or a single one.
    sample
        Size of the pictures.

        (height, width) in px, or ``"WIDTHxHEIGHT"``; if None, that of the suite.
    seed
        Seed.
    replicates
        Number of draws of each texture.

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
    from nrbench.api.picture_folders import model_suite, write_textures
    from nrbench.api.runs import changed
    from nrbench.suites.plan import draw_samples
    from nrbench.suites.suite import builtin, load_suite

    if isinstance(what, str):
        what = load_suite(what) if what in builtin() or Path(what).exists() else model_suite(what)
    suite = changed(what, sample=sample, seed=seed, replicates=replicates)
    return write_textures(draw_samples(suite, list_of(textures)), Path(directory))
