"""Draw the README's picture from a run of the suite core: `python docs/make_picture.py runs/core`."""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

from nrbench import Lattice, Run
from nrbench.pictures.files import read_image
from nrbench.pictures.overlays import draw_lattice
from nrbench.runs.records import CellRecord

TEXTURES = ("brick-strong", "weave-middle", "hexagon-middle-rotated")
COLUMNS = (
    ("oracle", "none"),
    ("resample", "own"),
    ("rsgf", "own"),
    ("tile-set", "own"),
    ("fftm-patch", "own"),
    ("ann-pixel", "none"),
    ("tiling", "own"),
)
TITLES = {
    "oracle": "oracle: a fresh draw",
    "tiling": "tiling: one tile, repeated",
    "ann-pixel": "ann-pixel: no lattice",
}


def caption(record: CellRecord) -> str:
    """Return the verdict and the quality of one output, in two lines."""
    preserved, quality = record.values["regularity.preserved"], record.values["quality.score"]
    verdict = {True: "lattice preserved", False: "lattice lost", None: "undecided"}[preserved]
    return f"{verdict}\n" + (f"quality {quality:.2f}" if quality is not None else "not scored further")


def main() -> None:
    """Draw one row a texture: sample with its lattice, then an output a method."""
    records = {(r.texture, r.method, r.lattice_source): r for r in Run(Path(sys.argv[1])).cells}
    widths = [0.62, *[1] * len(COLUMNS)]
    figure, axes = plt.subplots(len(TEXTURES), 1 + len(COLUMNS), figsize=(16.2, 7.6), width_ratios=widths)
    for row, texture in zip(axes, TEXTURES, strict=True):
        first = records[texture, *COLUMNS[0]]
        truth = Lattice.from_dict(first.lattice_truth or {})
        row[0].imshow(draw_lattice(read_image(first.folder / "sample.png"), truth), interpolation="nearest")
        row[0].set_xlabel(f"sample and lattice\nregular share {first.regular_share:.2f}")
        for axis, column in zip(row[1:], COLUMNS, strict=True):
            record = records[texture, *column]
            axis.imshow(read_image(record.folder / "output.png"), interpolation="nearest")
            axis.set_xlabel(caption(record))
    for axis, (method, _) in zip(axes[0, 1:], COLUMNS, strict=True):
        axis.set_title(TITLES.get(method, method))
    for axis in np.ravel(axes):
        axis.set(xticks=[], yticks=[])
    figure.tight_layout(h_pad=1.6)
    figure.savefig(Path(__file__).with_name("first-light.jpg"), dpi=96, pil_kwargs={"quality": 85})


if __name__ == "__main__":
    main()
