"""CPU time of `regularity` on a 256 x 256 output, in units u measured beside it, with and without the model.

``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/regularity_cost.py``. Medians of seven; bound 25 u.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy import fft
from validation_textures import FIRST_SEED, specimen

from nrbench.metrics.regularity import Regularity
from nrbench.plugins.forms import Observation, Texture

IMAGE = np.random.default_rng(0).random((1024, 1024), np.float32)


def cpu_seconds(call: Callable[[], object]) -> float:
    """Return the CPU seconds of one call."""
    start = time.process_time()
    call()
    return time.process_time() - start


def unit() -> float:
    """Return the CPU seconds of one unit: rfft2 and irfft2 of 1024 x 1024 float32."""
    return cpu_seconds(lambda: fft.irfft2(fft.rfft2(IMAGE), IMAGE.shape))


def main() -> None:
    """Print a line for each texture."""
    for number in (14, 15, 16):
        item = specimen(FIRST_SEED["report"] + number)
        output, bare = item.fresh(256, 0), Texture(item.texture.image, item.texture.lattice)
        for name, seen in (
            ("model", Observation(item.texture.image, output, item.texture, again=item.again)),
            ("given", Observation(item.texture.image, output, bare)),
        ):
            ratios = []
            for _ in range(7):
                before = unit()
                taken = cpu_seconds(lambda seen=seen: Regularity().score(replace(seen, output=seen.output.copy())))
                ratios.append(2 * taken / (before + unit()))
            print(f"{item.name:8} {name:6} {np.median(ratios):5.1f} u")


if __name__ == "__main__":
    main()
