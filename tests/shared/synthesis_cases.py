"""Samples and tasks that the tests of methods share."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from skimage.color import rgb2ypbpr
from turned_lattices import turned

from nrbench import plugins
from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Synthesis, Synthesizer, Task
from nrbench.plugins.parameters import parse_spec
from nrbench.spectra.harmonics import WaveAnalysis
from nrbench.synthesizers.masks.texture_mask import TextureMask

OBLIQUE = Lattice((21.37, 2.6), (-2.3, 18.81))
UPRIGHT = Lattice((21.37, 0), (0, 18.81))
FRACTIONAL = turned(UPRIGHT, 7)
BOND = Lattice((27.3, 0), (13.65, 12.2))
WHOLE = [Lattice((30, 0), (0, 24)), Lattice((15, 12), (15, -12)), Lattice((20, 5), (-4, 22)), Lattice((24, 0), (0, 24))]
"""Lattices of whole pixels."""


def noise(height: int, width: int, channels: int = 3, seed: int = 0) -> Image:
    """Return noise of 8 bits."""
    return quantize(np.random.default_rng(seed).random((height, width, channels), np.float32))


def smooth(height: int, width: int, channels: int = 3, seed: int = 0) -> Image:
    """Return a smooth tile: periodic noise without high frequencies."""
    spectrum = np.fft.fft2(np.random.default_rng(seed).random((height, width, channels)), axes=(0, 1))
    low = np.abs(np.fft.fftfreq(height)[:, None]) + np.abs(np.fft.fftfreq(width)) < 0.2
    tile = np.fft.ifft2(spectrum * low[..., None], axes=(0, 1)).real
    return ((tile - tile.min()) / np.ptp(tile)).astype(np.float32)


def waves(shape: tuple[int, int], lattice: Lattice) -> Image:
    """Return a smooth image of three channels that has exactly this lattice."""
    y, x = np.indices(shape)
    u, v = np.moveaxis(lattice.to_cell(np.stack([x, y], -1)), -1, 0)
    first, second = np.cos(2 * math.pi * u), np.cos(2 * math.pi * (v + 0.1))
    third = np.cos(2 * math.pi * (u + 2 * v + 0.3))
    return np.stack([0.5 + 0.2 * first + 0.2 * second, 0.5 + 0.3 * third, 0.5 + 0.4 * first * second], -1).astype("f4")


def build(spec: str) -> Any:
    """Return a method with its parameters."""
    return plugins.build("synthesizers", *parse_spec(spec))


def synthesize(
    method: Synthesizer, sample: Image, shape: tuple[int, int], lattice: Lattice | None = None, seed: int = 1
) -> Synthesis:
    """Run a method."""
    return method.synthesize(Task(sample, shape, lattice, np.random.default_rng(seed)))


def mask_of(tile: Image, stretch: float = 1.0) -> TextureMask:
    """Return the exact mask of a repeated tile with odd sides, stretched about (0, 0)."""
    height, width, channels = tile.shape
    planes = rgb2ypbpr(tile.astype(np.float64)) if channels == 3 else tile.astype(np.float64)
    waves = np.fft.fft2(planes, axes=(0, 1)) / (height * width)
    v, u = (np.rint(np.fft.fftfreq(n) * n).astype(int) for n in (height, width))
    orders = np.array([(i, j) for j in v for i in u if i > 0 or (i == 0 and j > 0)])
    chosen = 2 * waves[orders[:, 1], orders[:, 0]]
    fundamentals = np.diag([1 / (width * stretch), 1 / (height * stretch)])
    mean = waves[0, 0].real
    return TextureMask(
        WaveAnalysis(orders @ fundamentals, chosen.real, -chosen.imag, mean, fundamentals, orders, (2,), 1.0)
    )


def places(made: Synthesis, block: int) -> NDArray[np.int64]:
    """Read the (x, y) in the sample of every block's first pixel off the source map at the blocks' middles."""
    middle = made.source[block // 2 :: block, block // 2 :: block]
    assert (middle[..., 2] == 1).all()
    return np.asarray(middle[..., :2], np.int64) - block // 2
