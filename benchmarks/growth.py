"""How cost and memory of the methods grow with the output, up to 4096 x 4096 px: both should be linear.

``OMP_NUM_THREADS=1 python benchmarks/growth.py [LARGEST SIDE [METHOD...]]``: brick from 128 x 128 px, the lattice
given, kernels warm. Each figure is one synthesis in a process of its own: CPU time over a unit taken right before it,
and by how much the process grew, of which the output and its source map are 24 bytes a pixel; 0 where it had room.
"""

from __future__ import annotations

import multiprocessing
import resource
import sys
import time

import numpy as np
from unit import cpu_unit

from nrbench.datasets_procedural.brick import Brick
from nrbench.imaging.convert import quantize
from nrbench.jit import load_kernels
from nrbench.plugins.forms import Synthesizer, Task
from nrbench.synthesizers.representative_tile import RepresentativeTile
from nrbench.synthesizers.rsgf import Rsgf
from nrbench.synthesizers.tile_set import TileSet
from nrbench.synthesizers.tiling import Tiling

METHODS: dict[str, Synthesizer] = {
    "tile-set": TileSet(),
    "rsgf": Rsgf(),
    "tiling": Tiling(),
    "representative-tile": RepresentativeTile(),
}
SIDES = (256, 512, 1024, 2048, 4096)


def memory() -> int:
    """Return the most bytes that this process has held so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def cost(name: str, side: int) -> tuple[float, float]:
    """Return what one synthesis takes: CPU time in u, and bytes for each output pixel."""
    texture = Brick().render((128, 128), np.random.default_rng(0))
    sample, method = quantize(texture.image), METHODS[name]
    method.synthesize(Task(sample, (64, 64), texture.lattice, np.random.default_rng(1)))
    u, held, start = cpu_unit(), memory(), time.process_time()
    method.synthesize(Task(sample, (side, side), texture.lattice, np.random.default_rng(1)))
    return (time.process_time() - start) / u, (memory() - held) / side**2


def main() -> None:
    """Print a table for each method."""
    load_kernels()
    largest = int(sys.argv[1]) if len(sys.argv) > 1 else SIDES[-1]
    for name in sys.argv[2:] or METHODS:
        print(f"\n{name}")
        for side in (side for side in SIDES if side <= largest):
            with multiprocessing.get_context("fork").Pool(1) as pool:
                units, held = pool.apply(cost, (name, side))
            each = units / side**2 * 256**2
            print(
                f"{side:5} x {side:<5} {units:9.1f} u  {each:7.2f} u per 256 x 256  {held:7.0f} bytes a pixel",
                flush=True,
            )


if __name__ == "__main__":
    main()
