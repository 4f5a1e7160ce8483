"""Which scores speak of which faults: one matrix of planted kinds x headline columns.

``OMP_NUM_THREADS=1 python benchmarks/silence.py --out FILE.csv``: every planted fault, at a size that its own score
sees well, on brick, weave and hexagon of regular share 0.8, scored by ``integrity``, ``appearance``, ``deformation``,
``ga_score`` and ``self_similarity``. A cell is the share of images outside the column's 95 % band of fresh draws of the
same texture (Student's prediction interval for one more draw): about 0.05 where the score is silent. The row *fresh*
holds each fresh draw against the others. Values go to the file as they come, and those in it are not measured again;
``--count 8`` seeds a texture and kind make 24 images a cell. With ``--table`` the matrix of the file is printed as
Markdown and nothing is measured.
"""

from __future__ import annotations

import argparse
import csv
from collections import defaultdict
from pathlib import Path

import numpy as np
from scipy.stats import t
from validation_textures import Specimen, specimen

from nrbench.imaging.convert import Image
from nrbench.metrics.appearance import Appearance
from nrbench.metrics.deformation import Deformation
from nrbench.metrics.geometry_appearance import GeometryAppearance
from nrbench.metrics.integrity import Integrity
from nrbench.metrics.self_similarity import SelfSimilarity
from nrbench.plugins.forms import Observation

TEXTURES = (6, 10, 8)
"""Seeds of the textures: brick, weave rotated, hexagon, of regular share 0.8."""
FRESH_A_SEED = 3
KINDS = {
    "phase-step": 0.3,
    "slipped-course": 0.3,
    "dropped-row": 0.5,
    "doubled-row": 0.5,
    "displaced-tile": 0.3,
    "missing-tile": 1.0,
    "doubled-tile": 0.5,
    "warp": 0.1,
    "stretch": 0.15,
    "off-lattice": 0.3,
    "blurred-band": 0.2,
    "seam": 0.1,
    "color-mean": 0.1,
    "two-tone": 0.2,
    "over-regular": 0.6,
    "verbatim": 0.4,
}
METRICS = {
    "integrity": Integrity(),
    "appearance": Appearance(),
    "deformation": Deformation(),
    "ga_score": GeometryAppearance(),
    "self_similarity": SelfSimilarity(),
}
Rows = dict[tuple[str, str, str], dict[str, float]]
"""By texture, kind and seed: the columns that were not None."""


def columns(item: Specimen, image: Image) -> dict[str, float]:
    """Return all columns of an image that are not None and do not speak of the sample alone."""
    seen = Observation(item.texture.image, image, item.texture, again=item.again, rng=np.random.default_rng(0))
    found = {
        f"{name}.{key}": value for name, metric in METRICS.items() for key, value in metric.score(seen).values.items()
    }
    return {name: float(value) for name, value in found.items() if value is not None and ".sample_" not in name}


def measured(path: Path) -> Rows:
    """Return what the file holds."""
    rows: Rows = defaultdict(dict)
    if path.exists():
        with path.open(newline="") as file:
            for texture, kind, seed, column, value in csv.reader(file):
                rows[texture, kind, seed][column] = float(value)
    return rows


def measure(path: Path, count: int) -> None:
    """Score what the file does not hold yet, in an order that leaves all cells alike if interrupted."""
    done = measured(path)
    items = {str(texture): specimen(texture) for texture in TEXTURES}
    for seed in range(FRESH_A_SEED * count):
        for texture, item in items.items():
            for kind, size in {"fresh": 0.0, **(KINDS if seed < count else {})}.items():
                if (texture, kind, str(seed)) in done:
                    continue
                image = item.fresh(256, seed) if kind == "fresh" else item.planted(kind, size, 256, seed)
                if image is not None:
                    with path.open("a", newline="") as file:
                        rows = [(texture, kind, seed, *pair) for pair in columns(item, image).items()]
                        csv.writer(file).writerows(rows)


def outside(value: float, fresh: list[float]) -> bool:
    """Return whether a value lies outside the 95 % prediction interval of one more fresh draw."""
    reach = t.ppf(0.975, len(fresh) - 1) * np.std(fresh, ddof=1) * np.sqrt(1 + 1 / len(fresh))
    return bool(abs(value - np.mean(fresh)) > max(reach, 1e-9))


def table(rows: Rows) -> None:
    """Print the matrix: share of images outside the band (number of images, where it is less than the row's most)."""
    fresh: dict[tuple[str, str], list[float]] = defaultdict(list)
    for (texture, kind, _), values in rows.items():
        for column, value in values.items() if kind == "fresh" else ():
            fresh[texture, column].append(value)
    cells: dict[tuple[str, str], list[bool]] = defaultdict(list)
    for (texture, kind, _), values in rows.items():
        for column, value in values.items():
            others = list(fresh[texture, column])
            if kind == "fresh":
                others.remove(value)
            if len(others) > 1:
                cells[kind, column].append(outside(value, others))
    names = sorted({column for _, column in cells}, key=lambda name: list(METRICS).index(name.split(".")[0]))
    kinds = {"fresh": 0.0, **KINDS}
    print(
        "| column | "
        + " | ".join(kind if kind == "fresh" else f"{kind} {size:g}" for kind, size in kinds.items())
        + " |"
    )
    print("| --- " * (len(kinds) + 1) + "|")
    for name in names:
        shares = [
            f"{np.mean(cells[kind, name]):.2f} ({len(cells[kind, name])})" if cells[kind, name] else "-"
            for kind in kinds
        ]
        print(f"| `{name}` | " + " | ".join(shares) + " |")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="CSV file of values")
    parser.add_argument("--count", type=int, default=8, help="seeds a texture and kind")
    parser.add_argument("--table", action="store_true", help="print the matrix of what the file holds")
    arguments = parser.parse_args()
    if not arguments.table:
        measure(arguments.out, arguments.count)
    table(measured(arguments.out))


if __name__ == "__main__":
    main()
