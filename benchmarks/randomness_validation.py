"""How the scores of randomness follow the planted defects of variety.

``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/randomness_validation.py --count 20`` plants each kind of
defect at 8 sizes up to its saturation, with so many seeds, and prints Spearman's correlation of each column with the
size, over single images; the columns that are meant for the defect are set off. Textures are of type I. How fresh draws
and the cheats lie is told by ``reference_rows.py``.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from functools import cache

import numpy as np
from scipy.stats import spearmanr

from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.datasets_procedural.weave import Weave
from nrbench.imaging.convert import Image, quantize
from nrbench.metrics.randomness import Randomness
from nrbench.metrics.verdict.measurements import Look, look_at_references
from nrbench.metrics.verdict.reference import Yardstick, model_yardstick
from nrbench.metrics.verdict.verdict import Judgement, compare
from nrbench.plugins.forms import Observation, Shape, Synthesizer, Task, Texture
from nrbench.running.outputs import checked_synthesis
from nrbench.streams import stream
from nrbench.synthesizers.planted import Planted

MODELS: Mapping[str, Model] = {
    "brick": Brick(color=0.2, noise=0.03, rotation=13.0),
    "weave": Weave(color=0.2, noise=0.03),
    "hexagon": Hexagon(color=0.3, noise=0.03, period=21.3),
}
DEFECTS = {"over-regular": (0.8, ("variation", "distance")), "verbatim": (0.5, ("repetition",))}
"""For each kind of defect the size at which it saturates, and the columns that are meant for it."""
STEPS = np.arange(1, 9) / 8
Row = dict[str, float | None]


class _Open(Judgement):
    """A judgement that lets everything be scored: what is asked here is what the scores answer to."""

    @property
    def preserved(self) -> bool | None:
        """Never lost."""
        return None


@dataclass(frozen=True, eq=False)
class Bench:
    """A texture, its sample, and what regularity measures against."""

    model: Model
    texture: Texture
    side: int

    @classmethod
    def of(cls, name: str, side: int) -> Bench:
        """Draw the sample."""
        texture = MODELS[name].render((128, 128), stream("render", "randomness", name))
        return cls(MODELS[name], replace(texture, image=quantize(texture.image)), side)

    def again(self, shape: Shape, k: int) -> Texture | None:
        """Return the k-th fresh draw."""
        return self._drawn(shape, k) if k >= 1 << 16 else self._draw(shape, k)

    @cache  # noqa: B019
    def _drawn(self, shape: Shape, k: int) -> Texture:
        return self._draw(shape, k)

    def _draw(self, shape: Shape, k: int) -> Texture:
        drawn = self.model.again(self.texture, shape, stream("again", "randomness", self.model.s.hex(), k))
        return replace(drawn, image=quantize(drawn.image))

    @cache  # noqa: B019
    def measure(self) -> tuple[Yardstick, tuple[Look, ...]]:
        """Return what outputs are measured against."""
        assert self.texture.lattice is not None
        measure = model_yardstick(self.texture, self.texture.lattice.reduced(), self.again)
        return measure, look_at_references(measure)

    def scored(self, output: Image) -> Row:
        """Return the scores of an output, also where regularity is lost."""
        measure, looks = self.measure()
        judgement = compare(output, measure, looks)
        seen = Observation(self.texture.image, output, self.texture, again=self.again, rng=np.random.default_rng(0))
        asked = _Open(**{field.name: getattr(judgement, field.name) for field in fields(judgement)})
        found = Randomness().of(seen, asked).values
        return {"regularity.score": judgement.score, **{name: _number(value) for name, value in found.items()}}

    def made(self, method: Synthesizer, *seed: str | int) -> Image:
        """Return the output of a method that is handed the lattice."""
        shape = (self.side, self.side)
        again = self.again if isinstance(method, Planted) else None
        rng = stream("synthesis", "randomness", *seed)
        task = Task(self.texture.image, shape, self.texture.lattice, rng, again=again)
        return checked_synthesis(method.synthesize(task), self.texture.image, shape).image


def _number(value: float | bool | None) -> float | None:
    return None if value is None else float(value)


def columns(rows: Iterable[Row]) -> dict[str, np.ndarray[tuple[int], np.dtype[np.float64]]]:
    """Return the values of each column that has one in every row."""
    table = list(rows)
    names = [name for name in table[0] if all(row[name] is not None for row in table)]
    return {name: np.array([row[name] for row in table], np.float64) for name in names}


def defects(count: int, side: int) -> None:
    """Print Spearman's correlation of each column with the size of each defect."""
    for name in MODELS:
        bench = Bench.of(name, side)
        for kind, (most, own) in DEFECTS.items():
            cells = [(float(size), seed) for size in STEPS * most for seed in range(count)]
            rows = [bench.scored(bench.made(Planted(kind, size), kind, seed)) for size, seed in cells]
            where = np.array([size for size, _ in cells])
            varied = {column: values for column, values in columns(rows).items() if np.ptp(values) > 0}
            found = {column: float(spearmanr(where, values).statistic) for column, values in varied.items()}
            meant, rest = (
                "  ".join(f"{column} {value:+.3f}" for column, value in found.items() if (column in own) == is_own)
                for is_own in (True, False)
            )
            print(f"{name:8} {kind:13} {len(cells)} images  {meant}   (others: {rest})", flush=True)


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20, help="seeds of each defect and size")
    parser.add_argument("--side", type=int, default=256, help="width and height of the outputs in px")
    arguments = parser.parse_args()
    defects(arguments.count, arguments.side)


if __name__ == "__main__":
    main()
