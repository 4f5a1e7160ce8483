"""What ``integrity`` and ``appearance`` see: planted defects against fresh draws, and cut-and-join methods.

``OMP_NUM_THREADS=1 python benchmarks/appearance_validation.py alarms --half report --count 36``: broken tiles in fresh
draws of three sizes (a false alarm is any), and AUC and share found of two-tone tiles by regular share; ``--half
calibration`` prints the same for the seeds that the limit was set on. ``response``: Spearman correlation of each score
with the size of its own defect over 8 sizes x ``--count`` seeds on three textures. ``silence``: each score under each
defect, as distance from the mean of fresh draws in their standard deviations. ``methods``: broken tiles of the oracle
and of random sampling and gap filling on brick.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr
from validation_textures import FIRST_SEED, SHARES, Specimen, auc, specimen, upper_bound

from nrbench.datasets_procedural.brick import Brick
from nrbench.imaging.convert import Image, quantize
from nrbench.imaging.files import write_image
from nrbench.metrics.appearance import Appearance
from nrbench.metrics.integrity import LEAST_POWER
from nrbench.metrics.verdict.measurements import look_at_references
from nrbench.metrics.verdict.reference import model_yardstick
from nrbench.metrics.whole_elements.broken import BROKEN_SURPRISE, Broken, find_broken
from nrbench.metrics.whole_elements.broken_map import broken_map, worst_tiles
from nrbench.plugins.forms import Observation, Shape, Task, Texture
from nrbench.streams import stream
from nrbench.synthesizers.oracle import Oracle
from nrbench.synthesizers.rsgf import Rsgf

SIDES = (128, 256, 512)
TWO_TONE = (0.03, 0.08, 0.25)
TEXTURES = (6, 10, 8)
"""Seeds of the textures of ``response`` and ``silence``: brick, weave rotated, hexagon, of regular share 0.8."""
RESPONSES = {
    "color-mean": ("color", 1.0),
    "blurred-band": ("sharpness_worst", 1.0),
    "seam": ("seam", 0.5),
    "two-tone": ("broken_share", 1.0),
}
"""Each defect's score, and the largest size, where the defect saturates."""
WOVEN_TWO_TONE = 0.5
"""Where two-tone tiles saturate on a weave: past it threads that cross tiles are whole again."""
SILENT_SIZES = {"color-mean": 0.2, "blurred-band": 0.3, "seam": 0.1, "two-tone": 0.3, "phase-step": 0.3, "warp": 0.1}
COLUMNS = ("color", "gradient", "spectrum", "sharpness", "sharpness_worst", "seam", "broken_share", "evidence_p90")


def breaks(item: Specimen, image: Image) -> Broken | str:
    """Return the broken tiles of an output."""
    return find_broken(item.judged(image), item.texture.image, item.again)


def planted(item: Specimen, kind: str, size: float, seed: int) -> Image:
    """Return a fresh draw with a defect."""
    image = item.planted(kind, size, 256, seed)
    assert image is not None
    return image


def alarms(half: str, count: int, sides: tuple[int, ...], draws: int) -> None:
    """Print broken tiles in fresh draws, and how many two-tone tiles are found."""
    fresh, seen, powers = defaultdict(list), defaultdict(list), defaultdict(list)
    for seed in range(FIRST_SEED[half], FIRST_SEED[half] + count):
        item = specimen(seed)
        for side in sides:
            for k in range(draws):
                found = breaks(item, item.fresh(side, k))
                if isinstance(found, str) or found.power < LEAST_POWER:
                    break
                fresh[item.share, side].append(found.worst)
                powers[item.share].append(found.power)
        for size in TWO_TONE if powers[item.share] else ():
            found = breaks(item, planted(item, "two-tone", size, seed))
            if not isinstance(found, str) and found.power >= LEAST_POWER:
                seen[item.share, size].append(found.worst)
        so_far = [value for some in fresh.values() for value in some]
        print(
            f"  {item.name} {item.share}: {sum(value > BROKEN_SURPRISE for value in so_far)} of {len(so_far)}",
            flush=True,
        )
    for side in sides:
        values = np.array([value for (_, own), some in fresh.items() if own == side for value in some])
        wrong = int((values > BROKEN_SURPRISE).sum())
        bound, high = upper_bound(wrong, len(values)), np.quantile(values, (0.9, 0.99, 1))
        print(f"fresh {side:4} px: n {len(values):4}  alarms {wrong} (bound {bound:.3f})", end="")
        print("  worst surprise q90 {:.1f} q99 {:.1f} max {:.1f}".format(*high))
    print("AUC (worst tile) / share of images with a broken tile, 256 px; n textures with power")
    for share in SHARES:
        own, cells = fresh[share, 256], []
        for size in TWO_TONE:
            some = seen[share, size]
            cells.append(
                f"{size:g}: {auc(own, some):.3f} / {np.mean(np.array(some) > BROKEN_SURPRISE):.2f}" if some else "-"
            )
        power = np.mean(powers[share]) if powers[share] else 0.0
        print(f"  share {share:.2f}  n {len(seen[share, TWO_TONE[1]])}  power {power:.2f}   " + "   ".join(cells))


def scores(item: Specimen, image: Image) -> dict[str, float]:
    """Return all columns of an image."""
    score = Appearance().score(Observation(item.texture.image, image, item.texture, again=item.again))
    found = breaks(item, image)
    values = {name: float(value) for name, value in score.values.items() if value is not None}
    if not isinstance(found, str):
        values |= {"broken_share": found.share, "evidence_p90": found.evidence_p90}
    return values


