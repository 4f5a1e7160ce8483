"""Generative patch nearest neighbors: coarse to fine, with a search that uses the whole sample (``gpnn``)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import require, require_ranges
from nrbench.imaging.convert import Image
from nrbench.plugins.forms import Synthesis, Task

from .gap_filling.holes import leaves_out
from .neighbor_fields.neighbor_field import NeighborField, make_grid, wrap_around
from .neighbor_fields.pyramid import cover_sample, list_resolutions, rescale, scale_shape

RATIO: Final = 3 / 4
"""Each resolution over the next finer one, of the paper (r = 4/3)."""
SWEEPS: Final = 2
"""Number of passes of a search. Each search starts from the matches of the one before."""
UNIT: Final = 0.5
"""The paper's values lie in [-1, 1], ours in [0, 1]: one of its units is this much."""


@leaves_out
@dataclass(frozen=True)
class Gpnn:
    """Generative patch nearest neighbors, GPNN (Granot and others 2022).

    An output of noise is refined from coarse to fine resolutions, 4/3 apart. At each resolution, each of its patches
    Q_i is replaced by the patch V_j of the sample whose key K_j is most similar, and each pixel becomes the mean of the
    patches that cover it, weighted by a Gaussian (section 3.2). The similarity is

        S(i, j) = 1 / (alpha + min over l of D(Q_l, K_j)) * 1 / D(Q_i, K_j),

    (section 3.2, its normalized distance inverted), with the mean squared difference D. So patches of the sample that
    resemble no patch of the output are preferred, which makes the output complete. In the first iteration at a
    resolution the keys are blurred as the output is: they are those of the next coarser sample, enlarged. Later they
    are the values.

    The paper starts from the sample plus noise, and so makes outputs of the sample's size, or of other proportions.
    Ours are larger than the sample at its scale. They start from its mean color plus the paper's noise. The paper
    compares all patches; our search is approximate in both directions. The paper has one iteration at the coarsest
    resolution. With ten, more of the output agrees with the sample's lattice. At the others it has ten. After five, few
    patches change their matches.

    Parameters
    ----------
    patch
        Side of a patch in px, 3 or more.
    alpha
        Completeness: small values use more of the sample. 0: off, all patches are compared by D alone.
    iterations
        Iterations at each resolution but the coarsest.
    first_iterations
        Iterations at the coarsest resolution.
    coarsest
        Least shorter side of the sample in px at the coarsest resolution.
    noise
        Standard deviation of the initial noise, of values in [-1, 1].

    References
    ----------
    .. [1] Niv Granot, Ben Feinstein, Assaf Shocher, Shai Bagon, Michal Irani. "Drop the GAN: In Defense of Patches
           Nearest Neighbors as Single Image Generative Models." CVPR 2022.
    """

    patch: int = 7
    alpha: float = 0.005
    iterations: int = 5
    first_iterations: int = 10
    coarsest: int = 28
    noise: float = 0.75

    wraps: ClassVar[bool] = True
    uses_lattice: ClassVar[bool] = False
    family: ClassVar[str] = "all patches at once"
    maps: ClassVar[str] = "joint"
    version: ClassVar[str] = "2"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {"patch": 7, "alpha": 0.005, "iterations": 10, "first_iterations": 1, "noise": 0.75}
    }
    paper: ClassVar[str] = """@inproceedings{granot2022drop,
  author = {Niv Granot and Ben Feinstein and Assaf Shocher and Shai Bagon and Michal Irani},
  title = {Drop the {GAN}: In Defense of Patches Nearest Neighbors as Single Image Generative Models},
  booktitle = {IEEE/CVF Conference on Computer Vision and Pattern Recognition (CVPR)},
  year = {2022}
}"""

    def __post_init__(self) -> None:
        require_ranges(self, patch=(3, np.inf), alpha=(0, 100), noise=(0, 10), coarsest=(1, np.inf))
        require_ranges(self, iterations=(1, np.inf), first_iterations=(1, np.inf))
        require(self.alpha == 0 or self.alpha >= 1e-6, f"alpha {self.alpha}; choose 0, or 1e-06 or more")

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis.

        Raises
        ------
        Refused
            If the sample is smaller than a patch.
        """
        resolutions = list_resolutions(task.sample.shape[:2], RATIO, self.coarsest, self.patch)
        image = keys = task.sample
        search: _Search | None = None
        for number, factor in enumerate(resolutions):
            shape, places = (scale_shape(each, factor) for each in (cover_sample(task), task.sample.shape[:2]))
            values = rescale(task.sample, factor, places)
            if search is None:
                search, keys, count = _Search.draw(self, shape, places, task), values, self.first_iterations
                grain = task.rng.standard_normal((*shape, values.shape[2]), np.float32)
                image = values.mean((0, 1)) + np.float32(self.noise * UNIT) * grain
            else:
                search, keys, count = search.move(shape, places), rescale(keys, 1 / RATIO, places), self.iterations
                image = rescale(image, 1 / RATIO, shape, task.tileable)
            for _ in range(count):
                image = search.replace_patches(image, keys, values)
                keys = values
            task.progress((number + 1) / len(resolutions))
        return Synthesis(np.clip(image[: task.shape[0], : task.shape[1]], 0, 1))


@dataclass(frozen=True, eq=False)
class _Search:
    """The matches of an output's patches in the sample, and of the sample's in the output, at one resolution."""

    method: Gpnn
    forth: NeighborField
    back: NeighborField
    shape: tuple[int, int]
    rng: np.random.Generator

    @classmethod
    def draw(cls, method: Gpnn, shape: tuple[int, int], places: tuple[int, int], task: Task) -> _Search:
        """Return random matches, for an output of ``shape`` and a sample of ``places``."""
        size, wrap = method.patch, task.tileable
        forth = NeighborField.draw(make_grid(shape, size, wrap=wrap), size, places, task.rng, wrap)
        back = NeighborField.draw(make_grid(places, size), size, _extended(shape, size, wrap), task.rng)
        return cls(method, forth, back, shape, task.rng)

    def move(self, shape: tuple[int, int], places: tuple[int, int]) -> _Search:
        """Return the matches at the next finer resolution."""
        size = self.method.patch
        wrap = self.forth.wrap
        forth = self.forth.move(make_grid(shape, size, wrap=wrap), size, places, 1 / RATIO)
        back = self.back.move(make_grid(places, size), size, _extended(shape, size, wrap), 1 / RATIO)
        return _Search(self.method, forth, back, shape, self.rng)

    def replace_patches(self, image: Image, keys: Image, values: Image) -> Image:
        """Return the output with all patches replaced by those of ``values`` with the most similar keys."""
        factors: NDArray[np.float32] | None = None
        if self.method.alpha:
            around = wrap_around(image, self.method.patch) if self.forth.wrap else image
            self.back.search(keys, around, self.rng, SWEEPS)
            alpha = self.method.alpha * UNIT**2 * self.method.patch**2 * image.shape[2]
            factors = (1 / (alpha + self.back.costs)).astype(np.float32)
        self.forth.search(image, keys, self.rng, SWEEPS, factors)
        from_middle = np.arange(self.method.patch) - (self.method.patch - 1) / 2
        bell = np.exp(-8 * (from_middle / self.method.patch) ** 2)  # a standard deviation of a quarter of the patch
        falloff = np.outer(bell, bell).astype(np.float32)
        return self.forth.average(values, self.shape, np.ones_like(self.forth.costs), falloff)


def _extended(shape: tuple[int, int], size: int, wrap: bool) -> tuple[int, int]:
    """Return the shape of an image in which patches are found: of one that wraps, with its first pixels repeated."""
    return (shape[0] + size - 1, shape[1] + size - 1) if wrap else shape
