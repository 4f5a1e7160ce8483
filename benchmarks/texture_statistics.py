"""Statistics of the texture models over 300 renders each: they should be what the truth says.

Run it by ``OMP_NUM_THREADS=1 python benchmarks/texture_statistics.py [MODEL ...]``; all models take minutes. Columns:

``clip color``, ``clip intensity``
    Share of clipped values at a strength of 0.6 under noise of 0.04, in %: the bound is 0.1 %.
``|z| > 4``
    Share of values whose mean over the renders is farther from the ideal image than four standard errors, in %, at
    color 0.6, intensity 0.3 and noise 0.04. Chance alone gives 0.006 %, in patches as large as an element.
``mean z``
    Mean of those deviations, in standard errors.
``jitter``, ``bend``
    Mean displacement (in standard errors) and its standard deviation over the documented one, of elements (jitter
    0.3) and of pixels (bend 0.3). At the border only elements that came into the picture are counted, so that means of
    up to 3 standard errors are common.
``share``
    Regular share measured over the renders, minus the one stated.
"""

from __future__ import annotations

import sys

import numpy as np

from nrbench import plugins
from nrbench.datasets_procedural.model import Model
from nrbench.texture import Texture

RENDERS = 300
SIDE = 96
NONE = {"color": 0.0, "intensity": 0.0, "noise": 0.0}


def draws(name: str, count: int = RENDERS, **parameters: float) -> list[Texture]:
    """Return draws of a model at one phase."""
    model: Model = plugins.build("datasets", name, {**NONE, "rotation": 11.0, **parameters})
    rng = np.random.default_rng(1)
    first = model.render((SIDE, SIDE), rng)
    return [model.again(first, (SIDE, SIDE), rng) for _ in range(count)]


def clipped(textures: list[Texture]) -> float:
    """Return the share of values that are clipped, in %."""
    return 100 * float(np.mean([(each.image <= 0) | (each.image >= 1) for each in textures]))


def deviations(textures: list[Texture]) -> tuple[float, float, float]:
    """Return share of means beyond four standard errors in %, mean deviation, and measured minus stated share."""
    images = np.stack([each.image for each in textures]).astype(np.float64)
    ideal, error = textures[0].ideal, images.std(0, ddof=1) / np.sqrt(len(images))
    assert ideal is not None and textures[0].regular_share is not None
    z = (images.mean(0) - ideal) / error
    regular = images.mean(0).var((0, 1)).mean() - (error**2).mean()
    share = regular / (regular + images.var(0, ddof=1).mean())
    return 100 * float((np.abs(z) > 4).mean()), float(z.mean()), float(share - textures[0].regular_share)


def moved(moves: np.ndarray, spread: float) -> tuple[float, float]:
    """Return the mean of (n, 2) displacements in standard errors (the worse axis), and their spread over the stated."""
    error = spread / np.sqrt(len(moves))
    return float(np.abs(moves.mean(0)).max() / error), float(moves.std() / spread)


def line(name: str) -> str:
    """Return a model's figures."""
    clips = [clipped(draws(name, 60, noise=0.04, **{which: 0.6})) for which in ("color", "intensity")]
    beyond, bias, share = deviations(draws(name, color=0.6, intensity=0.3, noise=0.04))
    spread = 0.075 * plugins.build("datasets", name, {}).s
    tables = [each.elements for each in draws(name, jitter=0.3)]
    jitter = np.concatenate([rows for one in tables for part, rows in one.items() if part.endswith("displacement")])
    fields = [each.displacement for each in draws(name, bend=0.3)]
    corners = np.stack([field[0, 0] for field in fields if field is not None])
    figures = [*clips, beyond, bias, *moved(jitter, spread), *moved(corners, spread), share]
    return f"{name:<12}" + "".join(f"{figure:11.3f}" for figure in figures)


def main() -> None:
    """Print a line for each model."""
    titles = ("clip color", "clip int.", "|z| > 4", "mean z", "jitter", "spread", "bend", "spread", "share")
    print(" " * 12 + "".join(f"{title:>11}" for title in titles))
    for name in sys.argv[1:] or plugins.names("datasets"):
        if name not in ("images", "noise"):
            print(line(name), flush=True)


if __name__ == "__main__":
    main()
