r"""Draw the pictures of the README and of the page on `resample` from stored runs, into ``docs/``.

``python benchmarks/pictures.py first-light runs/core`` draws ``first-light.jpg`` from a run of the suite ``core``.
``python benchmarks/pictures.py resample runs/resample`` draws ``resample.jpg`` and ``resample_perils.jpg`` from ::

    nrbench run core -m resample -m rsgf -m tile-set -m copier -m cartoon -m oracle --lattice given --replicates 5 \
        --seed 5 --out runs/resample
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.figure

matplotlib.use("Agg")

import matplotlib.pyplot as plt

from nrbench import Lattice, Run, draw_lattice, read_image
from nrbench.runs.records import CellRecord

DOCS = Path(__file__).parents[1] / "docs"
PERILS = ("regularity", "integrity", "randomness", "appearance")
LIGHT = ("brick-strong", "weave-middle", "hexagon-middle-rotated")
LIGHT_COLUMNS = {
    ("oracle", "none"): "oracle: a fresh draw",
    ("resample", "own"): "resample",
    ("rsgf", "own"): "rsgf",
    ("tile-set", "own"): "tile-set",
    ("fftm-patch", "own"): "fftm-patch",
    ("ann-pixel", "none"): "ann-pixel: no lattice",
    ("tiling", "own"): "tiling: one tile, repeated",
}
"""Method and source of the lattice of each column, and its title."""
VARIED = ("brick-middle", "weave-strong", "hexagon-strong")
MODEL = {"sample.png": "sample", "extras/elements.png": "elements", "extras/attributes.png": "their colors"}
METHODS = {"oracle": "a fresh draw", "resample": "resample", "rsgf": "rsgf", "tile-set": "tile-set", "copier": "copier"}


def show(axis: Any, image: Any, **labels: str) -> None:
    """Show a picture pixel for pixel, with a title or a line below it."""
    axis.imshow(image, interpolation="nearest", cmap="gray", vmin=0, vmax=1)
    axis.set(xticks=[], yticks=[], **labels)


def save(figure: matplotlib.figure.Figure, name: str, dpi: int, quality: int, pad: float = 1.08) -> None:
    """Write a figure to the folder of the docs."""
    figure.tight_layout(h_pad=pad)
    figure.savefig(DOCS / name, dpi=dpi, pil_kwargs={"quality": quality})


def caption(record: CellRecord) -> str:
    """Return the verdict and the quality of one output, in two lines."""
    preserved, quality = record.values["regularity.preserved"], record.values["quality.score"]
    verdict = {True: "lattice preserved", False: "lattice lost", None: "undecided"}[preserved]
    return f"{verdict}\n" + (f"quality {quality:.2f}" if quality is not None else "not scored further")


def draw_light(run: Run) -> None:
    """Draw one row a texture: sample with its lattice, then an output a method."""
    records = {(r.texture, r.method, r.lattice_source): r for r in run.cells}
    widths = [0.62, *[1] * len(LIGHT_COLUMNS)]
    figure, axes = plt.subplots(len(LIGHT), len(widths), figsize=(16.2, 7.6), width_ratios=widths)
    for row, texture in zip(axes, LIGHT, strict=True):
        first = records[texture, *next(iter(LIGHT_COLUMNS))]
        truth = Lattice.from_dict(first.lattice_truth or {})
        label = f"sample and lattice\nregular share {first.regular_share:.2f}"
        show(row[0], draw_lattice(read_image(first.folder / "sample.png"), truth), xlabel=label)
        for axis, (column, title) in zip(row[1:], LIGHT_COLUMNS.items(), strict=True):
            record = records[texture, *column]
            title = title if texture == LIGHT[0] else ""
            show(axis, read_image(record.folder / "output.png"), xlabel=caption(record), title=title)
    save(figure, "first-light.jpg", 96, 85, 1.6)


def draw_methods(run: Run) -> None:
    """Draw one row a texture: the sample, its elements and their colors, then the outputs with their quality."""
    records = {(r.texture, r.method): r for r in run.cells}
    widths = [0.5] * len(MODEL) + [1.0] * len(METHODS)
    figure, axes = plt.subplots(len(VARIED), len(widths), figsize=(16.4, 7.9), width_ratios=widths)
    for row, texture in zip(axes, VARIED, strict=True):
        folder = records[texture, "resample"].folder
        for axis, (name, title) in zip(row, MODEL.items(), strict=False):
            show(axis, read_image(folder / name), title=title)
        for axis, (method, title) in zip(row[len(MODEL) :], METHODS.items(), strict=True):
            record = records[texture, method]
            quality = record.values["quality.score"]
            label = "not scored" if quality is None else f"quality {quality:.2f}"
            show(axis, read_image(record.folder / "output.png"), title=title, xlabel=label)
    save(figure, "resample.jpg", 75, 88)


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
            label = f"{peril} {score:.2f}, the {('lowest', 'median')[k]} of {len(scores)}"
            for axis, method in zip(row[2 * k : 2 * k + 2], ("oracle", "resample"), strict=True):
                image = read_image(records[texture, replicate, method].folder / "output.png")[:256, :256]
                title = f"{texture}, {METHODS[method]}"
                show(axis, image, title=title, xlabel=label if method == "resample" else "")
    save(figure, "resample_perils.jpg", 75, 88)


def main() -> None:
    """Draw the pictures of one page."""
    drawn = {"first-light": (draw_light,), "resample": (draw_methods, draw_perils)}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("page", choices=drawn)
    parser.add_argument("run", type=Path, help="directory of the run")
    options = parser.parse_args()
    for draw in drawn[options.page]:
        draw(Run(options.run))


if __name__ == "__main__":
    main()
