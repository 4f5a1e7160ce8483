"""How the columns of regularity answer: to the size of a fault, to a second set of seeds, to a change of description.

``OMP_NUM_THREADS=1 python benchmarks/regularity_response.py spearman`` prints, for each planted fault, Spearman's
correlation of its size with the column that is meant for it, over single images (``--count`` seeds x 8 sizes of one
texture a family). ``band`` prints the share of fresh draws that fall into the 95 % band of as many others.
``invariance`` prints by how much a column changes under another basis, origin or phase, over its standard deviation
over fresh draws.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.stats import spearmanr
from validation_textures import FIRST_SEED, Specimen, specimen

from nrbench.lattice.geometry import Lattice
from nrbench.metrics.regularity import measured
from nrbench.metrics.verdict.measurements import look_at_references
from nrbench.metrics.verdict.reference import model_yardstick
from nrbench.metrics.verdict.verdict import compare
from nrbench.plugins.forms import Shape, Texture

SIDE = 256
STEPS = np.arange(1, 9) / 8
RESPONSES = {
    "phase-step": ("misplacement_p95", 0.45),
    "slipped-course": ("worst_tile_displacement", 0.45),
    "stretch": ("drift", 0.4),
    "warp": ("misalignment", 0.45),
    "off-lattice": ("misplacement_p95", 0.25),
    "dropped-row": ("misplacement_p95", 0.45),
    "doubled-row": ("misplacement_p95", 0.45),
    "displaced-tile": ("worst_tile_displacement", 0.45),
    "missing-tile": ("worst_tile", 1.0),
    "doubled-tile": ("worst_tile_displacement", 0.5),
}
"""The column meant for each fault, and the largest size before it saturates: for patches that move in directions of
their own 1/4, where two of them are apart by half of s and so come nearer to another lattice point."""
COLUMNS = (
    "score",
    "misplacement_median",
    "misplacement_p95",
    "misalignment",
    "worst_neighborhood",
    "structure",
    "structure_spread",
    "worst_tile",
    "drift",
)


def values(item: Specimen, side: int, draws: range) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Return the columns of fresh draws, ``(n, columns)``."""
    found = (measured(item.judged(item.fresh(side, k))) for k in draws)
    return np.array([[float(one[name] or 0) for name in COLUMNS] for one in found])


def print_spearman(items: list[Specimen], count: int, kinds: list[str]) -> None:
    """Print the correlation of each fault's size with its column."""
    names = " | ".join(f"{item.name} {item.share:.2f}" for item in items)
    print(f"| fault | column | up to | {names} |\n|{' --- |' * (3 + len(items))}")
    for kind in kinds:
        column, most = RESPONSES[kind]
        found = (_spearman(item, kind, column, most, count) for item in items)
        print(f"| {kind} | {column} | {most:g} | {' | '.join(f'{one:.3f}' for one in found)} |", flush=True)


def _spearman(item: Specimen, kind: str, column: str, most: float, count: int) -> float:
    pairs = []
    for seed in range(count):
        for size in STEPS * most:
            image = item.planted(kind, float(size), SIDE, seed)
            if image is not None:
                pairs.append((size, float(measured(item.judged(image))[column] or 0)))
    return float(spearmanr(*np.array(pairs).T).statistic)


def print_bands(items: list[Specimen], count: int) -> None:
    """Print the share of a second set of draws within the 95 % band of the first: order statistics of ``count``."""
    print(f"| texture | {' | '.join(COLUMNS)} |\n|{' --- |' * (1 + len(COLUMNS))}")
    tail = max(round(0.025 * (count + 1)), 1)
    for item in items:
        first, second = (np.sort(values(item, SIDE, range(start, start + count)), 0) for start in (0, count))
        inside = ((second >= first[tail - 1]) & (second <= first[-tail])).mean(0)
        cells = " | ".join(f"{share:.3f}" for share in inside)
        print(f"| {item.name} {item.share:.2f} | {cells} |", flush=True)


def print_invariance(items: list[Specimen], count: int) -> None:
    """Print the largest change of each column, over its standard deviation over fresh draws, and (as it is)."""
    print(f"| texture | change | {' | '.join(COLUMNS)} |\n|{' --- |' * (2 + len(COLUMNS))}")
    for item in items:
        usual = values(item, SIDE, range(count))
        spread = np.maximum(usual.std(0), 1e-9)
        for change, other in described_anew(item):
            away = np.abs(values(other, SIDE, range(count)) - usual).max(0)
            cells = " | ".join(f"{one:.3f} ({size:.1e})" for one, size in zip(away / spread, away, strict=True))
            print(f"| {item.name} {item.share:.2f} | {change} | {cells} |", flush=True)


def described_anew(item: Specimen) -> Iterator[tuple[str, Specimen]]:
    """Return the texture under another basis, another origin, and with its periodic image at another phase."""
    one = item.texture.lattice
    assert one is not None
    (a, b), (c, d), (x, y) = one.t1, one.t2, one.origin
    yield "basis", _described(item, Lattice((a + 2 * c, b + 2 * d), (-a - c, -b - d), one.origin), (0, 0))
    yield "origin", _described(item, one.shifted((3 * a - 2 * c, 3 * b - 2 * d)), (0, 0))
    yield "phase", _described(item, Lattice(one.t1, one.t2, (x - 5, y - 3)), (5, 3))


def _described(item: Specimen, lattice: Lattice, crop: tuple[int, int]) -> Specimen:
    left, top = crop

    def again(shape: Shape, k: int) -> Texture | None:
        drawn = item.again((shape[0] + top, shape[1] + left), k)
        assert drawn is not None and drawn.ideal is not None
        return replace(drawn, image=drawn.image[top:, left:], ideal=drawn.ideal[top:, left:])

    measure = model_yardstick(replace(item.texture, lattice=lattice), lattice, again)
    looks = item.looks if any(crop) else look_at_references(measure)
    assert compare(item.fresh(64, 0), measure, looks)
    return replace(item, measure=measure, looks=looks)


def main() -> None:
    """Run one of the three."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("spearman", "band", "invariance"))
    parser.add_argument("--count", type=int, default=20, help="seeds (band: draws in each set; take 119 or more)")
    parser.add_argument("--kinds", nargs="*", default=tuple(RESPONSES), help="faults (spearman alone)")
    parser.add_argument("--textures", type=int, nargs="*", default=(14, 15, 16), help="numbers of textures")
    arguments = parser.parse_args()
    items = [specimen(FIRST_SEED["report"] + number) for number in arguments.textures]
    if arguments.what == "spearman":
        print_spearman(items, arguments.count, arguments.kinds)
    else:
        {"band": print_bands, "invariance": print_invariance}[arguments.what](items, arguments.count)


if __name__ == "__main__":
    main()
