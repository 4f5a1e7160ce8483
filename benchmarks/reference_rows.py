"""Where the reference rows lie: a second set of oracle draws in the band of the first, and every cheat outside it.

``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/reference_rows.py score rows.csv`` scores, for each texture
of type I of the suites core, report2004 and validation, ``--draws`` fresh draws, ``--second`` others, and ``--seeds``
outputs of each cheat, all of one side, against fresh draws of the judge's own. One line an output is appended; lines
that are there are kept, so an interrupted run goes on. ``--textures`` takes some of them (patterns for ``suite/name``).

``table rows.csv`` prints how many of the second set lie in the 95 % band of the first, by column, and for each texture
and cheat the scores outside the 99 % band of all fresh draws; one output of a cheat escapes when there is none.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatch
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import beta

from nrbench import plugins
from nrbench.imaging.convert import Image, quantize
from nrbench.metrics.ncc.periodic import tile_box
from nrbench.metrics.randomness import Randomness
from nrbench.metrics.verdict.measurements import Look, look_at_references
from nrbench.metrics.verdict.reference import FIRST_DRAW, Yardstick, model_yardstick
from nrbench.metrics.verdict.verdict import compare, obstacle
from nrbench.plugins.forms import Again, Observation, Refused, Task, Texture, Value
from nrbench.running.outputs import checked_synthesis
from nrbench.streams import stream
from nrbench.suites.cell import Recipe
from nrbench.suites.plan import drawn
from nrbench.suites.suite import load_suite

SUITES = ("core", "report2004", "validation")
CHEATS = ("tiling", "supertile", "shuffle", "random-phase", "scatter")
REGULARITY = ("preserved", "score")
RANDOMNESS = ("variation", "repetition", "distance")
COLUMNS = (*(f"regularity.{name}" for name in REGULARITY), *(f"randomness.{name}" for name in RANDOMNESS))
FIELDS = ("texture", "share", "side", "row", "draw", *COLUMNS, "reason", "seconds")
SECOND_DRAW = 1 << 12
"""Draws of the second set start here; the judge's own at :data:`FIRST_DRAW`."""
TILES, SIDES = 7, (160, 384)
"""Outputs are so many tiles wide, within these sides in px,"""
LEAST_TILES = 4.2
"""but never fewer tiles than this: regularity needs 3 x 3 windows of two tiles, half a window apart."""
LEAST = 20
"""Fewer fresh draws with a score make no band."""
ESCAPES = "ESCAPES"


@dataclass(frozen=True, eq=False)
class Place:
    """One texture, drawn as its suite draws it, and what outputs of it are measured against."""

    name: str
    texture: Texture
    recipe: Recipe

    @cached_property
    def side(self) -> int:
        """Width and height of the outputs in px."""
        assert self.texture.lattice is not None
        tile = float(tile_box(self.texture.lattice.reduced()).max())
        return int(np.ceil(max(np.clip(TILES * tile, *SIDES), LEAST_TILES * tile)))

    @cached_property
    def again(self) -> Again:
        """Fresh draws; the judge's own are kept."""
        draw = self.recipe.again(self.texture)
        kept = lru_cache(maxsize=64)(draw)
        return lambda shape, k: kept(shape, k) if k >= FIRST_DRAW else draw(shape, k)

    @cached_property
    def measure(self) -> tuple[Yardstick, tuple[Look, ...]]:
        """What outputs are measured against."""
        assert self.texture.lattice is not None
        measure = model_yardstick(self.texture, self.texture.lattice, self.again)
        return measure, look_at_references(measure)

    def fresh(self, k: int) -> Image:
        """Return the k-th fresh draw of the outputs' size."""
        drawn = self.again((self.side, self.side), k)
        assert drawn is not None
        return quantize(drawn.image)

    def made(self, cheat: str, seed: int) -> Image:
        """Return an output of a cheat that is handed the lattice."""
        shape, method = (self.side, self.side), plugins.build("synthesizers", cheat)
        rng = stream("synthesis", "reference rows", self.name, seed)
        task = Task(self.texture.image, shape, self.texture.lattice, rng)
        return checked_synthesis(method.synthesize(task), self.texture.image, shape).image

    def scored(self, output: Image) -> tuple[dict[str, Value], str]:
        """Return an output's scores, and why some are missing."""
        judgement = compare(output, *self.measure)
        if told := obstacle(judgement):
            return {}, told
        seen = Observation(self.texture.image, output, self.texture, again=self.again)
        found = Randomness().of(seen, judgement)
        values: dict[str, Value] = {
            "regularity.preserved": judgement.preserved,
            "regularity.score": judgement.score,
            **{f"randomness.{name}": found.values[name] for name in RANDOMNESS},
        }
        why = [judgement.blindness, *(found.reasons.get(name, "") for name in RANDOMNESS)]
        return values, "; ".join(dict.fromkeys(filter(None, why)))


