"""Regularized patch-based synthesis: texels of a straightened sample, pasted on its lattice and deformed again."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Literal

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import require_ranges
from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Refused, SourceMap, Synthesis, Task, require_lattice
from nrbench.plugins.registry import NamedDetector

from .geometry.deformed_lattice import Deform
from .geometry.free_form import REPEATS
from .geometry.straightening import Bend, StraightSample, trace_points
from .sampling.equal_places import pixel_grid, require_two_periods
from .sampling.patches import Patches, round_places
from .texel_pasting.quiet_borders import TexelKind, parallelogram, quiet_texels
from .texel_pasting.texel_mosaic import TexelMosaic, TexelShape, TexelStock

ZONE: Final = (3.0, 8.0)
"""px: the least and the greatest default breadth of the zone; between them it is a sixth of s."""
_BAND = 1 << 16
"""Number of output pixels that are computed at a time."""
_LEAST_WEIGHT = 1e-6


@dataclass(frozen=True)
class RegularizedPatch:
    """Regularized patch-based synthesis (Lin et al. 2004, section 2.4 and appendix A): texels pasted on the lattice.

    The lattice is tracked through the sample, where the report lets a user move its vertices. Multilevel free-form
    deformation, from the regular vertices to the tracked ones, straightens the sample. Its texels, each a cell of the
    lattice with a zone around it, are the only candidates. They are pasted at the points of the lattice, in the order
    in which the lattice grows from its middle: the earlier the corners of a texel are found, the earlier it is pasted.
    Each is drawn at random from the texels that differ from their neighbors in the shared zones by at most d_max; if
    there is none, the one that differs least is taken, as in patch-based synthesis (Liang et al. 2001). Zones are
    feathered. Last, a synthesized deformation moves the vertices of the output, and the same warp takes the texture
    along. Every pixel is read from the sample once, through all of these maps, by splines of order 5.

    Places are real-valued, so that nothing drifts, and the output keeps the sample's phase. A sample whose geometry
    does not depart (:mod:`~.geometry.straightening` has the rule) is not warped. If no lattice is given, ``consensus``
    finds one.

    The report leaves to the user what is automatic here: the vectors and the corners of texels. It leaves open the
    order of vertices found at the same time (rows), the breadth of the zone, and d_max, for which Liang et al. take
    ``tolerance=0.2``. As printed, equation 1 makes the lattice collapse;
    :func:`~.geometry.deformed_lattice.neighbor_field` says how it is read. With that reading, equation 3 shrinks the
    deformation to about 0.15 of the sample's amplitude. The settings of the report are
    ``texel=given,tolerance=0.2,deform=argmax,passes=1``.

    Parameters
    ----------
    texel
        Shape of the texels. ``"hexagon"`` and ``"quadrilateral"``: where the texels of the sample differ least along
        their borders; hexagons include bricks in running bond. ``"given"``: the parallelogram of the lattice's own two
        vectors, with its middle at the origin.
    zone
        Breadth in px of the zone that two texels share; at most the breadth of a texel. None: a sixth of s, from 3 to
        8 px.
    tolerance
        d_max over the root mean square of the texels' values along their borders, 0 to 1000. 0: always the texel that
        differs least.
    deform
        Deformation of the output. ``"normal"``: drawn at once from a normal distribution whose covariance is that of
        the sample's displacements. ``"argmax"``: each vertex takes its most likely place, given its eight neighbors
        (equation 3). ``"none"``: the output is regular.
    passes
        How often each level of the free-form deformation takes what is left between the vertices, 1 to 8. Once (Lee et
        al. 1997, the report's warp) leaves 1.5 to 2.5 times the error of 4 times.

    References
    ----------
    .. [1] Wen-Chieh Lin, James H. Hays, Chenyu Wu, Vivek Kwatra, Yanxi Liu. "A Comparison Study of Four Texture
           Synthesis Algorithms on Regular and Near-regular Textures." CMU-RI-TR-04-01, Robotics Institute, Carnegie
           Mellon University, 2004.
    """

    texel: TexelKind | Literal["given"] = "hexagon"
    zone: float | None = None
    tolerance: float = 0.05
    deform: Deform = "normal"
    passes: int = REPEATS

    reference: ClassVar[bool] = False
    uses_lattice: ClassVar[bool] = True
    finder: ClassVar[str] = "consensus"
    version: ClassVar[str] = "1"
    patch_shape: ClassVar[str] = "user identified lattice, quadrilateral patch"
    patch_placement: ClassVar[str] = "lattice points"
    patch_stitching: ClassVar[str] = "image-feathering"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {"texel": "given", "tolerance": 0.2, "deform": "argmax", "passes": 1}
    }
    paper: ClassVar[str] = """@techreport{lin2004comparison,
  author = {Lin, Wen-Chieh and Hays, James H. and Wu, Chenyu and Kwatra, Vivek and Liu, Yanxi},
  title = {A Comparison Study of Four Texture Synthesis Algorithms on Regular and Near-regular Textures},
  institution = {Robotics Institute, Carnegie Mellon University},
  number = {CMU-RI-TR-04-01},
  year = {2004}
}"""

    def __post_init__(self) -> None:
        require_ranges(self, zone=(0, np.inf), tolerance=(0, 1000), passes=(1, 8))

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis; see :class:`RegularizedPatch`.

        Raises
        ------
        Refused
            If no lattice is found, or if the sample does not show two periods or two whole texels.
        """
        lattice, seconds = require_lattice(task, NamedDetector(self.finder), "there are no texels; give a lattice")
        require_two_periods(lattice, task.sample.shape)
        straight = StraightSample.of(task.sample, lattice, self.passes)
        deform: Deform = self.deform if straight.departs else "none"
        bend = Bend.of(straight, task.shape, deform, task.rng)
        reader = TexelReader(straight)
        shape = self._texel_shape(straight, lattice)
        last = np.array(task.sample.shape[1::-1]) - 0.5
        stock = TexelStock.of(shape, (-last, 2 * last), reader.holds, reader.read)
        if len(stock.middles) < 2:
            height, width = task.sample.shape[:2]
            across, down = np.ptp(shape.pixels, axis=0)
            raise Refused(
                f"a texel with its zone takes {across:.0f}x{down:.0f} px, the sample is {width}x{height} px: it does "
                "not hold two of them; choose a larger sample or a narrower zone"
            )
        d_max = self.tolerance * math.sqrt(stock.power)
        mosaic = TexelMosaic.grow(stock, bend.extent, d_max, task.rng, task.progress)
        image, source = paint(bend, mosaic, reader)
        task.progress(1.0)
        extras = {"straightened": straight.image} if straight.departs else {}
        return Synthesis(image, lattice, source, extras, detection_seconds=seconds)

    def _texel_shape(self, straight: StraightSample, lattice: Lattice) -> TexelShape:
        if self.texel == "given":
            middles, corners = parallelogram(lattice)
        elif straight.departs:
            middles, corners = quiet_texels(straight.image, straight.lattice, self.texel)
            middles = middles.shifted(straight.corner)
        else:
            middles, corners = quiet_texels(straight.sample, lattice, self.texel)
        least, most = ZONE
        zone = min(max(lattice.s / 6, least), most) if self.zone is None else self.zone
        return TexelShape.of(middles, corners, zone)


class TexelReader:
    """Reads a sample at points of the straight plane.

    Parameters
    ----------
    straight
        The sample. If its geometry does not depart, the plane is the sample's own.
    """

    def __init__(self, straight: StraightSample) -> None:
        self.straight, self.patches = straight, Patches(straight.sample)

    def locate(self, points: Points) -> Points:
        """Return the places in the sample of points ``(..., 2)`` of the plane."""
        return self.straight.locate(points) if self.straight.departs else round_places(points)

    def holds(self, points: Points) -> NDArray[np.bool_]:
        """Return which points ``(..., 2)`` the sample shows."""
        at, size = self.locate(points), np.array(self.straight.sample.shape[1::-1])
        return np.asarray(((at >= -0.5) & (at <= size - 0.5)).all(-1))

    def read(self, points: Points) -> Image:
        """Return the values at points ``(..., 2)``, as ``(..., C)``."""
        return self.patches.read_points(self.locate(points))

    def trace(self, points: Points, weight: NDArray[np.float64]) -> tuple[Image, SourceMap]:
        """Return the values at points ``(n, 2)`` that are shown with a weight, and where they come from."""
        at = self.locate(points)
        if self.straight.departs:
            return self.patches.read_points(at), trace_points(at, self.straight.sample.shape, weight)
        image, source = self.patches.read_with_source(at[np.newaxis])
        source[..., 2] = np.maximum(source[..., 2] * weight, _LEAST_WEIGHT)
        return image[0], source[0]


def paint(bend: Bend, mosaic: TexelMosaic, reader: TexelReader) -> tuple[Image, SourceMap]:
    """Return the output, ``(H, W, C)``, and its source map: the weighted sum of the texels at each pixel."""
    (height, width), channels = bend.shape, reader.straight.sample.shape[2]
    image, source = np.zeros((height, width, channels), np.float32), np.zeros((height, width, 3), np.float32)
    rows = max(1, _BAND // width)
    for top in range(0, height, rows):
        pixels = pixel_grid(width, min(rows, height - top), top=top).astype(np.float64)
        values = image[top : top + rows].reshape(-1, channels)
        traced = source[top : top + rows].reshape(-1, 3)
        for seen, places, weight in mosaic.contributions(bend.locate(pixels).reshape(-1, 2)):
            shown, origin = reader.trace(places, weight)
            values[seen] += weight[:, np.newaxis].astype(np.float32) * shown
            larger = origin[:, 2] > traced[seen, 2]
            traced[seen[larger]] = origin[larger]
    return np.clip(image, 0, 1), source
