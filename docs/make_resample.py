r"""Draw the pictures of the page on `resample` from a run.

The pictures of the repository are from this run::

    nrbench run core -m resample -m rsgf -m tile-set -m copier -m cartoon -m oracle --lattice given --replicates 5 \
        --seed 5 --out runs/resample
    python docs/make_resample.py runs/resample
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib
import matplotlib.figure

matplotlib.use("Agg")

import matplotlib.pyplot as plt

from nrbench import Run
from nrbench.pictures.files import read_image

TEXTURES = ("brick-middle", "weave-strong", "hexagon-strong")
MODEL = {"sample.png": "sample", "extras/elements.png": "elements", "extras/attributes.png": "their colors"}
PERILS = ("regularity", "integrity", "randomness", "appearance")
METHODS = {"oracle": "a fresh draw", "resample": "resample", "rsgf": "rsgf", "tile-set": "tile-set", "copier": "copier"}


def draw_methods(run: Run) -> None:
    """Draw one row a texture: the sample, its elements and their colors, then the outputs with their quality."""
    records = {(r.texture, r.method): r for r in run.cells}
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
    save(figure, "resample.jpg")


def draw_perils(run: Run) -> None:
    """Draw for each peril the output of `resample` with the lowest and the median score beside a fresh draw."""
    records = {(r.texture, r.cell.replicate, r.method): r for r in run.cells if r.status == "ok"}
    figure, axes = plt.subplots(len(PERILS), 4, figsize=(13, 13.6))
    for row, peril in zip(axes, PERILS, strict=True):
        scores = sorted(
            (value, key)
            for key, record in records.items()
            if key[2] == "resample" and (value := record.values[f"quality.{peril}"]) is not None
        )
        for k, (score, (texture, replicate, _)) in enumerate((scores[0], scores[len(scores) // 2])):
            for axis, method in zip(row[2 * k : 2 * k + 2], ("oracle", "resample"), strict=True):
                image = read_image(records[texture, replicate, method].folder / "output.png")[:256, :256]
                axis.imshow(image, interpolation="nearest", cmap="gray", vmin=0, vmax=1)
                axis.set(title=f"{texture}, {METHODS[method]}")
            axis.set(xlabel=f"{peril} {score:.2f}, the {('lowest', 'median')[k]} of {len(scores)}")
    save(figure, "resample_perils.jpg")


def save(figure: matplotlib.figure.Figure, name: str) -> None:
    """Write a figure beside this file."""
    for axis in figure.axes:
        axis.set(xticks=[], yticks=[])
    figure.tight_layout()
    figure.savefig(Path(__file__).with_name(name), dpi=75, pil_kwargs={"quality": 88})


if __name__ == "__main__":
    run = Run(Path(sys.argv[1]))
    draw_methods(run)
    draw_perils(run)