def places(patterns: list[str]) -> Iterator[Place]:
    """Yield the textures of type I of the suites."""
    for suite in map(load_suite, SUITES):
        for sample in drawn(suite):
            name = f"{suite.name}/{sample.row.name}"
            if any(fnmatch(name, pattern) for pattern in patterns) and sample.texture and sample.texture.kind == "I":
                yield Place(name, sample.texture, sample.recipe)


def outputs(place: Place, draws: int, second: int, seeds: int) -> Iterator[tuple[str, int]]:
    """Yield row and draw of every output of a texture; cheats first, since these are few."""
    for cheat in CHEATS:
        if place.texture.kind not in getattr(plugins.find("synthesizers", cheat).cls, "right_on", ()):
            yield from ((cheat, seed) for seed in range(seeds))
    yield from (("fresh", k) for k in range(draws))
    yield from (("second", k) for k in range(second))


def score(arguments: argparse.Namespace) -> None:
    """Append the scores of what is not in the file yet."""
    path = Path(arguments.rows)
    old = pd.read_csv(path) if path.is_file() else pd.DataFrame(columns=FIELDS)
    done = set(zip(old["texture"], old["row"], old["draw"], strict=True))
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, FIELDS)
        if old.empty:
            writer.writeheader()
        for place in places(arguments.textures):
            began = time.process_time()
            for row, draw in outputs(place, arguments.draws, arguments.second, arguments.seeds):
                if (place.name, row, draw) not in done:
                    writer.writerow(_line(place, row, draw))
                    file.flush()
            print(f"{place.name}: {time.process_time() - began:.0f} s", flush=True)


def _line(place: Place, row: str, draw: int) -> dict[str, Value | str]:
    start = time.process_time()
    try:
        output = place.made(row, draw) if row in CHEATS else place.fresh(draw + SECOND_DRAW * (row == "second"))
        values, why = place.scored(output)
    except Refused as refusal:
        values, why = {}, f"refused: {refusal.reason}"
    share = round(place.texture.regular_share or 0.0, 3)
    about = {"texture": place.name, "share": share, "side": place.side, "row": row, "draw": draw, "reason": why}
    return {**about, **values, "seconds": round(time.process_time() - start, 3)}


def table(arguments: argparse.Namespace) -> None:
    """Print both tables."""
    rows = pd.read_csv(arguments.rows)
    rows["regularity.preserved"] = rows["regularity.preserved"].map({"True": 1.0, "False": 0.0, True: 1.0, False: 0.0})
    print_second(rows)
    print_verdicts(rows)
    print_cheats(rows)


def print_second(rows: pd.DataFrame) -> None:
    """Print how many of the second set lie in the 95 % band of the first, by column and over all."""
    print("| column | textures | second draws | in the 95 % band | 95 % interval | textures from 0.93 to 0.97 |")
    print("| --- | --- | --- | --- | --- | --- |")
    every: list[pd.Series[bool]] = []
    for name in COLUMNS[1:]:
        held = [_held(own, name) for _, own in rows.groupby("texture", sort=False)]
        held = [one for one in held if len(one)]
        every += held
        _print_held(name, held)
    _print_held("all", every)


