"""Texture optimization: all neighborhoods of the output approach those of the sample (``texture-optimization``)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import require, require_ranges
from nrbench.imaging.convert import Image
from nrbench.plugins.forms import Refused, Shape, Synthesis, Task

from .gap_filling.holes import leaves_out
from .neighbor_fields.neighbor_field import NeighborField, make_grid
from .neighbor_fields.pyramid import cover_sample, rescale, scale_shape

SMALLEST: Final = 8
"""Side in px of the smallest neighborhood, of the paper."""
SWEEPS: Final = 8
"""Number of passes of a search for neighborhoods."""
SOFTENING: Final = 1e-4
"""Added to squared distances of neighborhoods, so that the weight of a perfect match is finite. It is a gray level for
one pixel of the smallest neighborhood."""


@leaves_out
@dataclass(frozen=True)
class TextureOptimization:
    """Texture optimization (Kwatra and others 2005).

    The energy of the output is the sum of ||x_p - z_p||^r over its neighborhoods x_p, squares a quarter of their side
    apart, where z_p is a neighborhood of the sample (section 3, equation 1, and section 3.1). It is minimized as by
    expectation maximization. One step computes the pixels, as means of the z_p that cover them, with weights
    ||x_p - z_p||^(r - 2) (iteratively reweighted least squares). The other step searches for the z_p nearest to each
    x_p. At first the z_p are random. The output is refined from coarse to fine resolutions, and at each resolution from
    large to small neighborhoods (section 3.2).

    No step increases the energy; ``extras["energy"]`` holds it. The paper searches in a tree of clusters, which is
    approximate as our search is. We leave out neighborhoods larger than half the sample at a resolution. A size is left
    if few neighborhoods change their matches, or after ``iterations``. The paper waits until none does, and needs 3 to
    5 iterations. As many as 16 make the parts of the output that agree with each other larger.

    Parameters
    ----------
    neighborhood
        Side of the largest neighborhood in px, at least 8. It is halved down to 8 px at each resolution.
    levels
        Number of resolutions, each half of the next.
    iterations
        Largest number of iterations for each resolution and size.
    unsettled
        Share of neighborhoods, in [0, 1], that may change their matches in the last iteration of a size.
    exponent
        The exponent r of the distances, larger than 0 and at most 2. With 2 all weights are equal.

    References
    ----------
    .. [1] Vivek Kwatra, Irfan Essa, Aaron Bobick, Nipun Kwatra. "Texture Optimization for Example-Based Synthesis." ACM
           Transactions on Graphics 24(3), Proceedings of SIGGRAPH 2005, 795-802. :DOI:`10.1145/1073204.1073263`
    """

    neighborhood: int = 32
    levels: int = 3
    iterations: int = 16
    unsettled: float = 0.005
    exponent: float = 0.8

    wraps: ClassVar[bool] = True
    uses_lattice: ClassVar[bool] = False
    family: ClassVar[str] = "all patches at once"
    maps: ClassVar[str] = "joint"
    version: ClassVar[str] = "2"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {"neighborhood": 32, "levels": 3, "iterations": 5, "unsettled": 0.0, "exponent": 0.8}
    }
    paper: ClassVar[str] = """@article{kwatra2005texture,
  author = {Vivek Kwatra and Irfan Essa and Aaron Bobick and Nipun Kwatra},
  title = {Texture Optimization for Example-Based Synthesis},
  journal = {ACM Transactions on Graphics},
  volume = {24},
  number = {3},
  pages = {795--802},
  year = {2005}
}"""

    def __post_init__(self) -> None:
        require_ranges(self, neighborhood=(SMALLEST, np.inf), levels=(1, 8), iterations=(1, np.inf), exponent=(0, 2))
        require_ranges(self, unsettled=(0, 1))
        require(self.exponent > 0, f"exponent {self.exponent}; choose more than 0")

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis.

        Raises
        ------
        Refused
            If the sample is smaller than two of the smallest neighborhoods.
        """
        steps = list(self._steps(task.sample.shape))
        if not steps:
            height, width, _ = task.sample.shape
            raise Refused(
                f"the sample is {width}x{height} px, less than two neighborhoods; choose a larger sample or a smaller "
                "neighborhood"
            )
        image: Image | None = None
        field: NeighborField | None = None
        energies: list[float] = []
        before = steps[0][0]
        for number, (factor, size) in enumerate(steps):
            shape = scale_shape(cover_sample(task), factor)
            sample = rescale(task.sample, factor, scale_shape(task.sample.shape[:2], factor))
            grid, places = make_grid(shape, size, size // 4, task.tileable), sample.shape[:2]
            if field is None or image is None:
                field = NeighborField.draw(grid, size, places, task.rng, task.tileable)
                image = _blend(field, sample, shape, np.ones_like(field.costs))
            else:
                field = field.move(grid, size, places, factor / before)
                image = rescale(image, factor / before, shape, task.tileable) if factor != before else image
            image, found = self._minimize(image, sample, field, task.rng)
            energies += found
            before = factor
            task.progress((number + 1) / len(steps))
        assert image is not None
        output = np.clip(image[: task.shape[0], : task.shape[1]], 0, 1)
        return Synthesis(output, extras={"energy": np.array(energies)})

    def _steps(self, shape: tuple[int, ...]) -> Iterator[tuple[float, int]]:
        """Yield each resolution, relative to the sample's, with each side of its neighborhoods."""
        for level in reversed(range(self.levels)):
            size = self.neighborhood
            while size >= SMALLEST:
                if 2 * size <= min(scale_shape((shape[0], shape[1]), 0.5**level)):
                    yield 0.5**level, size
                size //= 2

    def _minimize(
        self, image: Image, sample: Image, field: NeighborField, rng: np.random.Generator
    ) -> tuple[Image, list[float]]:
        """Return the image of less energy, and the energies of all iterations."""
        energies: list[float] = []
        for _ in range(self.iterations):
            before = field.matches.copy()
            field.search(image, sample, rng, SWEEPS)
            distances = field.costs + SOFTENING
            energies.append(float((distances ** (self.exponent / 2)).sum(dtype=np.float64)))
            image = _blend(field, sample, (image.shape[0], image.shape[1]), distances ** (self.exponent / 2 - 1))
            if (before != field.matches).any(-1).mean() <= self.unsettled:
                break
        return image, energies


def _blend(field: NeighborField, sample: Image, shape: Shape, weights: NDArray[np.float32]) -> Image:
    """Return the weighted mean of the neighborhoods found."""
    return field.average(sample, shape, weights, np.ones((field.size, field.size), np.float32))
