"""Synthesize all maps of a material in one layout: color, normals, heights, roughness, alpha."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nrbench import plugins
from nrbench.calling.method_calls import checked_synthesis
from nrbench.imaging.convert import Image, depth_of, quantize
from nrbench.imaging.source_maps import as_layers_of_map, like_map
from nrbench.plugins.forms import Synthesis, Synthesizer, Task

_MOST_OFF = 0.2
"""Largest change of the mean of alpha, as a share of it, that is not named."""


def synthesize_with_maps(
    make: Callable[[Synthesizer, Task], Synthesis], method: Synthesizer, task: Task, maps: Sequence[NDArray[Any]]
) -> Synthesis:
    """Return a checked synthesis, with other maps of the sample in the same layout.

    A method whose class variable ``maps`` is ``"source"`` runs as it would alone, and the maps are laid out by its
    source map. One whose ``maps`` is ``"joint"`` gets them as further channels of the sample, each stretched to [0, 1].

    Parameters
    ----------
    make
        Calls the method with a task.
    method, task
        The method and its task.
    maps
        ``(h, w)`` or ``(h, w, C)`` each, of the size of the sample.

    Raises
    ------
    BadInput
        If a map has another size, or values that are not finite.
    """
    sample, values = task.sample, [as_layers_of_map(each, task.sample.shape) for each in maps]
    if not maps or getattr(method, "maps", "") != "joint":
        made = checked_synthesis(make(method, task), sample, task.shape, task.known)
        return replace(_name_able(made), maps=tuple(map(made.apply, maps)))
    low, span = ([change(each) for each in values] for change in (np.min, lambda each: max(np.ptp(each), 1e-12)))
    units = [(each - first) / length for each, first, length in zip(values, low, span, strict=True)]
    stack = quantize(np.concatenate([sample, *units], -1), 16)
    made = checked_synthesis(make(method, replace(task, sample=stack)), stack, task.shape, task.known)
    ends = np.cumsum([sample.shape[2], *(each.shape[2] for each in values)])
    image, *parts = np.split(np.asarray(made.image, np.float64), ends[:-1], -1)
    restored = [part * length + first for part, length, first in zip(parts, span, low, strict=True)]
    made = checked_synthesis(replace(made, image=image.astype(np.float32)), sample, task.shape, task.known)
    return replace(
        _name_able(made), maps=tuple(like_map(each, other, each) for each, other in zip(restored, maps, strict=True))
    )


def _name_able(made: Synthesis) -> Synthesis:
    if made.source is not None:
        return made
    able = [one.name for one in plugins.inventory("synthesizers") if getattr(one.cls, "maps", "") == "source"]
    return replace(made, able=", ".join(able))


def flatten_alpha(pixels: Image) -> tuple[Image, list[Image]]:
    """Return an image over a color that is far from all its own, and the maps that :func:`restore_alpha` needs.

    Parameters
    ----------
    pixels
        ``(h, w, 2)`` or ``(h, w, 4)`` in [0, 1], the last channel is alpha.
    """
    color, alpha = pixels[..., :-1], pixels[..., -1:]
    shown = color[alpha[..., 0] > 0.5][::7].reshape(-1, color.shape[2])
    corners = np.array(list(product((0.0, 1.0), repeat=color.shape[2])))
    apart = [np.quantile(np.linalg.norm(shown - each, axis=-1), 0.02) if len(shown) else 0.0 for each in corners]
    over = color * alpha + corners[int(np.argmax(apart))] * (1 - alpha)
    return quantize(over.astype(np.float32), depth_of(pixels)), [color * alpha, alpha, color]


def restore_alpha(made: Synthesis, bits: int, opaque: float) -> Synthesis:
    """Return a synthesis of a flattened image with the alpha channel, without the maps of :func:`flatten_alpha`.

    A warning says if the mean of alpha differs much from ``opaque``, that of the picture.
    """
    weighted, alpha, color = made.maps[:3]
    own, theirs = float(alpha.mean()), float(opaque)
    if abs(own - theirs) > _MOST_OFF * theirs:
        warnings.warn(
            f"{own:.0%} of the output is opaque, and {theirs:.0%} of the picture: holes or rims are lost; another "
            "method, such as tile-set, may keep them",
            stacklevel=2,
        )
    shown = np.where(alpha > 0.5 / 255, weighted / np.maximum(alpha, 0.5 / 255), color)
    image = quantize(np.concatenate([shown, alpha], -1).astype(np.float32), bits)
    return replace(made, image=image, maps=made.maps[3:])
