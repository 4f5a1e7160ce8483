"""Speed of rsgf and the block-wise cheats, as multiples of the machine unit u.

Run it on one thread: ``OMP_NUM_THREADS=1 python benchmarks/rsgf.py [LARGEST SIDE]``. The lattice is given, kernels are
warm, every figure is CPU time: the median of seven, each over a unit taken right beside it, so that what else the
machine does weighs on both.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
from unit import median_units

from nrbench.datasets_procedural.brick import Brick
from nrbench.imaging.convert import quantize
from nrbench.jit import load_kernels
from nrbench.plugins.forms import Synthesizer, Task
from nrbench.synthesizers.rsgf import Rsgf
from nrbench.synthesizers.scatter import Scatter
from nrbench.synthesizers.tiling import Tiling

PAPER = Rsgf(seam="blend", subpixel=False, tolerance=3.0, among=0.0, spread=False)
METHODS: dict[str, Synthesizer] = {
    "rsgf": Rsgf(),
    "rsgf seam=dynamic": Rsgf(seam="dynamic"),
    "rsgf seam=blend": Rsgf(seam="blend"),
    "rsgf subpixel=false": Rsgf(subpixel=False),
    "rsgf deform=1.5": Rsgf(deform=1.5),
    "rsgf as the paper": PAPER,
    "rsgf as the paper, match=ncc": replace(PAPER, match="ncc"),
    "rsgf as the paper, search=everywhere": replace(PAPER, search="everywhere", tolerance=None, among=None),
    "rsgf as the paper, both": replace(PAPER, search="everywhere", tolerance=None, among=None, match="ncc"),
    "tiling": Tiling(),
    "tiling tile=mean": Tiling(tile="mean"),
    "scatter": Scatter(),
}


def units(method: Synthesizer, sample: int, output: int, repeats: int = 7) -> float:
    """Return the units that a method takes from a square brick sample to a square output of these sides."""
    texture = Brick().render((sample, sample), np.random.default_rng(0))
    pixels = quantize(texture.image)

    def synthesize() -> object:
        return method.synthesize(Task(pixels, (output, output), texture.lattice, np.random.default_rng(1)))

    return median_units(synthesize, repeats)


def main() -> None:
    """Print the tables."""
    load_kernels()
    largest = int(sys.argv[1]) if len(sys.argv) > 1 else 4096
    print("256 x 256 from 128 x 128")
    for name, method in METHODS.items():
        print(f"{name:38} {units(method, 128, 256):8.1f} u", flush=True)
    print("\nrsgf from 128 x 128: cost by output")
    for side in (256, 512, 1024, 2048, 4096):
        if side <= largest:
            cost = units(Rsgf(), 128, side, 3)
            print(f"{side:5} x {side:<5} {cost:8.1f} u   {cost / side**2 * 256**2:6.2f} u per 256 x 256", flush=True)
    print("\nrsgf to 256 x 256: cost by sample")
    for side in (96, 128, 256, 512):
        print(f"{side:5} x {side:<5} {units(Rsgf(), side, 256, 3):8.1f} u", flush=True)


if __name__ == "__main__":
    main()
