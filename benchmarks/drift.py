"""How far methods are off a fractional lattice, over large outputs: misplacement against the model's truth.

``OMP_NUM_THREADS=1 python benchmarks/drift.py [SIDE...]``: a wall of 21.37 x 18.81 px, turned by 7 degrees, from
256 x 256 px, the lattice given. The worst window counts, not a percentile.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from nrbench.datasets_procedural.brick import Brick
from nrbench.imaging.convert import quantize
from nrbench.jit import load_kernels
from nrbench.metrics.verdict.examination import examine
from nrbench.metrics.verdict.verdict import Verdict
from nrbench.plugins.forms import Observation, Shape, Synthesizer, Task, Texture
from nrbench.streams import stream
from nrbench.synthesizers.representative_tile import RepresentativeTile
from nrbench.synthesizers.rsgf import Rsgf
from nrbench.synthesizers.tile_set import TileSet
from nrbench.synthesizers.tiling import Tiling

MODEL = Brick(width=21.37, height=18.81, bond="stack", rotation=7.0, color=0.2, noise=0.03)
METHODS: dict[str, Synthesizer] = {
    "rsgf": Rsgf(),
    "rsgf:seam=blend": Rsgf(seam="blend"),
    "rsgf:seam=blend,subpixel=false,tolerance=3,candidate_fraction=0,prefer_unused=false": Rsgf(
        seam="blend", subpixel=False, tolerance=3.0, candidate_fraction=0.0, prefer_unused=False
    ),
    "tiling": Tiling(),
    "tile-set": TileSet(),
    "representative-tile": RepresentativeTile(),
}


def worst_misplacement(method: Synthesizer, sample: int, side: int) -> tuple[float, float]:
    """Return the largest and the median misplacement of any window of the output, over s."""
    drawn = MODEL.render((sample, sample), np.random.default_rng(0))
    texture = replace(drawn, image=quantize(drawn.image))

    def again(shape: Shape, k: int) -> Texture:
        fresh = MODEL.again(texture, shape, stream("again", "drift", k))
        return replace(fresh, image=quantize(fresh.image))

    made = method.synthesize(Task(texture.image, (side, side), texture.lattice, np.random.default_rng(1)))
    verdict = examine(Observation(texture.image, quantize(made.image), texture, again=again)).verdict
    assert isinstance(verdict, Verdict)
    misplacement = verdict.output.windows.misplacement
    return float(misplacement.max()), float(np.median(misplacement))


def main() -> None:
    """Print the table."""
    load_kernels()
    for side in [int(argument) for argument in sys.argv[1:]] or [256, 1024]:
        print(f"{side} x {side}: worst and median misplacement over s")
        for name, method in METHODS.items():
            worst, median = worst_misplacement(method, 256, side)
            print(f"  {name:44} {worst:6.3f} {median:6.3f}", flush=True)


if __name__ == "__main__":
    main()
