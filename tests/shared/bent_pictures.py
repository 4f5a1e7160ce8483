"""Textures that are bent, and planes in perspective."""

from dataclasses import replace

import numpy as np

import nrbench
from nrbench.displacement.deformation_field import map_points, pixel_places
from nrbench.imaging.convert import quantize
from nrbench.imaging.mean_tile import interpolate
from nrbench.plugins.forms import Texture

TILT = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.2e-3, 6e-4, 1.0]])
"""A homography from the picture to the plane."""


def bent(model: str = "brick", bend: float = 0.5, seed: int = 0, side: int = 192, **departures: float) -> Texture:
    """Return a texture with rounded pixels."""
    texture = nrbench.texture(model, shape=(side, side), seed=seed, bend=bend, **departures)
    return replace(texture, image=quantize(texture.image))


def tilted(side: int, seed: int = 0, homography: np.ndarray = TILT) -> Texture:
    """Return a weave in perspective, with its lattice on the plane."""
    drawn = nrbench.texture("weave", shape=(side, side), seed=seed)
    seen = interpolate(drawn.image, map_points(homography, pixel_places(side, side)))
    return Texture(quantize(seen), drawn.lattice)
