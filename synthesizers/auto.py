"""The method that fits the regularity of the sample."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np

from nrbench.errors import require_ranges
from nrbench.imaging.convert import Image
from nrbench.imaging.light import describe_light, estimate_light
from nrbench.imaging.mean_tile import explained_share
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Geometry, Refused, Synthesis, Synthesizer, Task, find_lattice
from nrbench.plugins.registry import NamedDetector

from .ann_pixel import AnnPixel
from .gap_filling.holes import leaves_out
from .lattice_places.equal_places import shows_two_periods, warn_of_no_lattice
from .rsgf import Rsgf
from .tile_set import TileSet


@leaves_out
@dataclass(frozen=True)
class Auto:
    """Measure the regularity of the sample, and pick the method by it (Liu, Tsin and Lin 2005, section 4.1).

    The paper suggests a classifier F of texture regularity: above a threshold its own method is used, otherwise a
    method that compares local neighborhoods. It leaves F and the threshold open. Here F is the estimated regular share
    of the sample on its lattice (:func:`estimate_regular_share`), and 0 if there is no lattice or the sample shows less
    than two of its periods. The lattice is the given one, or that of the detector ``consensus``, which rejects lattices
    that chance explains. The note says F and the method that was picked. If that one
    refuses the sample, the next of ``rsgf``, ``tile-set`` and ``ann-pixel`` is tried, and the note says why.

    The threshold was set on walls and cloths, where lattices that are found exactly have F of 0.13 and more (color 1,
    noise 0.25), and on noise, which has no lattice. On hexagons of the same departures F is 0.11 and more.

    ``preset=paper`` picks the paper's tile set, and the neighborhoods of Wei and Levoy where F is low.

    Parameters
    ----------
    threshold
        Least F of a near-regular texture, in [0, 1].
    regular
        The method for near-regular textures: ``"rsgf"``, which breaks fewer elements, ``"tile-set"``, or
        ``"tile-set:preset=paper"``.
    other
        The method for all other textures: ``"rsgf"`` in its stochastic mode, or ``"ann-pixel"``.
    geometry
        How the method is run where the sample is bent (:func:`~nrbench.calling.bent_samples.synthesize_in_geometry`).
        It gets the straightened sample, and its output is ``"bent"`` as the sample is, or left ``"straight"``;
        ``"waves"``: bent if the sample waves, straight if it is in perspective, round or distorted by a lens.
        ``"argmax"``: bent so that each vertex takes its most likely place, given its eight neighbors (equation 3 of Lin
        and others 2004), with warps of one pass. ``"as-is"``: it gets the sample itself.

    References
    ----------
    .. [1] Yanxi Liu, Yanghai Tsin, Wen-Chieh Lin. "The Promise and Perils of Near-Regular Texture." International
           Journal of Computer Vision 62(1-2):145-159, 2005.
    """

    threshold: float = 0.1
    regular: Literal["rsgf", "tile-set", "tile-set:preset=paper"] = "rsgf"
    other: Literal["rsgf", "ann-pixel"] = "rsgf"
    geometry: Geometry = "waves"

    wraps: ClassVar[bool] = True
    finder: ClassVar[str] = "consensus"
    needs_lattice: ClassVar[bool] = False
    family: ClassVar[str] = "choice by the sample"
    maps: ClassVar[str] = "source"
    version: ClassVar[str] = "2"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {"threshold": 0.1, "regular": "tile-set:preset=paper", "other": "ann-pixel", "geometry": "as-is"}
    }
    paper: ClassVar[str] = TileSet.paper

    def __post_init__(self) -> None:
        require_ranges(self, threshold=(0, 1))

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis of the method that is picked; see :class:`Auto`.

        Raises
        ------
        Refused
            If the method that is picked refuses the sample, and all others of the list, too.
        """
        found = find_lattice(task, NamedDetector(self.finder))
        share = estimate_regular_share(task.sample, found.lattice) if found.lattice else 0.0
        near_regular = found.lattice is not None and share >= self.threshold
        name = self.regular if near_regular else self.other
        methods: dict[str, Synthesizer] = {
            "rsgf": Rsgf() if near_regular else Rsgf(search="stochastic"),
            "tile-set": TileSet(),
            "tile-set:preset=paper": TileSet(**TileSet.presets["paper"]),
            "ann-pixel": AnnPixel(),
        }
        if found.lattice is None:
            warn_of_no_lattice("auto", found.reason)
        light = (
            describe_light(estimate_light(task.sample, found.lattice, task.known, edges=False)) if found.lattice else ""
        )
        remarks = f"; {light}, which --flatten-light divides out" if light else ""
        seen = f"regularity {share:.2f}" if found.lattice else f"no lattice ({found.reason})"
        names = list(dict.fromkeys([name, *(("rsgf", "tile-set") if near_regular else ()), "ann-pixel"]))
        for name in names:
            given = found.lattice if near_regular and name != "ann-pixel" else None
            try:
                made = methods[name].synthesize(replace(task, lattice=given))
                break
            except Refused as refused:
                remarks += f"; {name} refused: {refused}"
                if name == names[-1]:
                    raise
        note = f"picked {name}: {seen}{remarks}" + (f"; {made.note}" if made.note else "")
        return replace(made, detection_seconds=found.seconds, note=note)


def estimate_regular_share(sample: Image, lattice: Lattice) -> float:
    """Return the share of a sample's variance that repeats on a lattice, in [0, 1]: an estimate of its regular share.

    The mean tile of n cells explains 1/n of any variance; the estimate corrects for this. It is 0 if the sample shows
    less than two periods.
    """
    height, width, _ = sample.shape
    if np.ptp(sample) == 0 or not shows_two_periods(lattice, (height, width)):
        return 0.0
    cells = max(height * width / lattice.area, 2.0)
    return float(min(max(1 - (1 - explained_share(sample, lattice)) * cells / (cells - 1), 0.0), 1.0))
