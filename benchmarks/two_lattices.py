"""Whether methods keep both lattices of a texture that has two: square frames over hexagons, judged one by one.

``OMP_NUM_THREADS=1 python benchmarks/two_lattices.py [SEED...]``: fresh draws of the model of the report's figure 31,
whose common tile no sample holds. Methods find their lattices themselves, and the judge has no model: by each lattice a
mean tile is folded from the sample, against which the output's windows are registered. Of the hexagons, half hidden by
frames, it gives no verdict; their misplacement beside that of a fresh draw tells.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import numpy as np

import nrbench
from nrbench.datasets_procedural.overlap import Overlap
from nrbench.imaging.convert import Image
from nrbench.jit import load_kernels
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Refused, Texture

MODEL = Overlap(period=36.7, color=0.15, intensity=0.1, noise=0.02)
METHODS = ("fftm-pixel", "fftm-patch", "ann-pixel", "rsgf", "tile-set", "representative-tile")
COLUMNS = ("score", "misplacement_median", "misplacement_p95", "misplaced_share", "structure")
SAMPLE, OUTPUT = (160, 160), (320, 320)


def outputs(texture: Texture, seed: int) -> Iterator[tuple[str, Image | str]]:
    """Yield a fresh draw, and what each method makes of the texture, or why it refuses."""
    yield "a fresh draw", MODEL.again(texture, OUTPUT, np.random.default_rng(seed + 1000)).image
    for method in METHODS:
        try:
            yield method, nrbench.synthesize(method, texture.image, OUTPUT, seed=seed).image
        except Refused as refused:
            yield method, refused.reason


def row(texture: Texture, image: Image, lattice: Lattice) -> str:
    """Return the verdict and the columns by one lattice."""
    values = nrbench.score(texture.image, image, lattice=Lattice(lattice.t1, lattice.t2)).values
    numbers = (values[f"regularity.{column}"] for column in COLUMNS)
    cells = "".join(f"{'-' if number is None else format(number, '.3f'):>21}" for number in numbers)
    return f"{values['regularity.preserved']!s:>9}{cells}"


def main() -> None:
    """Print the table."""
    load_kernels()
    print(f"{'seed':4} {'method':20} {'lattice':9}{'preserved':>9}" + "".join(f"{column:>21}" for column in COLUMNS))
    for seed in [int(argument) for argument in sys.argv[1:]] or [1, 2, 3]:
        texture = MODEL.render(SAMPLE, np.random.default_rng(seed))
        for method, made in outputs(texture, seed):
            if isinstance(made, str):
                print(f"{seed:4} {method:20} refused: {made}", flush=True)
                continue
            for name, lattice in zip(("squares", "hexagons"), texture.lattices[1:], strict=True):
                print(f"{seed:4} {method:20} {name:9}{row(texture, made, lattice)}", flush=True)


if __name__ == "__main__":
    main()