def response(count: int, kinds: list[str]) -> None:
    """Print the Spearman correlation of each score with its own defect over single images."""
    for texture in TEXTURES:
        item = specimen(texture)
        for kind in kinds:
            column, largest = RESPONSES[kind]
            if kind == "two-tone" and item.name.startswith("weave"):
                largest = WOVEN_TWO_TONE
            sizes, values = [], []
            for size in largest * np.arange(1, 9) / 8:
                for seed in range(count):
                    image = planted(item, kind, float(size), seed)
                    found = breaks(item, image) if column == "broken_share" else None
                    if found is None:
                        seen = Appearance().score(
                            Observation(item.texture.image, image, item.texture, again=item.again)
                        )
                        value = seen.values[column]
                    else:
                        value = np.nan if isinstance(found, str) else found.share
                    sizes.append(size)
                    values.append(value)
            rho = spearmanr(sizes, values).statistic
            print(
                f"{item.name:16} {kind:14} {column:16} up to {largest:g}: Spearman {rho:+.3f} (n {len(sizes)})",
                flush=True,
            )


def silence(count: int) -> None:
    """Print how far each score moves under each defect, in standard deviations of fresh draws."""
    for texture in TEXTURES:
        item = specimen(texture)
        fresh = [scores(item, item.fresh(256, k)) for k in range(2 * count)]
        print(f"{item.name} (share {item.share})".ljust(24) + "".join(f"{name:>16}" for name in COLUMNS))
        center = {name: np.mean([one[name] for one in fresh]) for name in COLUMNS}
        spread = {name: np.std([one[name] for one in fresh], ddof=1) for name in COLUMNS}
        print("fresh draws".ljust(24) + "".join(f"{center[name]:9.3f}±{spread[name]:<6.3f}" for name in COLUMNS))
        for kind, size in SILENT_SIZES.items():
            found = [scores(item, planted(item, kind, size, seed)) for seed in range(count)]
            mean = {name: np.mean([one[name] for one in found]) for name in COLUMNS}
            cells = [(mean[name] - center[name]) / max(spread[name], 1e-3) for name in COLUMNS]
            print(f"{kind} {size:g}".ljust(24) + "".join(f"{cell:+16.1f}" for cell in cells), flush=True)


def wall(seed: int) -> Specimen:
    """Return a brick wall with its fresh draws."""
    model = Brick(color=0.3, noise=0.03)
    texture = model.render((128, 128), stream("render", "methods", seed))

    def again(shape: Shape, k: int) -> Texture | None:
        drawn = model.again(texture, shape, stream("again", "methods", seed, k))
        return None if drawn is None else replace(drawn, image=quantize(drawn.image))

    assert texture.lattice is not None
    sampled = replace(texture, image=quantize(texture.image))
    measure = model_yardstick(sampled, texture.lattice, again)
    return Specimen("brick", model.regular_share, sampled, again, measure, look_at_references(measure))


def outputs(item: Specimen, seed: int) -> dict[str, Image]:
    """Return outputs of the oracle and of random sampling and gap filling."""
    rng, shape = stream("synthesis", "methods", seed), (256, 256)
    task = Task(item.texture.image, shape, item.texture.lattice, rng, again=item.again)
    methods = {"oracle": Oracle(), "rsgf block 20": Rsgf(block=20, border=5), "rsgf default": Rsgf()}
    return {name: quantize(method.synthesize(task).image) for name, method in methods.items()}


def methods(count: int, directory: Path | None) -> None:
    """Print broken tiles of fresh draws and of a method that cuts and blends, on brick walls."""
    rows = defaultdict(list)
    for seed in range(count):
        item = wall(seed)
        for name, image in outputs(item, seed).items():
            found = breaks(item, image)
            if isinstance(found, str):
                continue
            rows[name].append((found.share, found.number, found.evidence_p90, found.power))
            if directory is not None and found.number and seed == 0:
                write_image(directory / f"{name.replace(' ', '-')}.png", broken_map(image, found))
                write_image(directory / f"{name.replace(' ', '-')}-worst.png", worst_tiles(image, found))
                write_image(directory / f"{name.replace(' ', '-')}-output.png", image)
    for name, some in rows.items():
        share, number, ratio, power = np.mean(some, 0)
        low, high = np.min(some, 0)[0], np.max(some, 0)[0]
        print(
            f"{name:16} broken share {share:.3f} ({low:.3f} to {high:.3f})  tiles {number:.1f}  evidence {ratio:.2f}",
            end="",
        )
        print(f"  power {power:.2f}  n {len(some)}")


def main() -> None:
    """Run one of the parts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=("alarms", "response", "silence", "methods"))
    parser.add_argument("--half", choices=FIRST_SEED, default="report", help="of alarms: which seeds")
    parser.add_argument("--count", type=int, default=20, help="textures of alarms, seeds of the others")
    parser.add_argument("--draws", type=int, default=3, help="of alarms: fresh draws a texture and side")
    parser.add_argument(
        "--kinds", nargs="*", choices=RESPONSES, default=list(RESPONSES), help="of response: which faults"
    )
    parser.add_argument("--sides", type=int, nargs="*", default=SIDES, help="of alarms: output sizes in px")
    parser.add_argument("--pictures", type=Path, help="of methods: folder for pictures of broken tiles")
    arguments = parser.parse_args()
    if arguments.part == "alarms":
        alarms(arguments.half, arguments.count, tuple(arguments.sides), arguments.draws)
    elif arguments.part == "methods":
        methods(arguments.count, arguments.pictures)
    elif arguments.part == "response":
        response(arguments.count, arguments.kinds)
    else:
        silence(arguments.count)


if __name__ == "__main__":
    main()
