"""Textures on which the judge of regularity is validated: random models of given regular shares, with fresh draws."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import beta

from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.datasets_procedural.weave import Weave
from nrbench.imaging.convert import Image, quantize
from nrbench.metrics.verdict.measurements import Look, look_at_references
from nrbench.metrics.verdict.reference import Yardstick, best_yardstick, model_yardstick
from nrbench.metrics.verdict.verdict import Judgement, compare
from nrbench.plugins.forms import Again, Refused, Shape, Task, Texture
from nrbench.streams import stream
from nrbench.synthesizers.planted import Planted

FIRST_SEED = {"calibration": 0, "report": 100_000}
SHARES = (0.93, 0.8, 0.7, 0.55, 0.4, 0.3)


@dataclass(frozen=True)
class Specimen:
    """A texture with its fresh draws, and what outputs of it are measured against."""

    name: str
    share: float
    texture: Texture
    again: Again
    measure: Yardstick
    looks: tuple[Look, ...]

    def fresh(self, side: int, k: int) -> Image:
        """Return the k-th fresh draw."""
        drawn = self.again((side, side), k)
        assert drawn is not None
        return drawn.image

    def judged(self, image: Image) -> Judgement:
        """Return an output beside its references."""
        return compare(image, self.measure, self.looks)

    def planted(self, kind: str, size: float, side: int, seed: int) -> Image | None:
        """Return a fresh draw with a defect; None where it comes to nothing. Stretch is given in s at the border."""
        rng = stream("synthesis", "validation", seed, kind, str(size))
        task = Task(self.texture.image, (side, side), None, rng, again=self.again)
        amount = size * self.measure.lattice.s / (side / 2) if kind == "stretch" else size
        try:
            return quantize(Planted(kind, min(amount, 1.0)).synthesize(task).image)
        except Refused:
            return None


def specimen(seed: int, given: bool = False) -> Specimen:
    """Return the texture of a seed: family, rotation and regular share in turn, all else at random.

    Where only the lattice is ``given``, outputs are measured against the sample of 128 x 128 px.
    """
    rng = stream("render", "validation", seed)
    family, rotated, share = seed % 3, seed // 3 % 2, SHARES[seed // 6 % len(SHARES)]
    model = at_share(
        _shape(family, float(rng.uniform(-45, 45)) if rotated else 0.0, rng), rng.dirichlet([1, 1, 1]), share
    )
    texture = model.render((128, 128), rng)

    def again(shape: Shape, k: int) -> Texture | None:
        drawn = model.again(texture, shape, stream("again", "validation", seed, k))
        return None if drawn is None else replace(drawn, image=quantize(drawn.image))

    assert texture.lattice is not None
    known = texture.lattice
    measure = best_yardstick(quantize(texture.image), known) if given else model_yardstick(texture, known, again)
    name = f"{type(model).__name__.lower()}{' rotated' if rotated else ''}"
    return Specimen(name, share, texture, again, measure, look_at_references(measure))


def _shape(family: int, rotation: float, rng: np.random.Generator) -> Model:
    if family == 0:
        width, height, joint = rng.uniform(22, 36), rng.uniform(11, 17), rng.uniform(1.8, 3)
        return Brick(rotation=rotation, width=width, height=height, joint=joint)
    if family == 1:
        warp, weft, gap = rng.uniform(9, 16), rng.uniform(9, 16), rng.uniform(1.2, 2.2)
        return Weave(rotation=rotation, warp=warp, weft=weft, gap=gap)
    return Hexagon(rotation=rotation, period=rng.uniform(18, 34), joint=rng.uniform(1.8, 3.2))


def at_share(model: Model, mix: np.ndarray[tuple[int, ...], np.dtype[np.float64]], share: float) -> Model:
    """Return the model with departures mixed as asked, as strong as the regular share allows, not undercut."""

    def at(level: float) -> Model:
        color, intensity, noise = (float(min(1, level * part)) for part in 3 * mix * (1, 1, 0.3))
        return replace(model, color=color, intensity=intensity, noise=noise)

    low, high = 0.0, 1.0
    for _ in range(25):
        level = (low + high) / 2
        low, high = (level, high) if at(level).regular_share > share else (low, level)
    return at(low)


def auc(low: list[float], high: list[float]) -> float:
    """Return how often a value of ``high`` exceeds one of ``low``, ties counting half; NaN where one is empty."""
    if not low or not high:
        return float("nan")
    a, b = np.array(low), np.array(high)[:, np.newaxis]
    return float((b > a).mean() + (b == a).mean() / 2)


def upper_bound(events: int, trials: int) -> float:
    """Return the one-sided 95 % Clopper-Pearson bound of a rate."""
    return 1.0 if events >= trials else float(beta.ppf(0.95, events + 1, trials - events))
