"""Stochastic textures: colored noise, without a lattice."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.errors import require_ranges
from nrbench.plugins.forms import Shape, Texture

from .modelling.model import LARGEST_SIZE, check_choices, check_degrees, check_shape
from .modelling.pattern import hue_rotation
from .modelling.random_fields import hash_bits, role_seed

_MEAN = np.array([0.50, 0.46, 0.40])
_TINTS = np.array([(1.0, 0.94, 0.86), (0.5, 0.0, -0.6)]) / 1.1


@dataclass(frozen=True)
class Noise:
    """Noise of a given spectrum, nearly Gaussian: a stochastic texture, without a lattice.

    Its kind is ``"stochastic"``, its regular share 0 and its lattice None. Its ideal image, the mean over draws, has
    one color. ``again`` is an independent draw.

    Parameters
    ----------
    spectrum
        ``"white"``: equal power at all wave lengths above 2 px; ``"pink"``, ``"brown"``: power falls with frequency, as
        1 / f or 1 / f^2, and is constant for waves longer than 4 scales; ``"blobs"``: waves about ``scale`` long, in
        all directions; ``"grass"``: the same, stretched by a factor of 4 along y.
    scale
        Length of the waves in px, at least 3.
    contrast
        Standard deviation of the brightness, from 0 to 0.3.
    rotation
        Degrees by which the texture is turned, from x towards y (clockwise on the screen).
    hue
        Degrees by which all colors are turned around the gray axis.
    """

    spectrum: Literal["white", "pink", "brown", "blobs", "grass"] = "pink"
    scale: float = 12.0
    contrast: float = 0.12
    rotation: float = 0.0
    hue: float = 0.0

    procedural: ClassVar[bool] = True
    version: ClassVar[str] = "1"

    def __post_init__(self) -> None:
        check_choices(self)
        require_ranges(self, scale=(3, LARGEST_SIZE), contrast=(0, 0.3))
        check_degrees(self, "rotation", "hue")

    def render(self, shape: Shape, rng: np.random.Generator) -> Texture:
        """Return a texture of ``shape``."""
        check_shape(shape)
        seed = int(rng.integers(2**63))
        color = np.clip(_MEAN @ hue_rotation(self.hue).T, 0, 1)
        tints = _TINTS @ hue_rotation(self.hue).T
        fields = np.stack([self._field(role_seed(seed, name), shape) for name in ("bright", "tint")], -1)
        image = np.asarray(color + self.contrast * (fields * (1.0, 0.35)) @ tints, np.float32)
        return Texture(
            image=np.clip(image, 0, 1),
            name="noise",
            family="noise",
            kind="stochastic",
            ideal=np.broadcast_to(color.astype(np.float32), image.shape).copy(),
            regular_share=0.0,
        )

    def again(self, texture: Texture, shape: Shape, rng: np.random.Generator) -> Texture:
        """Return an independent draw."""
        return self.render(shape, rng)

    def _field(self, seed: int, shape: Shape) -> NDArray[np.float64]:
        """Return noise of mean 0 and variance 1: white noise, filtered on a torus larger than the picture."""
        margin = math.ceil(4 * self.scale)
        rows, columns = (scipy.fft.next_fast_len(side + margin) for side in shape)
        words = hash_bits(seed, np.arange(rows)[:, np.newaxis], np.arange(columns)).view(np.uint16)
        white = words.reshape(rows, columns, 4).sum(-1, dtype=np.float64) / 65535 - 2
        gain = np.sqrt(self._power(scipy.fft.rfftfreq(columns), scipy.fft.fftfreq(rows)[:, np.newaxis]))
        twice = np.where((np.arange(gain.shape[1]) == 0) | (2 * np.arange(gain.shape[1]) == columns), 1, 2)
        gain /= np.sqrt((gain**2 * twice).sum() / (rows * columns) / 3)
        return np.asarray(scipy.fft.irfft2(scipy.fft.rfft2(white) * gain, (rows, columns))[: shape[0], : shape[1]])

    def _power(self, fx: NDArray[np.float64], fy: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the power of waves of (fx, fy) cycles a px."""
        angle = math.radians(self.rotation)
        along, across = fx * math.cos(angle) + fy * math.sin(angle), fy * math.cos(angle) - fx * math.sin(angle)
        across = across * (4 if self.spectrum == "grass" else 1)
        f = np.hypot(along, across)
        if self.spectrum == "white":
            return np.asarray(np.exp(-((f / 0.4) ** 4)))
        if self.spectrum in ("blobs", "grass"):
            return np.asarray(np.exp(-(((f * self.scale - 1) / 0.35) ** 2) / 2))
        slope = 1 if self.spectrum == "pink" else 2
        return np.asarray((f**2 + (0.25 / self.scale) ** 2) ** (-slope / 2) * (f > 0))
