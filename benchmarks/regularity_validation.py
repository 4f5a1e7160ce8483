"""What the judge of regularity sees, and what it takes for a fault: planted defects against fresh draws.

``OMP_NUM_THREADS=1 python benchmarks/regularity_validation.py calibration`` prints, for one set of seeds, the largest
of each statistic over fresh draws as a share of its limit, which is what the limits in ``metrics/limits.py`` were set
on; then false alarms by regular share and output size, and for each kind and size of defect and each regular share the
AUC of the worst suspicion and the share of images called lost. ``report`` prints the same for another set of seeds.
Textures are brick, weave and hexagon of random periods, joints and mix of departures, every second one rotated.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import beta

from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.model import Model
from nrbench.datasets_procedural.weave import Weave
from nrbench.imaging.door import quantize
from nrbench.metrics.judgement import Judgement, Look, compare, look_at_references
from nrbench.metrics.yardstick import Yardstick, model_yardstick
from nrbench.streams import stream
from nrbench.synthesis import Again, Task
from nrbench.synthesizers.planted import Planted
from nrbench.texture import Shape, Texture

FIRST_SEED = {"calibration": 0, "report": 100_000}
SHARES = (0.93, 0.8, 0.65, 0.45, 0.3, 0.2)
SIZES = (128, 256, 512)
Looks = tuple[Look, ...]
DEFECTS = (
    *(("phase-step", size) for size in (0.1, 0.15, 0.3)),
    *(("off-lattice", size) for size in (0.1, 0.15, 0.3)),
    *(("displaced-tile", size) for size in (0.15, 0.2, 0.3, 0.4)),
    ("missing-tile", 1.0),
)


@dataclass(frozen=True)
class Specimen:
    """A texture with its fresh draws."""

    name: str
    share: float
    texture: Texture
    again: Again


@dataclass(frozen=True)
class Verdict:
    """What the judge said of one image."""

    share: float
    kind: str
    size: float
    side: int
    preserved: bool | None
    suspicions: tuple[float, ...]

    @classmethod
    def of(cls, item: Specimen, kind: str, size: float, side: int, judgement: Judgement) -> Verdict:
        """Keep the figures, let the images go."""
        return cls(item.share, kind, size, side, judgement.preserved, tuple(judgement.suspicions.values()))


def specimen(seed: int) -> Specimen:
    """Return the texture of a seed: family, rotation and regular share in turn, all else at random."""
    rng = stream("render", "validation", seed)
    family, rotated, share = seed % 3, seed // 3 % 2, SHARES[seed // 6 % len(SHARES)]
    model = at_share(
        _shape(family, float(rng.uniform(-45, 45)) if rotated else 0.0, rng), rng.dirichlet([1, 1, 1]), share
    )
    texture = model.render((128, 128), rng)

    def again(shape: Shape, k: int) -> Texture | None:
        drawn = model.again(texture, shape, stream("again", "validation", seed, k))
        return None if drawn is None else replace(drawn, image=quantize(drawn.image))

    return Specimen(f"{type(model).__name__.lower()}{' rotated' if rotated else ''}", share, texture, again)


def _shape(family: int, rotation: float, rng: np.random.Generator) -> Model:
    if family == 0:
        width, height, joint = rng.uniform(22, 36), rng.uniform(11, 17), rng.uniform(1.8, 3)
        return Brick(rotation=rotation, width=width, height=height, joint=joint)
    if family == 1:
        warp, weft, gap = rng.uniform(9, 16), rng.uniform(9, 16), rng.uniform(1.2, 2.2)
        return Weave(rotation=rotation, warp=warp, weft=weft, gap=gap)
    return Hexagon(rotation=rotation, period=rng.uniform(18, 34), joint=rng.uniform(1.8, 3.2))


def at_share(model: Model, mix: np.ndarray[tuple[int, ...], np.dtype[np.float64]], share: float) -> Model:
    """Return the model with departures mixed as asked, as strong as the regular share wants them."""
    low, high = 0.0, 1.0
    for _ in range(25):
        level = (low + high) / 2
        color, intensity, noise = (float(min(1, level * part)) for part in 3 * mix * (1, 1, 0.3))
        model = replace(model, color=color, intensity=intensity, noise=noise)
        low, high = (level, high) if model.regular_share > share else (low, level)
    return model


def fresh(item: Specimen, measure: Yardstick, looks: Looks, sides: tuple[int, ...], draws: int) -> Iterator[Verdict]:
    """Judge fresh draws of several sizes."""
    for side in sides:
        for k in range(draws):
            drawn = item.again((side, side), k)
            if drawn is not None:
                yield Verdict.of(item, "none", 0.0, side, compare(drawn.image, measure, looks))


def planted(item: Specimen, measure: Yardstick, looks: Looks, seed: int) -> Iterator[Verdict]:
    """Judge one image with each defect."""
    for kind, size in DEFECTS:
        rng = stream("synthesis", "validation", seed, kind, str(size))
        task = Task(item.texture.image, (256, 256), None, rng, again=item.again)
        image = quantize(Planted(kind, size).synthesize(task).image)
        yield Verdict.of(item, kind, size, 256, compare(image, measure, looks))


def run(first: int, count: int, sides: tuple[int, ...], draws: int) -> list[Verdict]:
    """Judge ``count`` textures."""
    verdicts: list[Verdict] = []
    for seed in range(first, first + count):
        item = specimen(seed)
        assert item.texture.lattice is not None
        measure = model_yardstick(item.texture, item.texture.lattice.reduced(), item.again)
        looks = look_at_references(measure)
        verdicts += fresh(item, measure, looks, sides, draws)
        verdicts += planted(item, measure, looks, seed)
    return verdicts


def auc(low: list[float], high: list[float]) -> float:
    """Return how often a value of ``high`` exceeds one of ``low``, ties counting half; NaN where one is empty."""
    if not low or not high:
        return float("nan")
    a, b = np.array(low), np.array(high)[:, np.newaxis]
    return float((b > a).mean() + (b == a).mean() / 2)


def upper_bound(events: int, trials: int) -> float:
    """Return the one-sided 95 % Clopper-Pearson bound of a rate."""
    return 1.0 if events >= trials else float(beta.ppf(0.95, events + 1, trials - events))


def print_statistics(verdicts: list[Verdict]) -> None:
    """Print the largest of each statistic over fresh draws, as a share of its limit."""
    print("largest share of its limit over fresh draws (q99, max); above 1 is a false alarm")
    names = ("misplaced windows", "worst neighborhood", "structure", "single tiles")
    groups = defaultdict(list)
    for verdict in verdicts:
        if verdict.kind == "none":
            groups[verdict.share, verdict.side].append(verdict.suspicions)
    for (share, side), rows in sorted(groups.items(), reverse=True):
        table = np.array(rows)
        cells = (
            f"{name} {np.quantile(column, 0.99):.2f} {column.max():.2f}"
            for name, column in zip(names, table.T, strict=True)
        )
        print(f"  share {share:.2f}  {side} px  n {len(rows):3}  {'  '.join(cells)}")


def print_false_alarms(verdicts: list[Verdict]) -> None:
    """Print how many fresh draws are called lost or undecided, by regular share and by output size."""
    for title, key in (("regular share", lambda v: v.share), ("output px", lambda v: v.side)):
        groups = defaultdict(list)
        for verdict in verdicts:
            if verdict.kind == "none":
                groups[key(verdict)].append(verdict.preserved)
        for value, found in sorted(groups.items()):
            lost, undecided = sum(f is False for f in found), sum(f is None for f in found)
            bound = upper_bound(lost, len(found))
            print(f"  {title} {value:<5} n {len(found):4}  lost {lost:2} (bound {bound:.3f})  undecided {undecided}")


def print_detection(verdicts: list[Verdict]) -> None:
    """Print AUC over the images with a verdict, share called lost and share undecided, by defect and regular share."""
    groups = defaultdict(list)
    for verdict in verdicts:
        if verdict.side == 256:
            groups[verdict.kind, verdict.size, verdict.share].append(verdict)
    print("AUC where there is a verdict / share called lost / share undecided, 256 x 256")
    print(f"{'':22}" + "".join(f"share {share:<14.2f}" for share in SHARES))
    for kind, size in DEFECTS:
        cells = []
        for share in SHARES:
            found = groups[kind, size, share]
            area = auc(_decided(groups["none", 0.0, share]), _decided(found))
            lost, open_ = (np.mean([verdict.preserved is answer for verdict in found]) for answer in (False, None))
            cells.append(f"{area:.3f} / {lost:.2f} / {open_:.2f}")
        print(f"{kind:16}{size:<6g}" + "".join(f"{cell:20}" for cell in cells))


def _decided(verdicts: list[Verdict]) -> list[float]:
    return [max(verdict.suspicions) for verdict in verdicts if verdict.preserved is not None]


def main() -> None:
    """Run one of the two halves."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("half", choices=FIRST_SEED)
    parser.add_argument("--count", type=int, default=108, help="textures")
    parser.add_argument("--draws", type=int, default=2, help="fresh draws of each texture and size")
    parser.add_argument("--sides", type=int, nargs="*", default=SIZES, help="output sizes of the fresh draws in px")
    arguments = parser.parse_args()
    verdicts = run(FIRST_SEED[arguments.half], arguments.count, tuple(arguments.sides), arguments.draws)
    print_statistics(verdicts)
    print_false_alarms(verdicts)
    print_detection(verdicts)


if __name__ == "__main__":
    main()
