"""Images with holes: holes that repeat, as those of a fence, are a part of the texture."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy

from nrbench.imaging.convert import Image
from nrbench.imaging.masks import Mask
from nrbench.plugins.forms import NoLatticeFound

FEWEST = 9
"""Least number of holes, or of cells of their lattice, that are a texture. Four windows of a facade are none."""
CONFIDENT = 0.5
"""Least confidence in the lattice of the holes."""


def join_holes(detector: Any, image: Image, known: Mask | None) -> tuple[Image, Mask | None]:
    """Return an image and the pixels that count, for the search of a lattice.

    Holes that repeat by themselves become a further channel. All pixels then count; those of the holes have the mean
    color of the others. The mask of other holes stays as it is.

    Parameters
    ----------
    detector
        Tells whether the holes repeat.
    image, known
        The image, and which of its pixels count; None: all.
    """
    if known is None or max(scipy.ndimage.label(part)[1] for part in (known, ~known)) < FEWEST:
        return image, known
    holes = known[..., np.newaxis].astype(np.float32)
    try:
        found = detector.detect(holes)
    except NoLatticeFound:
        return image, known
    if found.confidence < CONFIDENT or FEWEST * found.lattice.area > known.size:
        return image, known
    colors = np.where(known[..., np.newaxis], image, image[known].mean(0))
    return np.concatenate([colors, holes], -1).astype(np.float32), None
