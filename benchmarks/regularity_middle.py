"""What the judge of regularity sees at a regular share of 0.5, between the shares of the detectability table.

Run it on one thread: ``OMP_NUM_THREADS=1 python benchmarks/regularity_middle.py [--count 30] [--share 0.5]``. Verdicts
on 256 x 256 px outputs of ``count`` textures of each half: fresh draws, courses that slid by 0.15 and 0.2 s, warps of
0.15 s.
"""

from __future__ import annotations

import argparse
from collections import Counter

import validation_textures
from validation_textures import FIRST_SEED, specimen

SIDE = 256
PLANTED = (("slipped-course", 0.15), ("slipped-course", 0.2), ("warp", 0.15))
WORDS = {True: "preserved", False: "lost", None: "undecided"}


def verdicts(seed: int) -> list[tuple[str, str]]:
    """Return each output's kind and verdict, for the texture of a seed."""
    seen = specimen(seed)
    images = [("fresh draw", seen.fresh(SIDE, 50 + k)) for k in range(2)]
    images += [(f"{kind} {size}", seen.planted(kind, size, SIDE, seed)) for kind, size in PLANTED]
    return [(kind, WORDS[seen.judged(image).preserved]) for kind, image in images if image is not None]


def main() -> None:
    """Print how often each kind of output gets each verdict."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--share", type=float, default=0.5)
    options = parser.parse_args()
    validation_textures.SHARES = (options.share,)
    seeds = [first + number for first in FIRST_SEED.values() for number in range(options.count)]
    counts = Counter(one for seed in seeds for one in verdicts(seed))
    for (kind, verdict), number in sorted(counts.items()):
        print(f"{kind:22} {verdict:10} {number:4}")


if __name__ == "__main__":
    main()
