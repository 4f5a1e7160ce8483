"""What users pass to the Python functions and on the command line: images, lattices, plugins, sizes, in any form.

A parameter whose type is one of the aliases with a :class:`~nrbench.flags.Flag` is also an argument or an option of the
command line, which is built from signatures and docstrings, see :mod:`nrbench.cli.verbs`.
"""

from __future__ import annotations

import operator
import os
from collections.abc import Collection, Mapping, Sequence
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from nrbench import plugins
from nrbench.errors import BadInput, require
from nrbench.flags import ARGUMENT, Flag
from nrbench.plugins.parameters import LARGEST_SIDE, nearest, parse_size, parse_spec, take_label, validated

# The help of a command imports no array library.
if TYPE_CHECKING:
    from nrbench.imaging.convert import Image
    from nrbench.imaging.masks import MaskedImage
    from nrbench.lattice.geometry import Lattice, Vector
    from nrbench.plugins.forms import Detection, Shape
    from nrbench.runs.records import Run
    from nrbench.suites.suite import Suite

METHOD = "METHOD[:param=value,...]"
LATTICE = "x1,y1,x2,y2[,x,y]"


Pluginlike = str | type[Any] | Any
"""A plugin: its name; ``name:param=value,...`` as on the command line; its class; or an instance, whose parameters are
then those of the instance."""
Imagelike = Any
"""An image: an array of uint8, uint16 or float in [0, 1], with or without a channel axis; the path of a picture; or a
:class:`~nrbench.plugins.forms.Texture` or :class:`~nrbench.plugins.forms.Synthesis`, whose image is taken."""
Latticelike = Annotated[
    "Lattice | tuple[Vector, Vector] | tuple[Vector, Vector, Vector] | Sequence[float] | str | None",
    Flag(metavar=f"{LATTICE}|DETECTOR"),
]
"""A lattice; its two vectors, and its origin; four or six numbers, also as text ``"x1,y1,x2,y2"`` or
``"x1,y1,x2,y2,x,y"``; or the detector that finds it, e.g. ``"consensus"``. None: no lattice is given."""
Shapelike = Annotated["Shape | str", Flag("--size", "WxH")]
"""(height, width) in px, or ``"WIDTHxHEIGHT"`` as on the command line."""
Runlike = Annotated["Run | str | os.PathLike[str]", Flag(ARGUMENT, kind=Path)]
"""A run, or its directory."""
Suitelike = Annotated["str | os.PathLike[str] | Suite", Flag(ARGUMENT)]
"""A suite, its name, a TOML file, or a directory of pictures."""
Masklike = Annotated[Any, Flag("--mask", "FILE", kind=Path)]
"""Which pixels of an image count: an array, bool or in [0, 1], or the path of a picture; white counts, and black is
left out. None: all count that are not transparent."""
Maps = Annotated[Sequence[Any], Flag("--with", "MAP", kind=Path, many=True)]
"""Other maps of a sample: arrays, or paths of pictures."""
LEAST_CONFIDENCE = 0.5
"""A lattice of a lower confidence is more probably wrong than right."""
Picture = Annotated[Imagelike, Flag(ARGUMENT, kind=Path)]
"""An :data:`Imagelike`; on the command line the path of a picture."""
OutputFolder = Annotated["str | os.PathLike[str]", Flag("-o --output", "DIR", kind=Path)]

Detectorlike = Pluginlike | None
"""A :data:`Pluginlike`; None: the detector of nrbench that finds a lattice where none is named, ``consensus``."""
Method = Annotated[Pluginlike, Flag("-m", METHOD)]
Methods = Annotated[Sequence[Pluginlike] | Pluginlike, Flag("-m", METHOD, many=True)]
Textures = Annotated[Sequence[str] | str, Flag("-t", "GLOB", many=True)]
LatticeSources = Annotated[
    "Sequence[Latticelike] | Latticelike", Flag(metavar=f"given|own|DETECTOR|{LATTICE}", many=True)
]
SampleSize = Annotated["str | Shape | None", Flag(metavar="WxH")]
SuiteSeed = Annotated["int | str | None", Flag(metavar="NUMBER|fresh")]
Folder = Annotated["str | os.PathLike[str] | None", Flag(kind=Path)]


