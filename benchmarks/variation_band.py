"""Whether methods vary as the texture does: ``randomness.variation`` in the 95 % band of fresh draws.

``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/variation_band.py score rows.csv`` draws each texture of
the suites core and report2004 ``--replicates`` times and scores, for each, ``--draws`` fresh draws of the output's size
and one output of each of ``--methods``, the lattice given, as a run of the suite does. All fresh draws of a texture
make its band: each replicate is measured against references of its own, so the band holds their scatter, too. One line
an output is appended; those that are there are kept.

Beside each output stands what its sample allows. *Sample* is the variance between the windows of half a tile that the
sample holds, about their mean, over the fresh draws' energy: one small draw, which scatters. *Copier* is what patches
drawn uniformly from all equal places of that sample have on average: of M places the share (M - 1) / M of it, since
copies depart from the mean of what is copied, and not from the texture's.

``table rows.csv`` prints, for each method, how many outputs lie in the band, how many copiers that hit their
expectation would, and how many outputs lie in the band once they are taken over the copier's: what is left is the
method's own bias, and its mean and 95 % interval over textures are printed. ``--each`` adds a line a texture.
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

from nrbench import plugins
from nrbench.imaging.convert import Image, quantize
from nrbench.imaging.mean_tile import Values
from nrbench.metrics.randomness import score_tiles
from nrbench.metrics.residual_tiles.tiles import ComparedTiles, quarters
from nrbench.metrics.verdict.reference import FIRST_DRAW, Reference, reference_from_model
from nrbench.metrics.verdict.verdict import compute_verdict
from nrbench.plugins.forms import Again, Observation, Refused, Synthesis, Task, Texture, Value
from nrbench.running.output_checks import checked_synthesis
from nrbench.streams import stream
from nrbench.suites.plan import PlannedMethod, Sample, draw_samples
from nrbench.suites.suite import load_suite

FIELDS = (
    *("texture", "share", "replicate", "row", "draw", "preserved", "variation", "repetition", "distance"),
    *("sample", "copier", "sources", "reason", "seconds"),
)
KEPT = 4
"""A figure is kept, or in the band, when so many of its five replicates are."""


@dataclass(frozen=True, eq=False)
class Place:
    """One replicate of a texture, and what its outputs are measured against."""

    suite: str
    seed: int
    drawing: Sample

    @property
    def name(self) -> str:
        """The texture's."""
        return f"{self.suite}/{self.drawing.row.name}"

    @property
    def texture(self) -> Texture:
        """The sample."""
        assert self.drawing.texture is not None
        return self.drawing.texture

    @cached_property
    def again(self) -> Again:
        """Fresh draws; those of the reference are kept."""
        draw = self.drawing.recipe.again(self.texture)
        kept = lru_cache(maxsize=64)(draw)
        return lambda shape, k: kept(shape, k) if k >= FIRST_DRAW else draw(shape, k)

    @cached_property
    def reference(self) -> Reference:
        """What outputs are compared with."""
        assert self.texture.lattice is not None
        return reference_from_model(self.texture, self.texture.lattice, self.again)

    def fresh(self, k: int) -> Image:
        """Return the k-th fresh draw of the outputs' size."""
        draw = self.again(self.drawing.shape, k)
        assert draw is not None
        return quantize(draw.image)

    def made(self, method: str) -> Image:
        """Return what a run of the suite gets from a method."""
        chosen = PlannedMethod.parse(method)
        rng = stream("synthesis", self.seed, self.drawing.hash, self.drawing.recipe.replicate)
        task = Task(self.texture.image, self.drawing.shape, self.texture.lattice, rng)
        built = plugins.build("synthesizers", chosen.name, chosen.parameters)
        made: Synthesis = built.synthesize(task)
        return checked_synthesis(made, task.sample, task.shape).image

    def scored(self, output: Image) -> dict[str, Value | str]:
        """Return an output's scores, and why some are missing."""
        verdict = compute_verdict(output, self.reference)
        if verdict.obstacle:
            return {"reason": verdict.obstacle}
        seen = Observation(self.texture.image, output, self.texture, again=self.again)
        found = score_tiles(seen, verdict)
        values = {name: found.values[name] for name in ("variation", "repetition", "distance")}
        why = "; ".join(dict.fromkeys(found.reasons.get(name, "") for name in values))
        return {"preserved": verdict.preserved, **values, "reason": why.strip("; ")}

    @cached_property
    def allowed(self) -> dict[str, Value]:
        """What the sample allows: variation of the sample, and of a uniform copier on average; places it has."""
        seen = Observation(self.texture.image, self.fresh(0), self.texture, again=self.again)
        tiles = ComparedTiles.of(seen, compute_verdict(seen.output, self.reference))
        right = [some for some in tiles.reference if len(some) > 1]
        shares = quarters((tiles.weights / tiles.weights.sum())[np.newaxis, ..., np.newaxis])[:, 0]
        energy = np.average([_energy(t.departures, tiles.weights) for t in right], weights=[len(t) - 1 for t in right])
        parts = [
            (len(each), float((each.var(0) * share).mean(-1).sum()))
            for each, share in zip(tiles.windows, shares, strict=True)
        ]
        if min(count for count, _ in parts) < 2 or energy <= 0:
            return {"sample": None, "copier": None, "sources": min(count for count, _ in parts)}
        return {
            "sample": sum(value * count / (count - 1) for count, value in parts) / float(energy),
            "copier": sum(value for _, value in parts) / float(energy),
            "sources": float(np.mean([count for count, _ in parts])),
        }


