"""Direct patch distribution matching: gradient steps that make the patches' distribution the sample's (``gpdm``)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import require_ranges
from nrbench.imaging.convert import Image
from nrbench.plugins.forms import Synthesis, Task

from .gap_filling.holes import leaves_out
from .neighbor_fields.pyramid import cover_sample, list_resolutions, rescale, scale_shape
from .patch_projections.patch_projection_kernels import collect_gradient, match_ranks, project_patches

Planes = NDArray[np.float32]
"""``float32 (C, H, W)``: an image, channel by channel."""
Filters = NDArray[np.float32]
"""``float32 (P, C, size, size)``: directions in the space of patches, of length 1."""

SCALE: Final = 0.5
"""The paper's values lie in [-1, 1], ours in [0, 1]: one of its units is this much."""
MOMENTS: Final = (0.9, 0.999)
"""The decay rates of Adam, its default values, which the paper uses."""


@leaves_out
@dataclass(frozen=True)
class Gpdm:
    """Generative patch distribution matching, GPDM (Elnekave and Weiss 2022).

    An output of noise is refined from coarse to fine resolutions. At each, gradient steps of Adam minimize the sliced
    Wasserstein distance (SWD) between the distributions of the patches of output and sample (section 3, algorithm 1).
    Each step draws random projections of a patch, which are convolutions of the image. The projections of all patches
    of output and sample are sorted, and the distance is the mean absolute difference of those of the same rank. If the
    output has more patches than the sample, each patch of the sample stands for several.

    Ranks are computed by bins, which takes a tenth of the time of sorting. The output is drawn with a border of a
    patch, which is cut off, because few patches hold the pixels at the border. If it repeats, patches cross its edges
    instead. The defaults take less time than the paper's values: fewer projections a step, because each step draws new
    ones, larger steps, and fewer resolutions. In the second half of the steps the learning rate falls to 0, so that the
    steps' own noise does not stay.
    ``extras["distance"]`` holds the distance in the last step of each resolution.

    Parameters
    ----------
    patch
        Side of a patch in px, 3 or more.
    projections
        Number of random projections of each step.
    steps
        Number of steps at each resolution.
    rate
        Learning rate of Adam, of values in [-1, 1].
    ratio
        Each resolution over the next finer one, from 0.3 to 0.95.
    coarsest
        Least shorter side of the sample in px at the coarsest resolution.
    noise
        Standard deviation of the initial noise, of values in [-1, 1].

    References
    ----------
    .. [1] Ariel Elnekave, Yair Weiss. "Generating Natural Images with Direct Patch Distributions Matching." ECCV 2022.
    .. [2] Diederik P. Kingma, Jimmy Ba. "Adam: A Method for Stochastic Optimization." ICLR 2015.
    """

    patch: int = 7
    projections: int = 4
    steps: int = 250
    rate: float = 0.02
    ratio: float = 0.75
    coarsest: int = 28
    noise: float = 1.5

    uses_lattice: ClassVar[bool] = False
    wraps: ClassVar[bool] = True
    family: ClassVar[str] = "all patches at once"
    version: ClassVar[str] = "1"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {
            "patch": 7,
            "projections": 64,
            "steps": 300,
            "rate": 0.01,
            "ratio": 0.85,
            "coarsest": 28,
            "noise": 1.5,
        }
    }
    paper: ClassVar[str] = """@inproceedings{elnekave2022generating,
  author = {Ariel Elnekave and Yair Weiss},
  title = {Generating Natural Images with Direct Patch Distributions Matching},
  booktitle = {European Conference on Computer Vision (ECCV)},
  year = {2022}
}"""

    def __post_init__(self) -> None:
        require_ranges(self, patch=(3, np.inf), projections=(1, np.inf), steps=(1, np.inf), rate=(1e-6, 1))
        require_ranges(self, ratio=(0.3, 0.95), coarsest=(1, np.inf), noise=(0, 10))

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis.

        Raises
        ------
        Refused
            If the sample is smaller than a patch.
        """
        resolutions = list_resolutions(task.sample.shape[:2], self.ratio, self.coarsest, self.patch)
        border = 0 if task.tileable else self.patch
        height, width = cover_sample(task)
        image, distances = task.sample, []
        for number, factor in enumerate(resolutions):
            shape = scale_shape((height + 2 * border, width + 2 * border), factor)
            sample = rescale(task.sample, factor, scale_shape(task.sample.shape[:2], factor))
            if number:
                image = rescale(image, 1 / self.ratio, shape, task.tileable)
            else:
                grain = task.rng.standard_normal((*shape, sample.shape[2]), np.float32)
                image = sample.mean((0, 1)) + np.float32(self.noise * SCALE) * grain
            planes, distance = self._match_patches(to_planes(image), to_planes(sample), task.rng, task.tileable)
            image = np.ascontiguousarray(np.moveaxis(np.clip(planes, 0, 1), 0, -1))
            distances.append(distance)
            task.progress((number + 1) / len(resolutions))
        output = image[border : border + task.shape[0], border : border + task.shape[1]]
        return Synthesis(output, extras={"distance": np.array(distances)})

    def _match_patches(
        self, planes: Planes, sample: Planes, rng: np.random.Generator, wrap: bool
    ) -> tuple[Planes, float]:
        """Return the planes of an image after all steps, and the distance before the last one."""
        compare = SlicedDistance(planes.shape, sample.shape, self.patch, self.projections, wrap)
        mean, square = np.zeros_like(planes), np.zeros_like(planes)
        distance = 0.0
        for step in range(1, self.steps + 1):
            filters = draw_filters(self.projections, len(planes), self.patch, rng)
            distance, gradient = compare.measure(planes, sample, filters)
            mean = _decay(mean, gradient, MOMENTS[0])
            square = _decay(square, gradient**2, MOMENTS[1])
            first, second = (np.float32(1 - moment**step) for moment in MOMENTS)
            root = np.sqrt(square / second) + np.float32(1e-8)
            rate = self.rate * SCALE * min(1.0, 2 * (1 - (step - 1) / self.steps))
            planes = planes - np.float32(rate) * (mean / first) / root
        return planes, distance


def _decay(average: NDArray[np.float32], new: NDArray[np.float32], rate: float) -> NDArray[np.float32]:
    """Return a running average with a new value."""
    return np.float32(rate) * average + np.float32(1 - rate) * new


def to_planes(image: Image) -> Planes:
    """Return the planes of an image."""
    return np.ascontiguousarray(np.moveaxis(image, -1, 0), np.float32)


def draw_filters(count: int, channels: int, size: int, rng: np.random.Generator) -> Filters:
    """Return random directions, uniform on the sphere."""
    filters = rng.standard_normal((count, channels, size, size), np.float32)
    return np.asarray(filters / np.sqrt((filters**2).sum((1, 2, 3), keepdims=True)))


class SlicedDistance:
    """Measures the distance between the patches of two images of given shapes, again and again.

    Parameters
    ----------
    shape, other
        ``(C, H, W)`` of the image and of the one that it is compared with.
    size
        Side of a patch in px.
    count
        Number of directions.
    wrap
        Whether patches cross the edges of the image.
    """

    def __init__(
        self, shape: tuple[int, ...], other: tuple[int, ...], size: int, count: int, wrap: bool = False
    ) -> None:
        self._more, channels = size - 1 if wrap else 0, shape[0]
        shape = channels, shape[1] + self._more, shape[2] + self._more
        self._own, self._theirs = (
            np.empty((count, height - size + 1, width - size + 1), np.float32) for _, height, width in (shape, other)
        )
        self._slopes, self._gradient = np.empty_like(self._own), np.empty(shape, np.float32)

    def measure(self, planes: Planes, other: Planes, filters: Filters) -> tuple[float, Planes]:
        """Return the distance, and its gradient by the pixels of ``planes`` times the number of projected values.

        Parameters
        ----------
        planes, other
            The image and the one that it is compared with.
        filters
            The directions.
        """
        more = self._more
        around = np.pad(planes, ((0, 0), (0, more), (0, more)), "wrap") if more else planes
        project_patches(around, filters, self._own)
        project_patches(other, filters, self._theirs)
        count = len(filters)
        targets = np.sort(self._theirs.reshape(count, -1), 1)
        distance = match_ranks(self._own.reshape(count, -1), targets, self._slopes.reshape(count, -1))
        collect_gradient(self._slopes, filters, self._gradient)
        return distance, sum_periods(self._gradient, planes.shape) if more else self._gradient


def sum_periods(planes: Planes, shape: tuple[int, ...]) -> Planes:
    """Return the sums, of shape ``(C, H, W)``, of the pixels of larger planes that lie whole periods H and W apart."""
    _, height, width = shape
    sums = np.zeros(shape, np.float32)
    for top in range(0, planes.shape[1], height):
        for left in range(0, planes.shape[2], width):
            part = planes[:, top : top + height, left : left + width]
            sums[:, : part.shape[1], : part.shape[2]] += part
    return sums
