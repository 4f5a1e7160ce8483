"""Statistics of the texture models over 300 renders each: they should be what the truth says.

Run it by ``OMP_NUM_THREADS=1 python benchmarks/texture_statistics.py [MODEL ...]``; all models take minutes. Columns:

``clip color``, ``clip intensity``
    Share of pixels clipped in any channel at a strength of 0.6 under noise of 0.04, in %: the bound is 0.1 %.
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
``fold``
    Share of pixels at which jitter of 0.6 turns the picture over, in %.

``--noise`` prints instead the pixels that noise alone clips, in %, by its strength.
"""

import sys

import numpy as np

from nrbench import plugins
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.plugins.forms import Texture

RENDERS = 300
SIDE = 96
NOISES = (0.02, 0.03, 0.05, 0.08, 0.1, 0.2, 0.4, 0.6)
NONE = {"color": 0.0, "intensity": 0.0, "noise": 0.0}


def draws(name: str, count: int = RENDERS, **parameters: float) -> list[Texture]:
    """Return draws of a model at one phase."""
    model: Model = plugins.build("datasets", name, {**NONE, "rotation": 11.0, **parameters})
    rng = np.random.default_rng(1)
    first = model.render((SIDE, SIDE), rng)
    return [model.again(first, (SIDE, SIDE), rng) for _ in range(count)]


def clipped(textures: list[Texture]) -> float:
    """Return the share of pixels that are clipped in any channel, in %."""
    return 100 * float(np.mean([((each.image <= 0) | (each.image >= 1)).any(-1) for each in textures]))


def folded(textures: list[Texture]) -> float:
    """Return the share of pixels whose displacements turn the picture over, in %."""
    shares = []
    for each in textures:
        assert each.displacement is not None
        (xy, xx), (yy, yx) = (np.gradient(each.displacement[..., axis].astype(np.float64)) for axis in range(2))
        shares.append(((1 - xx) * (1 - yy) - xy * yx <= 0).mean())
    return 100 * float(np.mean(shares))


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
    fold = folded(draws(name, 60, jitter=0.6))
    figures = [*clips, beyond, bias, *moved(jitter, spread), *moved(corners, spread), share, fold]
    return f"{name:<12}" + "".join(f"{figure:11.3f}" for figure in figures)


def noise_line(name: str) -> str:
    """Return what noise of each strength clips."""
    return f"{name:<12}" + "".join(f"{clipped(draws(name, 20, noise=noise)):11.3f}" for noise in NOISES)


def main() -> None:
    """Print a line for each model."""
    titles = ("clip color", "clip int.", "|z| > 4", "mean z", "jitter", "spread", "bend", "spread", "share", "fold")
    alone = "--noise" in sys.argv
    print(" " * 12 + "".join(f"{title:>11}" for title in (NOISES if alone else titles)))
    for name in [word for word in sys.argv[1:] if word != "--noise"] or plugins.names("datasets"):
        if name not in ("images", "noise"):
            print(noise_line(name) if alone else line(name), flush=True)


if __name__ == "__main__":
    main()
