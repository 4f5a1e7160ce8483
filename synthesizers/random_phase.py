"""A baseline: the sample's spectrum with random phases."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.errors import require_ranges
from nrbench.imaging.convert import Image
from nrbench.plugins.forms import Kind, Shape, Synthesis, Task

Planes = NDArray[np.float64]
"""``(C, H, W)``."""


@dataclass(frozen=True)
class RandomPhase:
    """Random phase noise: keeps the sample's spectrum, colors and their covariance, loses all structure.

    Galerne, Gousseau and Morel, "Random phase textures: theory and synthesis" (IEEE TIP 20, 2011): at each frequency
    one random phase is added to the phases of all channels (section IV), after the sample's border discontinuity is
    removed (Moisan's periodic component, section V-A). For an output larger than the sample, the sample is placed on a
    plain of its mean color, faded at its border and scaled so that the variance is kept (section V-B). An output that
    is smaller than the sample along an axis is cut from a larger one; if it must repeat, the sample is cut instead.

    On textures without a lattice it is a valid method rather than a baseline.

    Parameters
    ----------
    fade
        Share of the sample's sides, in [0, 0.5], over which its border fades where the output is larger.
    """

    fade: float = 0.1

    reference: ClassVar[bool] = True
    uses_lattice: ClassVar[bool] = False
    wraps: ClassVar[bool] = True
    right_on: ClassVar[frozenset[Kind]] = frozenset({"stochastic"})
    maps: ClassVar[str] = "joint"
    version: ClassVar[str] = "1"

    def __post_init__(self) -> None:
        require_ranges(self, fade=(0, 0.5))

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis."""
        sample = task.sample[: task.shape[0], : task.shape[1]] if task.tileable else task.sample
        height, width = (max(pair) for pair in zip(task.shape, sample.shape[:2], strict=True))
        planes = np.moveaxis(sample.astype(np.float64), -1, 0)
        mean = planes.mean((1, 2), keepdims=True)
        spot = _in_plain(_periodic(planes) - mean, (height, width), self.fade)
        phases = np.angle(scipy.fft.rfft2(task.rng.standard_normal((height, width))))
        mixed = scipy.fft.irfft2(scipy.fft.rfft2(spot) * np.exp(1j * phases), (height, width)) + mean
        image: Image = np.moveaxis(mixed, 0, -1)[: task.shape[0], : task.shape[1]].astype(np.float32)
        task.progress(1.0)
        return Synthesis(np.clip(image, 0, 1))


def _periodic(planes: Planes) -> Planes:
    """Return Moisan's periodic component: the image without a smooth image that has its jumps across the borders."""
    jumps = np.zeros_like(planes)
    down, across = planes[:, -1] - planes[:, 0], planes[:, :, -1] - planes[:, :, 0]
    jumps[:, 0] += down
    jumps[:, -1] -= down
    jumps[:, :, 0] += across
    jumps[:, :, -1] -= across
    height, width = planes.shape[1:]
    y, x = 2 * math.pi * np.arange(height) / height, 2 * math.pi * np.arange(width // 2 + 1) / width
    laplacian = 2 * np.cos(y)[:, np.newaxis] + 2 * np.cos(x) - 4
    laplacian[0, 0] = 1
    spectrum = scipy.fft.rfft2(jumps) / laplacian
    spectrum[:, 0, 0] = 0
    return np.asarray(planes - scipy.fft.irfft2(spectrum, (height, width)))


def _in_plain(planes: Planes, shape: Shape, fade: float) -> Planes:
    """Return the image in the corner of an image of zeros, faded and scaled so that the total variance is kept."""
    sides = planes.shape[1:]
    windows = [_window(side, fade if full > side else 0.0) for side, full in zip(sides, shape, strict=True)]
    window = windows[0][:, np.newaxis] * windows[1]
    scale = math.sqrt(shape[0] * shape[1] / float((window**2).sum()))
    centered = planes - (planes * window).sum((1, 2), keepdims=True) / window.sum()
    spot = np.zeros((len(planes), *shape))
    spot[:, : sides[0], : sides[1]] = centered * window * scale
    return spot


def _window(side: int, fade: float) -> NDArray[np.float64]:
    """Return a window that rises as a squared sine over the share ``fade`` of its length and falls again."""
    depth = (np.minimum(np.arange(side), np.arange(side)[::-1]) + 0.5) / max(fade * side, 0.5)
    return np.asarray(np.sin(np.minimum(depth, 1) * math.pi / 2) ** 2)
