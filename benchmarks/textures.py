"""Cost of the texture models, as multiples of the machine unit u: 512 x 512 px, without and with all departures.

Run it on one thread: ``OMP_NUM_THREADS=1 python benchmarks/textures.py``. Every figure is the median of seven.
"""

from __future__ import annotations

import numpy as np
from unit import machine_unit, median_seconds

from nrbench import plugins

EVERYTHING = {"light": 0.3, "damage": 0.2, "missing": 0.1, "jitter": 0.3, "bend": 0.3}
BOUND = 50


def cost(name: str, **parameters: float) -> float:
    """Return the seconds of one texture of 512 x 512 px."""
    model = plugins.build("datasets", name, parameters)
    return median_seconds(lambda: model.render((512, 512), np.random.default_rng(0)))


def main() -> None:
    """Print a line for each model; u is measured anew beside each, for machines with other work."""
    print(f"{'model':<12} {'plain':>8} {'with all departures':>20}   (u; bound {BOUND})")
    for name in plugins.names("datasets"):
        if name != "images":
            u = machine_unit()
            plain = f"{cost(name) / u:8.1f}"
            print(f"{name:<12} {plain} {'' if name == 'noise' else f'{cost(name, **EVERYTHING) / u:20.1f}'}")


if __name__ == "__main__":
    main()
