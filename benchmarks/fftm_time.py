"""What a pixel of `fftm-pixel` costs, with and without principal components (table 2 of its paper).

    python benchmarks/fftm_time.py [--sides 128 239] [--repeats 3]

The paper times the tree search for two textiles, on a Pentium 4 of 2.4 GHz. Here a woven cloth of the same size stands
for each, and the time is that of the whole synthesis under a known mask, over the pixels of an output as large as the
sample. The method is ``fftm-pixel:preset=paper``, without principal components ``dimensions=0``.
"""

import time

import numpy as np
from studies import read_options

from nrbench import texture
from nrbench.imaging.convert import quantize
from nrbench.plugins.forms import Task
from nrbench.synthesizers.fftm_pixel import FftmPixel

PAPER = {
    128: {2: (160, 70), 3: (420, 120), 4: (900, 210), 5: (1650, 370)},
    239: {2: (420, 100), 3: (1440, 140), 4: (3220, 210), 5: (None, 300)},
}
"""Microseconds per output pixel, without and with components, by the sides of the sample and of the neighborhood."""


def measure_pixel(side: int, neighborhood: int, dimensions: int, repeats: int) -> float:
    """Return the CPU time of an output pixel, microseconds: the least of some syntheses, after one that warms up."""
    sample = quantize(texture("weave", (side, side), seed=1, color=0.3, noise=0.05).image)
    preset = {**FftmPixel.presets["paper"], "neighborhood": neighborhood, "dimensions": dimensions}
    method, seconds = FftmPixel(**preset), []
    mask = method.find_mask(sample)
    for _ in range(repeats + 1):
        start = time.process_time()
        method.synthesize_with_mask(Task(sample, (side, side), None, np.random.default_rng(0)), mask)
        seconds.append(time.process_time() - start)
    return 1e6 * min(seconds[1:]) / side**2


def main() -> None:
    """Print the table."""
    options = read_options(__doc__, choices={"sides": PAPER}, sides=list(PAPER), repeats=3)
    print("| sample | neighborhood | all values | 16 components | ratio | paper: all values | 16 components | ratio |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for side in options.sides:
        for size, (plain, reduced) in PAPER[side].items():
            ours = [measure_pixel(side, size, count, options.repeats) for count in (0, 16)]
            published = ("-", "-") if plain is None else (f"{plain}", f"{plain / reduced:.1f}")
            cells = (f"{ours[0]:.1f}", f"{ours[1]:.1f}", f"{ours[0] / ours[1]:.1f}", published[0], f"{reduced}")
            print(f"| {side} x {side} px | {size} x {size} | {' | '.join(cells)} | {published[1]} |", flush=True)


if __name__ == "__main__":
    main()
