"""Speed of rsgf and the block-wise cheats, as multiples of the machine unit u.

Run it on one thread: ``OMP_NUM_THREADS=1 python benchmarks/rsgf.py``. The lattice is given, kernels are warm, every
figure is the median of seven.
"""

from __future__ import annotations

import numpy as np
from unit import machine_unit, median_seconds

from nrbench.datasets_procedural.brick import Brick
from nrbench.imaging.door import quantize
from nrbench.imaging.jit import load_kernels
from nrbench.synthesis import Synthesizer, Task
from nrbench.synthesizers.rsgf import Rsgf
from nrbench.synthesizers.scatter import Scatter
from nrbench.synthesizers.tiling import Tiling

METHODS: dict[str, Synthesizer] = {
    "rsgf": Rsgf(),
    "rsgf match=ncc": Rsgf(match="ncc"),
    "rsgf search=everywhere": Rsgf(search="everywhere"),
    "rsgf search=everywhere,match=ncc": Rsgf(search="everywhere", match="ncc"),
    "tiling": Tiling(),
    "scatter": Scatter(),
}


def seconds(method: Synthesizer, sample: int, output: int, repeats: int = 7) -> float:
    """Return the seconds that a method takes from a square brick sample to a square output of these sides."""
    texture = Brick().render((sample, sample), np.random.default_rng(0))
    pixels = quantize(texture.image)

    def synthesize() -> object:
        return method.synthesize(Task(pixels, (output, output), texture.lattice, np.random.default_rng(1)))

    return median_seconds(synthesize, repeats)


def main() -> None:
    """Print the tables."""
    load_kernels()
    u = machine_unit()
    print(f"u = {u * 1e3:.2f} ms")
    print("\n256 x 256 from 128 x 128")
    for name, method in METHODS.items():
        print(f"{name:34} {seconds(method, 128, 256) / u:8.1f} u")
    print("\nrsgf from 128 x 128: cost by output")
    for side in (256, 512, 1024, 2048, 4096):
        cost = seconds(Rsgf(), 128, side, 3) / u
        print(f"{side:5} x {side:<5} {cost:8.1f} u   {cost / side**2 * 256**2:6.2f} u per 256 x 256")
    print("\nrsgf to 256 x 256: cost by sample")
    for side in (96, 128, 256, 512):
        print(f"{side:5} x {side:<5} {seconds(Rsgf(), side, 256, 3) / u:8.1f} u")


if __name__ == "__main__":
    main()
