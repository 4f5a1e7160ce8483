"""What the scores of randomness answer to: planted defects, fresh draws, and the cheats.

``OMP_NUM_THREADS=1 python benchmarks/randomness_validation.py fresh --count 150`` scores two sets of that many fresh
draws of each texture: how often the second lies in the 95 % band of the first, and, for each cheat, which named scores
lie outside the 99 % band of both. ``defects --count 20`` plants each kind of defect at 8 sizes, with so many seeds, and
prints Spearman's correlation of each column with the size, over single images. Textures are of type I.
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
from nrbench.datasets_procedural.model import Model
from nrbench.datasets_procedural.weave import Weave
from nrbench.imaging.door import Image, quantize
from nrbench.metrics.judgement import Judgement, Look, compare, look_at_references
from nrbench.metrics.randomness import Randomness
from nrbench.metrics.yardstick import Yardstick, model_yardstick
from nrbench.outputs import checked_synthesis
from nrbench.streams import stream
from nrbench.synthesis import Observation, Synthesizer, Task
from nrbench.synthesizers.planted import Planted
from nrbench.synthesizers.random_phase import RandomPhase
from nrbench.synthesizers.scatter import Scatter
from nrbench.synthesizers.shuffle import Shuffle
from nrbench.synthesizers.supertile import Supertile
from nrbench.synthesizers.tiling import Tiling
from nrbench.texture import Shape, Texture

MODELS: Mapping[str, Model] = {
    "brick": Brick(color=0.2, noise=0.03, rotation=13.0),
    "weave": Weave(color=0.2, noise=0.03),
    "hexagon": Hexagon(color=0.3, noise=0.03, period=21.3),
}
CHEATS: Mapping[str, Synthesizer] = {
    "tiling": Tiling(),
    "supertile": Supertile(),
    "shuffle": Shuffle(),
    "random-phase": RandomPhase(),
    "scatter": Scatter(),
}
SATURATION = {"over-regular": 0.8, "verbatim": 0.5, "two-tone": 1.0}
"""Sizes up to which each kind of defect grows."""
NAMED = ("regularity.score", "variation", "repetition", "distance")
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

    def scored(self, output: Image, always: bool = False) -> Row:
        """Return the scores of an output; ``always``: also where regularity is lost."""
        measure, looks = self.measure()
        judgement = compare(output, measure, looks)
        seen = Observation(self.texture.image, output, self.texture, again=self.again, rng=np.random.default_rng(0))
        asked = _Open(**{field.name: getattr(judgement, field.name) for field in fields(judgement)})
        found = Randomness().of(seen, asked if always else judgement).values
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


def fresh(count: int, side: int) -> None:
    """Print how the second set of fresh draws lies in the band of the first, and where the cheats lie."""
    inside: list[float] = []
    for name in MODELS:
        bench = Bench.of(name, side)
        drawn = [bench.again((side, side), k) for k in range(2 * count)]
        table = columns(bench.scored(draw.image) for draw in drawn if draw is not None)
        print(f"{name}: {len(next(iter(table.values())))} fresh draws of {side} x {side} with all scores")
        for column, values in table.items():
            low, high = np.quantile(values[:count], [0.025, 0.975])
            held = float(((values[count:] >= low) & (values[count:] <= high)).mean())
            inside.append(held)
            spread = f"mean {values.mean():.4f} sd {values.std():.4f}"
            print(f"  {column:18} {spread}  second set in the 95 % band of the first: {held:.3f}")
        cheats(bench, table)
    print(f"all cells: {np.mean(inside):.3f} in the band")


def cheats(bench: Bench, table: Mapping[str, np.ndarray[tuple[int], np.dtype[np.float64]]]) -> None:
    """Print each cheat's scores, and which of the named ones lie outside the 99 % band."""
    for cheat, method in CHEATS.items():
        row, open_row = (bench.scored(bench.made(method, cheat), always) for always in (False, True))
        outside = [name for name in NAMED if name in table and _outside(row[name], table[name])]
        scores = " ".join(f"{name} {'-' if row[name] is None else f'{row[name]:.3f}'}" for name in NAMED)
        rest = " ".join(f"{name} {open_row[name] or 0:.3f}" for name in NAMED[1:])
        print(f"  {cheat:13} {scores}   outside: {', '.join(outside) or 'NONE'}   (scored anyway: {rest})")


def _outside(value: float | None, values: np.ndarray[tuple[int], np.dtype[np.float64]]) -> bool:
    low, high = np.quantile(values, [0.005, 0.995])
    return value is not None and not low <= value <= high


def defects(count: int, side: int) -> None:
    """Print Spearman's correlation of each column with the size of each defect."""
    for name in MODELS:
        bench = Bench.of(name, side)
        for kind, most in SATURATION.items():
            sizes = np.linspace(0, most, 8)
            cells = [(float(size), seed) for size in sizes for seed in range(count)]
            rows = [bench.scored(bench.made(Planted(kind, size), kind, seed), True) for size, seed in cells]
            where = np.array([size for size, _ in cells])
            varied = {column: values for column, values in columns(rows).items() if np.ptp(values) > 0}
            found = {column: float(spearmanr(where, values).statistic) for column, values in varied.items()}
            print(f"{name:8} {kind:13}", "  ".join(f"{column} {value:+.3f}" for column, value in found.items()))


def main() -> None:
    """Run one of the two."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("fresh", "defects"))
    parser.add_argument("--count", type=int, default=20, help="fresh draws in each set, or seeds of each defect")
    parser.add_argument("--side", type=int, default=192, help="width and height of the outputs in px")
    arguments = parser.parse_args()
    {"fresh": fresh, "defects": defects}[arguments.what](arguments.count, arguments.side)


if __name__ == "__main__":
    main()
