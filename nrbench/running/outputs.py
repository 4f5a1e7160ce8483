"""What a method hands back, checked before anything is written."""

from __future__ import annotations

import dataclasses
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Shape, SourceMap, Synthesis

COPY_TOLERANCE = 1.5 / 255
"""A pixel that a source map calls a plain copy may differ from its source by the rounding to 8 bits, no more."""


class InvalidOutput(Exception):
    """A method returned something that is no output of its task."""


def checked_synthesis(made: Any, sample: Image, shape: Shape) -> Synthesis:
    """Return the synthesis with its image rounded to 8 bits.

    Raises
    ------
    InvalidOutput
        When it is no :class:`Synthesis`, its image is not finite or of another shape, its source map is not true, or
        anything else in it is not of its declared type.
    """
    if not isinstance(made, Synthesis):
        raise InvalidOutput(f"returned {type(made).__name__} instead of a Synthesis")
    image = _checked_image(made.image, (*shape, sample.shape[2]))
    source = None if made.source is None else _numbers(made.source, "source map").astype(np.float32)
    if source is not None:
        check_source(source, image, sample)
    if not (made.lattice is None or isinstance(made.lattice, Lattice)):
        raise InvalidOutput(f"returned a lattice of type {type(made.lattice).__name__}; a Lattice or None is due")
    extras = {_checked_name(name): _numbers(array, f"extra {name!r}") for name, array in made.extras.items()}
    seconds = _checked_seconds(made.detection_seconds)
    return dataclasses.replace(
        made, image=image, source=source, extras=extras, detection_seconds=seconds, note=str(made.note or "")
    )


def is_picture(extra: NDArray[Any]) -> bool:
    """Return whether a method's extra is a picture: ``(h, w, 1)`` or ``(h, w, 3)``, floats in [0, 1]."""
    if extra.ndim != 3 or extra.shape[2] not in (1, 3) or extra.dtype.kind != "f" or not extra.size:
        return False
    return bool(extra.min() >= 0 and extra.max() <= 1)


def _numbers(value: Any, what: str) -> NDArray[Any]:
    array = np.asarray(value)
    if array.dtype.kind not in "biufc":
        raise InvalidOutput(f"returned a {what} of dtype {array.dtype}; an array of numbers is due")
    return array


def _checked_name(name: Any) -> str:
    if not (isinstance(name, str) and re.fullmatch(r"\w[\w.-]{0,79}", name)):
        raise InvalidOutput(f"returned an extra called {name!r}; use letters, digits, '.', '-' and '_'")
    return name


def _checked_seconds(value: Any) -> float:
    if not (isinstance(value, int | float | np.number) and np.isfinite(value) and value >= 0):
        raise InvalidOutput(f"returned detection_seconds {value!r}; a number of seconds is due")
    return float(value)


def _checked_image(image: Any, wanted: tuple[int, int, int]) -> Image:
    pixels = np.asarray(image)
    if pixels.shape != wanted:
        raise InvalidOutput(f"returned an image of shape {pixels.shape}; asked for {wanted}")
    if not np.issubdtype(pixels.dtype, np.floating):
        raise InvalidOutput(f"returned pixels of dtype {pixels.dtype}; floats in [0, 1] are due")
    if not np.isfinite(pixels).all():
        bad = int((~np.isfinite(pixels)).any(-1).sum())
        raise InvalidOutput(f"returned NaN or infinity in {bad} of {wanted[0] * wanted[1]} pixels")
    return quantize(np.asarray(pixels, np.float32))


def check_source(source: SourceMap, image: Image, sample: Image) -> None:
    """Check that a source map is inside the sample, and true wherever it claims a plain copy of a whole pixel.

    Raises
    ------
    InvalidOutput
        Naming how many pixels are wrong.
    """
    if source.shape != (*image.shape[:2], 3):
        raise InvalidOutput(
            f"returned a source map of shape {source.shape}; ({image.shape[0]}, {image.shape[1]}, 3) is due"
        )
    known = np.isfinite(source).all(-1)
    x, y, weight = np.moveaxis(source[known], -1, 0)
    inside = (x >= -0.5) & (x <= sample.shape[1] - 0.5) & (y >= -0.5) & (y <= sample.shape[0] - 0.5)
    if not (inside & (weight > 0) & (weight <= 1 + 1e-6)).all():
        raise InvalidOutput("returned a source map that points outside the sample, or has weights outside (0, 1]")
    plain = (weight > 1 - 1e-6) & (x == np.rint(x)) & (y == np.rint(y))
    copied = sample[y[plain].astype(int), x[plain].astype(int)]
    wrong = int((np.abs(image[known][plain] - copied) > COPY_TOLERANCE).any(-1).sum())
    if wrong:
        raise InvalidOutput(f"returned a source map that is not true: {wrong} copied pixels differ from their source")