def _energy(departures: Values, weights: NDArray[np.float32]) -> float:
    return float(np.tensordot((departures**2).mean((0, 3)), weights / weights.sum(), 2))


def places(arguments: argparse.Namespace) -> Iterator[Place]:
    """Yield every replicate of the suites' textures of type I."""
    for suite in map(load_suite, arguments.suites):
        replicated = suite.model_copy(update={"replicates": arguments.replicates})
        for drawing in draw_samples(replicated):
            place = Place(suite.name, suite.seed, drawing)
            known = drawing.texture and drawing.texture.kind == "I"
            if known and any(fnmatch(place.name, pattern) for pattern in arguments.textures):
                yield place


def score(arguments: argparse.Namespace) -> None:
    """Append the scores of what is not in the file yet."""
    path = Path(arguments.rows)
    old = pd.read_csv(path) if path.is_file() else pd.DataFrame(columns=FIELDS)
    done = set(zip(old["texture"], old["replicate"], old["row"], old["draw"], strict=True))
    wanted = [("fresh", k) for k in range(arguments.draws)] + [(method, 0) for method in arguments.methods]
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, FIELDS)
        if old.empty:
            writer.writeheader()
        for place in places(arguments):
            replicate = place.drawing.recipe.replicate
            for row, draw in wanted:
                if (place.name, replicate, row, draw) not in done:
                    writer.writerow(_line(place, row, draw))
                    file.flush()


def _line(place: Place, row: str, draw: int) -> dict[str, Value | str]:
    start = time.process_time()
    share = round(place.texture.regular_share or 0.0, 3)
    about: dict[str, Value | str] = {"texture": place.name, "share": share, "row": row, "draw": draw}
    about["replicate"] = place.drawing.recipe.replicate
    try:
        found = place.scored(place.fresh(draw) if row == "fresh" else place.made(row))
        found = {**found, **place.allowed} if found.get("variation") is not None else found
    except Refused as refusal:
        found = {"reason": f"refused: {refusal.reason}"}
    return {**about, **found, "seconds": round(time.process_time() - start, 3)}


def table(arguments: argparse.Namespace) -> None:
    """Print the summary, and a line a texture."""
    rows = pd.read_csv(arguments.rows)
    rows["preserved"] = rows["preserved"].map({"True": 1.0, "False": 0.0, True: 1.0, False: 0.0})
    rows["suite"] = rows["texture"].str.partition("/")[0]
    told = judged(rows)
    print_bands(rows, told)
    for suite, own in told.groupby("suite", sort=False):
        print_methods(str(suite), own)
    if arguments.each:
        print_each(told)


LEAST = 20
"""Fewer fresh draws make no band."""


def band(values: pd.Series[float], level: float) -> tuple[float, float]:
    """Return the ends between which the middle ``level`` of further values is expected: order statistics.

    The r-th of n draws has r / (n + 1) of all further ones below it, whatever their distribution.
    """
    tail = (1 - level) / 2
    low, high = np.quantile(values, [tail, 1 - tail], method="weibull")
    return float(low), float(high)


