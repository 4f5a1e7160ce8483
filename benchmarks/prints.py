"""Prints with labeled outputs: polka dots, checks and walls of pixels, whose elements have one of a few inks.

``python benchmarks/prints.py FOLDER``

Each print is a file, from which a sample and a fresh draw are cut. FOLDER/invented holds pictures of the same prints
whose elements have colors that are no inks: normal values with the mean and the covariance of the inks.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nrbench.pictures.files import write_image
from nrbench.suites.plan import draw_samples
from nrbench.suites.suite import load_suite
from nrbench.synthesizers.precomputed import name_for

Colors = NDArray[np.float64]
SHAPE, SIZE, FINE = (416, 256), (256, 256), 4
"""Shape of a picture and of an output, px, and samples of each pixel along a side."""
SUITE = Path(__file__).resolve().parent / "labels" / "prints.toml"
INKS = {
    "berry": [(0.80, 0.15, 0.25), (0.15, 0.25, 0.60), (0.95, 0.75, 0.20)],
    "mint": [(0.10, 0.45, 0.35), (0.75, 0.90, 0.80)],
    "earth": [(0.55, 0.30, 0.15), (0.80, 0.60, 0.35), (0.30, 0.20, 0.15), (0.90, 0.85, 0.70)],
    "candy": [(0.95, 0.45, 0.60), (0.45, 0.75, 0.90), (0.60, 0.85, 0.45)],
}
PRINTS = {
    "polka-berry": ("polka", "berry", 24.3),
    "polka-mint": ("polka", "mint", 21.7),
    "checks-candy": ("checks", "candy", 15.3),
    "checks-mint": ("checks", "mint", 17.9),
    "wall-earth": ("wall", "earth", 9.7),
    "wall-berry": ("wall", "berry", 11.3),
}


def draw(kind: str, size: float, color: Callable[[int], Colors]) -> Colors:
    """Return a print (height, width, 3) whose elements have the colors ``color(count)``; the period is ``size`` px."""
    y, x = (np.mgrid[: SHAPE[0] * FINE, : SHAPE[1] * FINE] + 0.5) / FINE
    high, wide = {"polka": (size * 3**0.5 / 2, size), "checks": (size, size), "wall": (size, 2.2 * size)}[kind]
    row = np.floor(y / high).astype(int)
    column = np.floor(x / wide - 0.5 * (row % 2) * (kind != "checks")).astype(int) + 1
    u, v = x / wide - 0.5 * (row % 2) * (kind != "checks") - column + 0.5, y / high - row - 0.5
    colors = color((row.max() + 1) * (column.max() + 1)).reshape(row.max() + 1, column.max() + 1, 3)
    picture = colors[row, column]
    if kind == "polka":
        picture[np.hypot(u * wide, v * high) > 0.33 * size] = (0.96, 0.94, 0.88)
    if kind == "wall":
        picture[(abs(u) * wide > wide / 2 - 0.8) | (abs(v) * high > high / 2 - 0.8)] = (0.12, 0.12, 0.14)
    return picture.reshape(SHAPE[0], FINE, SHAPE[1], FINE, 3).mean((1, 3))


def _draw_inks(inks: Colors, rng: np.random.Generator, count: int) -> Colors:
    """Return inks, ``(count, 3)``, each drawn with equal chances."""
    return np.asarray(inks[rng.integers(len(inks), size=count)])


def _invent_colors(inks: Colors, rng: np.random.Generator, count: int) -> Colors:
    """Return normal values with the mean and the covariance of the inks, ``(count, 3)``."""
    return np.clip(rng.multivariate_normal(inks.mean(0), np.cov(inks.T, bias=True), size=count), 0, 1)


def draw_prints(folder: Path) -> None:
    """Write all pictures."""
    (folder / "invented").mkdir(parents=True, exist_ok=True)
    others = {}
    for number, (name, (kind, palette, size)) in enumerate(PRINTS.items()):
        inks, rng = np.array(INKS[palette]), np.random.default_rng(440 + number)
        write_image(folder / f"{name}.png", draw(kind, size, partial(_draw_inks, inks, rng)))
        other = draw(kind, size, partial(_invent_colors, inks, rng))
        others[name] = other[: SIZE[0]]
    with contextlib.chdir(folder):
        for sample in draw_samples(load_suite(str(SUITE))):
            assert sample.texture is not None
            write_image(f"invented/{name_for(sample.texture.image, SIZE)}", others[sample.row.name])


if __name__ == "__main__":
    draw_prints(Path(sys.argv[1]))
