"""Speed of fftm-patch as multiples of the machine unit u, and what its refinements and its weight change.

Run it on one thread: ``OMP_NUM_THREADS=1 python benchmarks/fftm_patch.py [LARGEST SIDE]``. The mask is made beforehand,
kernels are warm, every figure is CPU time: the median of seven (larger outputs: three), each over a unit taken right
beside it, so that what else the machine does weighs on both.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import cache

import numpy as np
from unit import median_units

from nrbench.datasets_procedural.brick import Brick
from nrbench.imaging.convert import quantize
from nrbench.jit import load_kernels
from nrbench.plugins.forms import Task
from nrbench.synthesizers.fftm_patch import FftmPatch
from nrbench.synthesizers.masks.texture_mask import MaskParameters, TextureMask
from nrbench.synthesizers.patchwork.patchwork import Patchwork

PAPER = FftmPatch(weight=1.0, patch=40, overlap=0.5, reach=0.0, normalized=False)
METHODS = {
    "fftm-patch": FftmPatch(),
    "fftm-patch refinements=0": FftmPatch(refinements=0),
    "fftm-patch refinements=4": FftmPatch(refinements=4),
    "fftm-patch seam=color": FftmPatch(seam="color"),
    "fftm-patch reach=0": FftmPatch(reach=0.0),
    "fftm-patch normalized=false": FftmPatch(normalized=False),
    "fftm-patch patch=24": FftmPatch(patch=24),
    "fftm-patch patch=64": FftmPatch(patch=64),
    "fftm-patch overlap=0.5": FftmPatch(overlap=0.5),
    "fftm-patch as the paper": PAPER,
}


@cache
def textured(side: int) -> tuple[Task, TextureMask]:
    """Return a task of a square brick sample, and the sample's mask."""
    texture = Brick().render((side, side), np.random.default_rng(0))
    sample = quantize(texture.image)
    return Task(sample, (256, 256), texture.lattice, np.random.default_rng(1)), MaskParameters().find_mask(sample)


def made(method: FftmPatch, sample: int, output: int) -> Patchwork:
    """Return an output of this side from a sample of this side."""
    task, mask = textured(sample)
    shape = (output, output)
    return method.lay_patches(replace(task, shape=shape, rng=np.random.default_rng(1)), mask, mask.draw(shape))


def units(method: FftmPatch, sample: int, output: int, repeats: int = 7) -> float:
    """Return the units that it takes."""
    textured(sample)
    return median_units(lambda: made(method, sample, output), repeats)


def quality(method: FftmPatch) -> tuple[float, float]:
    """Return what all seams cost, gray levels a pixel, and how far the output is from its mask, gray levels."""
    work = made(method, 128, 256)
    apart = work.result()[0] - textured(128)[1].draw((256, 256))
    return work.cost / 256**2, 255 * float(np.sqrt((apart**2).mean()))


def main() -> None:
    """Print the tables."""
    load_kernels()
    largest = int(sys.argv[1]) if len(sys.argv) > 1 else 1024
    print("256 x 256 from 128 x 128")
    for name, method in METHODS.items():
        print(f"{name:40} {units(method, 128, 256):8.1f} u", flush=True)
    print("\nfrom 128 x 128: cost by output")
    for side in (128, 256, 512, 1024, 2048):
        if side <= largest:
            cost = units(FftmPatch(), 128, side, 3)
            print(f"{side:5} x {side:<5} {cost:8.1f} u   {cost / side**2 * 256**2:7.2f} u per 256 x 256", flush=True)
    print("\nto 256 x 256: cost by sample")
    for side in (64, 128, 256):
        print(f"{side:5} x {side:<5} {units(FftmPatch(), side, 256, 3):8.1f} u", flush=True)
    print("\nseams, gray levels a pixel; distance to the mask, gray levels")
    for change in ("refinements", "weight"):
        for value in (0, 1, 2, 4, 8):
            cost, apart = quality(replace(FftmPatch(), **{change: value}))
            print(f"{change:12} {value:3} {cost:8.3f} {apart:8.2f}", flush=True)


if __name__ == "__main__":
    main()
