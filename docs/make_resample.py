r"""Draw the picture of the page on `resample` from a run.

The picture of the repository is from this run::

    nrbench run core -t brick-middle -t weave-strong -t hexagon-strong -m resample -m rsgf -m tile-set -m copier \
        -m oracle --lattice given --out runs/resample
    python docs/make_resample.py runs/resample
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt

from nrbench import Run
from nrbench.imaging.files import read_image

TEXTURES = ("brick-middle", "weave-strong", "hexagon-strong")
MODEL = {"sample.png": "sample", "extras/elements.png": "elements", "extras/attributes.png": "their colors"}
METHODS = {"oracle": "a fresh draw", "resample": "resample", "rsgf": "rsgf", "tile-set": "tile-set", "copier": "copier"}


def main() -> None:
    """Draw one row a texture: the sample, its elements and their colors, then the outputs with their quality."""
    records = {(r.texture, r.method): r for r in Run(Path(sys.argv[1])).cells}
    widths = [0.5] * len(MODEL) + [1.0] * len(METHODS)
    figure, axes = plt.subplots(len(TEXTURES), len(widths), figsize=(16.4, 7.9), width_ratios=widths)
    for row, texture in zip(axes, TEXTURES, strict=True):
        folder = records[texture, "resample"].folder
        for axis, (name, title) in zip(row, MODEL.items(), strict=False):
            axis.imshow(read_image(folder / name), interpolation="nearest")
            axis.set_title(title)
        for axis, (method, title) in zip(row[len(MODEL) :], METHODS.items(), strict=True):
            record = records[texture, method]
            quality = record.values["quality.score"]
            axis.imshow(read_image(record.folder / "output.png"), interpolation="nearest")
            axis.set(title=title, xlabel="not scored" if quality is None else f"quality {quality:.2f}")
    for axis in axes.ravel():
        axis.set(xticks=[], yticks=[])
    figure.tight_layout()
    figure.savefig(Path(__file__).with_name("resample.jpg"), dpi=75, pil_kwargs={"quality": 88})


if __name__ == "__main__":
    main()
