"""Speed of tile-set, as multiples of the machine unit u.

Run it on one thread: ``OMP_NUM_THREADS=1 python benchmarks/tile_set.py``. The lattice is given, kernels are warm.
Figures are medians of CPU seconds, each over a unit measured right before it: a busy machine shifts both alike. How
cost and memory grow with the output stands in ``growth.py``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from unit import machine_unit, median_units

from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.corduroy import Corduroy
from nrbench.datasets_procedural.windows import Windows
from nrbench.imaging.convert import quantize
from nrbench.jit import load_kernels
from nrbench.plugins.forms import Dataset, Refused, Synthesizer, Task, Texture
from nrbench.suites.plan import drawn
from nrbench.suites.suite import load_suite
from nrbench.synthesizers.tile_set import TileSet

METHODS: dict[str, Synthesizer] = {
    "tile-set": TileSet(),
    "tile-set registration=0": TileSet(registration=0),
    "tile-set parts=4": TileSet(parts=4),
    "tile-set tile=upright": TileSet(tile="upright"),
    "tile-set symmetry=true": TileSet(symmetry=True),
    "tile-set cells=2": TileSet(cells=2),
    "tile-set margin=0": TileSet(margin=0),
    "tile-set stitch=dynamic": TileSet(stitch="dynamic"),
}
MODELS: dict[str, Dataset] = {"brick": Brick(), "windows": Windows(), "corduroy": Corduroy()}


def units(method: Synthesizer, model: Dataset, sample: int, output: int, repeats: int = 7) -> float:
    """Return what a method takes, in u, from a square sample of a model to a square output of these sides."""
    return units_of(method, model.render((sample, sample), np.random.default_rng(0)), output, repeats)


def units_of(method: Synthesizer, texture: Texture, output: int, repeats: int = 7) -> float:
    """Return what a method takes, in u, from a texture to a square output of this side."""
    pixels = quantize(texture.image)

    def synthesize() -> object:
        return method.synthesize(Task(pixels, (output, output), texture.lattice, np.random.default_rng(1)))

    return median_units(synthesize, repeats)


def suite_table(name: str) -> None:
    """Print what every texture of a suite takes from 128 x 128 to 256 x 256 px, the dearest last."""
    costs: dict[str, float] = {}
    for sample in drawn(load_suite(name), ["*"]):
        texture = replace(sample.recipe, shape=(128, 128)).render()
        try:
            costs[sample.recipe.texture] = units_of(TileSet(), texture, 256, 3)
        except Refused as refusal:
            print(f"{sample.recipe.texture:34} refused: {refusal.reason}")
    for texture_name, cost in sorted(costs.items(), key=lambda item: item[1]):
        print(f"{texture_name:34} {cost:8.1f} u", flush=True)


def main() -> None:
    """Print the tables."""
    load_kernels()
    print(f"u = {machine_unit() * 1e3:.2f} ms")
    print("\n256 x 256 from 128 x 128, brick")
    for name, method in METHODS.items():
        print(f"{name:34} {units(method, MODELS['brick'], 128, 256):8.1f} u")
    print("\n256 x 256 from 128 x 128, by lattice: the smaller the cell, the more tiles")
    for name, model in MODELS.items():
        print(f"{name:34} {units(TileSet(), model, 128, 256):8.1f} u")
    print("\nbrick to 256 x 256: cost by sample")
    for side in (96, 128, 256, 512):
        print(f"{side:5} x {side:<5} {units(TileSet(), MODELS['brick'], side, 256, 3):8.1f} u")
    for name in ("core", "report2004"):
        print(f"\n256 x 256 from 128 x 128, {name}")
        suite_table(name)


if __name__ == "__main__":
    main()