def as_lattice(lattice: Latticelike) -> Lattice | None:
    """Return a lattice from any of the forms of :data:`Latticelike`.

    Raises
    ------
    BadInput
        If it has none of these forms, or repeats in less than 2 px.
    """
    import numpy as np

    from nrbench.lattice.geometry import Lattice, require_visible

    if lattice is None:
        return None
    if isinstance(lattice, Lattice):
        return require_visible(lattice, lattice)
    text = lattice
    if not isinstance(text, str):
        try:
            numbers = np.array(lattice, np.float64)
        except (TypeError, ValueError):
            numbers = np.empty(0)
        if numbers.shape not in ((4,), (6,), (2, 2), (3, 2)):
            raise BadInput(
                f"lattice {lattice!r}: give two vectors, e.g. ((32, 0), (0, 24)), or three with the origin; or four or "
                "six numbers, e.g. (32, 0, 0, 24)"
            )
        text = ",".join(map(str, numbers.ravel().tolist()))
    made = Lattice.parse(text)
    return made.with_known_origin() if text.count(",") == 5 else made


def lattice_in(image: Imagelike, lattice: Latticelike) -> Lattice | None:
    """Return a lattice as :func:`as_lattice`, or find it in the image, which may be bent, if a detector is named.

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
    return detect_among(plugin_in("detectors", lattice, {}), masked_in(image), bent=True).lattice


def detect_among(detector: Any, image: MaskedImage, bent: bool) -> Detection:
    """Return the lattice that a detector finds in the pixels that count, or that of a bent image where it finds none.

    Raises
    ------
    BadInput
        If it cannot leave out the others; the message names the detectors that can.
    NoLatticeFound
        If it finds none.
    """
    from nrbench.plugins.forms import detect_known

    plugins.require_abilities("detectors", detector, masks=image.known is not None)
    if not bent:
        return detect_known(detector, *image)
    from nrbench.displacement.bent_detection import recognize

    return recognize(image.image, detector, image.known)[0]


def image_in(image: Imagelike, where: str = "image") -> Image:
    """Return an :data:`Imagelike` as an image; raise BadInput if it has transparent pixels."""
    from nrbench.imaging.convert import as_image
    from nrbench.pictures.files import read_image

    if isinstance(image, str | os.PathLike):
        return read_image(Path(image))
    return as_image(_pixels_of(image, where), where)


def masked_in(image: Imagelike, mask: Masklike = None, where: str = "image") -> MaskedImage:
    """Return an :data:`Imagelike` with the pixels that count: those that are opaque, and white in the mask.

    Raises
    ------
    BadInput
        For a bad image or mask, or if no pixel counts.
    """
    from nrbench.imaging.masks import MaskedImage, as_mask, as_masked
    from nrbench.pictures.files import read_mask, read_masked

    if isinstance(image, MaskedImage):
        found = image
    elif isinstance(image, str | os.PathLike):
        found = read_masked(Path(image))
    else:
        found = as_masked(_pixels_of(image, where), where)
    if mask is None:
        return found
    shape = found.image.shape[:2]
    if isinstance(mask, str | os.PathLike):
        return found.without(~read_mask(Path(mask), shape), f"mask {mask}")
    return found.without(~as_mask(mask, shape), "mask")


def _pixels_of(image: Imagelike, where: str) -> Any:
    """Return the array of an :data:`Imagelike` that is no path."""
    import numpy as np

    from nrbench.plugins.forms import Synthesis, Texture

    if isinstance(image, Texture | Synthesis):
        return image.image
    if not isinstance(image, np.ndarray) and np.ndim(image) < 2:
        found = type(image).__name__
        raise BadInput(f"{where}: is of type {found}; pass an array, the path of a picture, or a Texture")
    return image


def layers_in(image: Imagelike) -> Image:
    """Return an :data:`Imagelike` with its alpha channel as the last of 2 or 4 channels; raise BadInput without one."""
    from nrbench.imaging.convert import as_layers
    from nrbench.pictures.files import read_layers

    return read_layers(Path(image)) if isinstance(image, str | os.PathLike) else as_layers(_pixels_of(image, "image"))


def map_in(image: Any) -> Any:
    """Return the values of another map of a sample: an array as it is, those of a picture file as they are stored."""
    import numpy as np

    from nrbench.pictures.files import read_map

    if isinstance(image, str | os.PathLike):
        return read_map(Path(image))[0]
    pixels = np.asarray(_pixels_of(image, "map"))
    require(pixels.dtype.kind in "buif", f"map: dtype {pixels.dtype}; pass truth values, whole numbers or floats")
    return pixels


def stored_image(image: Imagelike, where: str = "image") -> Image:
    """Return an :data:`Imagelike` as its file would hold it: with 8 bits if that is exact, or if it is a texture.

    Others have 16 bits.
    """
    return _as_stored(image_in(image, where), image)


def stored_masked(image: Imagelike, mask: Masklike = None, where: str = "image") -> MaskedImage:
    """Return an :data:`Imagelike` as :func:`stored_image` does, with the pixels that count."""
    found = masked_in(image, mask, where)
    return found._replace(image=_as_stored(found.image, image))


def _as_stored(pixels: Image, image: Imagelike) -> Image:
    from nrbench.imaging.convert import depth_of, quantize
    from nrbench.plugins.forms import Texture

    return quantize(pixels, depth_of(pixels, 8 if isinstance(image, Texture) else 16))


def picture_file(image: Imagelike, folder: Path, name: str = "picture.png") -> Path:
    """Return the file of an :data:`Imagelike`, which is written into a folder if it is no file yet."""
    from nrbench.pictures.files import write_image

    if isinstance(image, str | os.PathLike):
        return Path(image)
    return write_image(folder / name, stored_image(image))


def detector_in(detector: Detectorlike, parameters: Mapping[str, Any]) -> Any:
    """Return the instance of a detector; raise BadInput if it is none."""
    return plugin_in("detectors", plugins.in_role("detector") if detector is None else detector, parameters)


def plugin_in(kind: str, plugin: Pluginlike, parameters: Mapping[str, Any]) -> Any:
    """Return the instance of a :data:`Pluginlike`; raise BadInput if it is no plugin of the kind."""
    if isinstance(plugin, str):
        name, written = parse_spec(plugin)
        if kind == "synthesizers":
            take_label(written)  # a name in tables, of which a single call has none
        return plugins.build(kind, name, {**written, **parameters})
    form = plugins.FORMS[kind]
    is_class = isinstance(plugin, type)
    fault = plugins.fault(kind, plugin if is_class else type(plugin))
    require(not fault, f"{fault}. Pass the name of a {form.noun}, its class, or an instance")
    if is_class:
        return validated(plugin, parameters, f"{form.noun} {plugin.__name__}")
    if parameters:
        names = ", ".join(parameters)
        raise BadInput(f"{form.noun} {type(plugin).__name__}: is an instance already; set {names} when you make it")
    return plugin


def shape_in(shape: Shapelike) -> Shape:
    """Return a :data:`Shapelike` as (height, width) in px; raise BadInput if it is none."""
    if isinstance(shape, str):
        return parse_size(shape)
    try:
        height, width = map(operator.index, shape)
    except (TypeError, ValueError):
        raise BadInput(f"shape {shape!r}: give (height, width) in px, two whole numbers") from None
    if min(height, width) < 1 or max(height, width) > LARGEST_SIDE:
        raise BadInput(f"shape {shape}: give (height, width) in px, each at least 1 and at most {LARGEST_SIDE}")
    return height, width


def names_of(given: Sequence[str] | str) -> list[str]:
    """Return the names of a sequence, or of a text in which commas join them."""
    names = given.split(",") if isinstance(given, str) else given
    return [name.strip() for name in names if name.strip()]


def list_of(given: Any) -> list[Any]:
    """Return a sequence as a list; a text, an array, a lattice or a single plugin counts as one entry."""
    return list(given) if isinstance(given, Sequence) and not isinstance(given, str) else [given]


def method_text(method: Pluginlike) -> str:
    """Return a method as ``name:param=value``; register a class that is not registered yet."""
    if isinstance(method, str):
        return method
    instance = None if isinstance(method, type) else method
    cls = method if isinstance(method, type) else type(method)
    name = plugins.name_of("synthesizers", cls) or plugins.add_method(cls)
    given = plugins.parameters_of(instance) if instance is not None else {}
    texts = [f"{key}={','.join(map(str, v)) if isinstance(v, list) else v}" for key, v in given.items()]
    return f"{name}:{','.join(texts)}" if texts else name


def lattice_source_texts(lattice: Any) -> list[str]:
    """Return the entries of the lattice axis as texts. Numbers, or vectors, are one lattice and no list of lattices."""
    entries = list_of(lattice)
    parts = [[each] if isinstance(each, Real) else each for each in entries]
    one = all(
        isinstance(each, Collection) and len(each) < 3 and all(isinstance(x, Real) for x in each) for each in parts
    )
    return [lattice_source_text(each) for each in ([lattice] if one and len(parts) > 1 else entries)]


def lattice_source_text(lattice: Latticelike) -> str:
    """Return an entry of the lattice axis as text."""
    if isinstance(lattice, str):
        return lattice
    given = as_lattice(lattice)
    if given is None:
        raise BadInput("lattice None: leave it out, or give 'own', 'given', a detector or a lattice")
    return ",".join(repr(float(number)) for number in given.numbers)
