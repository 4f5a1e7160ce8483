"""Samples and tasks that the tests of methods share."""

import math

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Synthesis, Synthesizer, Task

TURNED = math.radians(7)
FRACTIONAL = Lattice(
    (21.37 * math.cos(TURNED), 21.37 * math.sin(TURNED)), (-18.81 * math.sin(TURNED), 18.81 * math.cos(TURNED))
)

OBLIQUE = Lattice((21.37, 2.6), (-2.3, 18.81))
UPRIGHT = Lattice((21.37, 0), (0, 18.81))
BOND = Lattice((27.3, 0), (13.65, 12.2))


def noise(height: int, width: int, channels: int = 3, seed: int = 0) -> Image:
    """Return noise of 8 bits."""
    return quantize(np.random.default_rng(seed).random((height, width, channels), np.float32))


def waves(shape: tuple[int, int], lattice: Lattice) -> Image:
    """Return a smooth image of three channels that has exactly this lattice."""
    y, x = np.indices(shape)
    u, v = np.moveaxis(lattice.to_cell(np.stack([x, y], -1)), -1, 0)
    first, second = np.cos(2 * math.pi * u), np.cos(2 * math.pi * (v + 0.1))
    third = np.cos(2 * math.pi * (u + 2 * v + 0.3))
    return np.stack([0.5 + 0.2 * first + 0.2 * second, 0.5 + 0.3 * third, 0.5 + 0.4 * first * second], -1).astype("f4")


def synthesize(
    method: Synthesizer, sample: Image, shape: tuple[int, int], lattice: Lattice | None = None, seed: int = 1
) -> Synthesis:
    """Run a method."""
    return method.synthesize(Task(sample, shape, lattice, np.random.default_rng(seed)))


def places(made: Synthesis, block: int) -> NDArray[np.int64]:
    """Read the (x, y) in the sample of every block's first pixel off the source map at the blocks' middles."""
    assert made.source is not None
    middle = made.source[block // 2 :: block, block // 2 :: block]
    assert (middle[..., 2] == 1).all()
    return np.asarray(middle[..., :2], np.int64) - block // 2
