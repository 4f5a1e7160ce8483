"""Regularized patch-based synthesis: texels of the sample, pasted on its lattice."""

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
from nrbench.plugins.forms import Geometry, Refused, Shape, SourceMap, Synthesis, Task, require_lattice
from nrbench.plugins.registry import NamedDetector

from .sampling.cell_torus import CellTorus
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

    Where the sample is bent, its lattice is tracked, where the report lets a user move its vertices. Multilevel
    free-form deformation, from the regular vertices to the tracked ones, straightens the sample, and the output is bent
    by a synthesized deformation (parameter ``geometry``). The texels of the straight sample, each a cell of the
    lattice with a zone around it, are the only candidates. They are pasted at the points of the lattice, in the order
    in which the lattice grows from its middle: the earlier the corners of a texel are found, the earlier it is pasted.
    Each is drawn at random from the texels that differ from their neighbors in the shared zones by at most d_max; if
    there is none, the one that differs least is taken, as in patch-based synthesis (Liang et al. 2001). Zones are
    feathered.

    Places are real-valued, so that nothing drifts, and the output keeps the sample's phase. If no lattice is given,
    ``consensus`` finds one.

    The report leaves to the user what is automatic here: the vectors and the corners of texels. It leaves open the
    order of vertices found at the same time (rows), the breadth of the zone, and d_max, for which Liang et al. take
    ``tolerance=0.2``. As printed, equation 1 makes the lattice collapse;
    :func:`~nrbench.displacement.random_field.neighbor_field` says how it is read. With that reading, equation 3
    shrinks the deformation to about 0.15 of the sample's amplitude. The settings of the report are
    ``texel=given,tolerance=0.2,geometry=argmax``.

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
    geometry
        How the method is run where the sample is bent (:func:`~nrbench.calling.bent_samples.synthesize_in_geometry`).
        It gets the straightened sample, and its output is ``"bent"`` as the sample is, or left ``"straight"``.
        ``"argmax"``: bent so that each vertex takes its most likely place, given its eight neighbors (equation 3 of Lin
        and others 2004), with warps of one pass. ``"as-is"``: it gets the sample itself.

    References
    ----------
    .. [1] Wen-Chieh Lin, James H. Hays, Chenyu Wu, Vivek Kwatra, Yanxi Liu. "A Comparison Study of Four Texture
           Synthesis Algorithms on Regular and Near-regular Textures." CMU-RI-TR-04-01, Robotics Institute, Carnegie
           Mellon University, 2004.
    """

    texel: TexelKind | Literal["given"] = "hexagon"
    zone: float | None = None
    tolerance: float = 0.05
    geometry: Geometry = "bent"

    wraps: ClassVar[bool] = True
    reference: ClassVar[bool] = False
    uses_lattice: ClassVar[bool] = True
    finder: ClassVar[str] = "consensus"
    family: ClassVar[str] = "tiles and patches on the lattice"
    version: ClassVar[str] = "1"
    patch_shape: ClassVar[str] = "user identified lattice, quadrilateral patch"
    patch_placement: ClassVar[str] = "lattice points"
    patch_stitching: ClassVar[str] = "image-feathering"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {"texel": "given", "tolerance": 0.2, "geometry": "argmax"}
    }
    paper: ClassVar[str] = """@techreport{lin2004comparison,
  author = {Lin, Wen-Chieh and Hays, James H. and Wu, Chenyu and Kwatra, Vivek and Liu, Yanxi},
  title = {A Comparison Study of Four Texture Synthesis Algorithms on Regular and Near-regular Textures},
  institution = {Robotics Institute, Carnegie Mellon University},
  number = {CMU-RI-TR-04-01},
  year = {2004}
}"""

    def __post_init__(self) -> None:
        require_ranges(self, zone=(0, np.inf), tolerance=(0, 1000))

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis; see :class:`RegularizedPatch`.

        Raises
        ------
        Refused
            If no lattice is found, or if the sample does not show two periods or two whole texels.
        """
        lattice, seconds = require_lattice(task, NamedDetector(self.finder), "there are no texels; give a lattice")
        require_two_periods(lattice, task.sample.shape)
        reader = TexelReader(task.sample)
        shape = self._texel_shape(task.sample, lattice)
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
        extent = np.zeros(2), np.array(task.shape[::-1]) - 1.0
        torus = CellTorus.closing(shape.lattice, task.shape) if task.tileable else None
        mosaic = TexelMosaic.grow(stock, extent, d_max, task.rng, task.progress, torus)
        image, source = paint(task.shape, mosaic, reader)
        task.progress(1.0)
        return Synthesis(image, lattice, source, detection_seconds=seconds)

    def _texel_shape(self, sample: Image, lattice: Lattice) -> TexelShape:
        if self.texel == "given":
            middles, corners = parallelogram(lattice)
        else:
            middles, corners = quiet_texels(sample, lattice, self.texel)
        least, most = ZONE
        zone = min(max(lattice.s / 6, least), most) if self.zone is None else self.zone
        return TexelShape.of(middles, corners, zone)


class TexelReader:
    """Reads a sample at points of its plane, rounded to 1/64 px.

    Parameters
    ----------
    sample
        ``(H, W, C)``.
    """

    def __init__(self, sample: Image) -> None:
        self.sample, self.patches = sample, Patches(sample)

    def holds(self, points: Points) -> NDArray[np.bool_]:
        """Return which points ``(..., 2)`` the sample shows."""
        at, size = round_places(points), np.array(self.sample.shape[1::-1])
        return np.asarray(((at >= -0.5) & (at <= size - 0.5)).all(-1))

    def read(self, points: Points) -> Image:
        """Return the values at points ``(..., 2)``, as ``(..., C)``."""
        return self.patches.read_points(round_places(points))

    def trace(self, points: Points, weight: NDArray[np.float64]) -> tuple[Image, SourceMap]:
        """Return the values at points ``(n, 2)`` that are shown with a weight, and where they come from."""
        image, source = self.patches.read_with_source(round_places(points)[np.newaxis])
        source[..., 2] = np.maximum(source[..., 2] * weight, _LEAST_WEIGHT)
        return image[0], source[0]


def paint(size: Shape, mosaic: TexelMosaic, reader: TexelReader) -> tuple[Image, SourceMap]:
    """Return the output, ``(H, W, C)``, and its source map: the weighted sum of the texels at each pixel."""
    (height, width), channels = size, reader.sample.shape[2]
    image, source = np.zeros((height, width, channels), np.float32), np.zeros((height, width, 3), np.float32)
    rows = max(1, _BAND // width)
    for top in range(0, height, rows):
        pixels = pixel_grid(width, min(rows, height - top), top=top).astype(np.float64)
        values = image[top : top + rows].reshape(-1, channels)
        traced = source[top : top + rows].reshape(-1, 3)
        for seen, places, weight in mosaic.contributions(pixels.reshape(-1, 2)):
            shown, origin = reader.trace(places, weight)
            values[seen] += weight[:, np.newaxis].astype(np.float32) * shown
            larger = origin[:, 2] > traced[seen, 2]
            traced[seen[larger]] = origin[larger]
    return np.clip(image, 0, 1), source