def judged(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the methods' rows that have a variation, each beside the ends of its texture's band."""
    parts = []
    for _, own in rows.groupby("texture", sort=False):
        fresh = own.loc[own["row"] == "fresh", "variation"].dropna()
        mine = own[(own["row"] != "fresh") & own["variation"].notna()].copy()
        if len(fresh) >= LEAST and len(mine):
            mine["low"], mine["high"] = band(fresh, 0.95)
            mine["middle"] = fresh.mean()
            parts.append(mine)
    told = pd.concat(parts)
    told["within"] = told["variation"].between(told["low"], told["high"])
    told["copier_within"] = told["copier"].between(told["low"], told["high"])
    told["bias"] = told["variation"] / told["copier"]
    told["excused"] = told["bias"].between(told["low"], told["high"])
    return told


def print_bands(rows: pd.DataFrame, told: pd.DataFrame) -> None:
    """Print how wide the bands are."""
    fresh = rows[(rows["row"] == "fresh") & rows["variation"].notna()]
    counts = fresh.groupby("texture").size()
    ends = told.groupby("texture")[["low", "high", "middle"]].first()
    print(f"{len(counts)} textures with a band, of {counts.median():.0f} fresh draws each")
    print(
        f"band: {ends['low'].median():.3f} to {ends['high'].median():.3f} (medians), mean {ends['middle'].mean():.3f}"
    )


def print_methods(suite: str, told: pd.DataFrame) -> None:
    """Print what share of outputs and copiers lies in the band, and the methods' bias."""
    heads = "outputs | variation | in the band | figures | copier | its in the band | figures | bias | bias in the band"
    print(f"\n**{suite}**\n\n| method | {heads} | repetition | distance |\n|{' --- |' * 12}")
    for method, own in told.groupby("row", sort=False):
        within, copier, excused = (own[name].mean() for name in ("within", "copier_within", "excused"))
        mine, ideal = _figures(own, "within"), _figures(own, "copier_within")
        print(
            f"| {method} | {len(own)} | {_interval(own, 'variation')} | {within:.2f} | {mine} | "
            f"{_interval(own, 'copier')} | {copier:.2f} | {ideal} | {_interval(own, 'bias')} | {excused:.2f} | "
            f"{own['repetition'].mean():.2f} | {own['distance'].mean():.3f} |"
        )


def _figures(own: pd.DataFrame, name: str) -> str:
    counts = own.groupby("texture")[name].agg(["sum", "size"])
    kept = counts["sum"] >= np.ceil(counts["size"] * KEPT / 5)
    return f"{int(kept.sum())} of {len(kept)}"


def _interval(own: pd.DataFrame, name: str) -> str:
    """Return a mean over textures and its 95 % interval."""
    means = own.groupby("texture")[name].mean().dropna()
    half = 1.96 * means.std() / np.sqrt(max(len(means), 1))
    return f"{means.mean():.3f} ({means.mean() - half:.3f} to {means.mean() + half:.3f})"


def print_each(told: pd.DataFrame) -> None:
    """Print a line a texture."""
    methods = list(dict.fromkeys(told["row"]))
    heads = ("texture", "share", "sources", "band", "sample", "copier", *methods)
    print(f"\n| {' | '.join(heads)} |\n|{' --- |' * len(heads)}")
    for texture, own in told.groupby("texture", sort=False):
        first, once = own.iloc[0], own.drop_duplicates("replicate")
        cells = [
            *(str(texture), f"{first['share']:.2f}", f"{own['sources'].mean():.0f}"),
            *(f"{first['low']:.2f} to {first['high']:.2f}", f"{once['sample'].mean():.2f}"),
            f"{once['copier'].mean():.2f}, {int(once['copier_within'].sum())} of {len(once)} in",
            *(_cell(own[own["row"] == method]) for method in methods),
        ]
        print(f"| {' | '.join(cells)} |")


def _cell(own: pd.DataFrame) -> str:
    inside = f"{int(own['within'].sum())} of {len(own)} in"
    return f"{own['variation'].mean():.2f}, {inside}, bias {own['bias'].mean():.2f}" if len(own) else "none"


def main() -> None:
    """Run one of the two."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("score", "table"))
    parser.add_argument("rows", help="CSV that is written, or read")
    parser.add_argument("--suites", nargs="+", default=["core", "report2004"])
    parser.add_argument("--replicates", type=int, default=5, help="samples of each texture")
    parser.add_argument("--draws", type=int, default=12, help="fresh draws of each replicate")
    parser.add_argument("--methods", nargs="*", default=["rsgf", "tile-set"])
    parser.add_argument("--textures", nargs="+", default=["*"], help="patterns for suite/name")
    parser.add_argument("--each", action="store_true", help="table: a line a texture, too")
    arguments = parser.parse_args()
    {"score": score, "table": table}[arguments.what](arguments)


if __name__ == "__main__":
    main()