def _held(own: pd.DataFrame, name: str) -> pd.Series[bool]:
    first, second = (own.loc[own["row"] == row, name].dropna() for row in ("fresh", "second"))
    if len(first) < LEAST or first.nunique() < 2:
        return pd.Series(dtype=bool)
    low, high = band(first, 0.95)
    return second.between(low, high)


def _print_held(name: str, held: list[pd.Series[bool]]) -> None:
    count, inside = sum(map(len, held)), int(sum(one.sum() for one in held))
    if count:
        low, high = beta.ppf([0.025, 0.975], [inside, inside + 1], [count - inside + 1, max(count - inside, 1e-9)])
        right = sum(0.93 <= one.mean() <= 0.97 for one in held)
        print(f"| {name} | {len(held)} | {count} | {inside / count:.4f} | {low:.4f} to {high:.4f} | {right} |")


def print_verdicts(rows: pd.DataFrame) -> None:
    """Print how many fresh draws are called lost, and how many are decided."""
    own = rows[rows["row"].isin(["fresh", "second"])]
    lost = (own["regularity.preserved"] == 0).groupby(own["texture"]).sum()
    told = own["regularity.preserved"].notna().groupby(own["texture"]).sum()
    print(f"\n{len(own)} fresh draws, {int(told.sum())} with a verdict, {int(lost.sum())} called lost")
    print("".join(f"  {name}: {count} lost of {told[name]}\n" for name, count in lost.items() if count), end="")


def print_cheats(rows: pd.DataFrame) -> None:
    """Print, for each texture and cheat, the scores outside the 99 % band of all fresh draws in every output."""
    print(f"\n| texture | share | draws | {' | '.join(CHEATS)} |\n|{' --- |' * (3 + len(CHEATS))}")
    escaped: list[str] = []
    for texture, own in rows.groupby("texture", sort=False):
        fresh = own[own["row"].isin(["fresh", "second"])]
        told = [caught(fresh, own[own["row"] == cheat]) for cheat in CHEATS]
        escaped += [f"{texture}: {cheat}" for cheat, words in zip(CHEATS, told, strict=True) if words == ESCAPES]
        print(f"| {texture} | {own['share'].iloc[0]:.2f} | {len(fresh)} | {' | '.join(told)} |")
    print(f"\nescaped: {len(escaped)}\n" + "\n".join(escaped))


def caught(fresh: pd.DataFrame, cheats: pd.DataFrame) -> str:
    """Return the scores in which all outputs of a cheat lie outside; that it escapes where one lies in every band."""
    refused = cheats["reason"].astype(str).str.startswith("refused")
    cheats = cheats[~refused]
    if cheats.empty:
        return "refused" if refused.any() else "not run"
    outside = {name: _outside(fresh[name].dropna(), cheats[name]) for name in COLUMNS}
    if not np.any(list(outside.values()), 0).all():
        return ESCAPES
    return ", ".join(name.partition(".")[2] for name, each in outside.items() if each.all()) or "by turns"


def _outside(fresh: pd.Series[float], values: pd.Series[float]) -> NDArray[np.bool_]:
    if len(fresh) < LEAST:
        return np.zeros(len(values), np.bool_)
    low, high = band(fresh, 0.99)
    return np.asarray((values < low) | (values > high))


def band(values: pd.Series[float], level: float) -> tuple[float, float]:
    """Return the ends between which the middle ``level`` of further values is expected: order statistics.

    The r-th of n draws has r / (n + 1) of all further ones below it, whatever their distribution.
    """
    tail = (1 - level) / 2
    low, high = np.quantile(values, [tail, 1 - tail], method="weibull")
    return float(low), float(high)


def main() -> None:
    """Run one of the two."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("score", "table"))
    parser.add_argument("rows", help="CSV that is written, or read")
    parser.add_argument("--draws", type=int, default=300, help="fresh draws of the first set")
    parser.add_argument("--second", type=int, default=200, help="fresh draws of the second set")
    parser.add_argument("--seeds", type=int, default=3, help="outputs of each cheat")
    parser.add_argument("--textures", nargs="+", default=["*"], help="patterns for suite/name")
    arguments = parser.parse_args()
    {"score": score, "table": table}[arguments.what](arguments)


if __name__ == "__main__":
    main()
