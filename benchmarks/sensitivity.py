"""What each limit of the judge decides: the ranking and the false alarms when it is multiplied by 0.8 and by 1.25.

``python benchmarks/sensitivity.py RUN [--textures PATTERN ...] [--limits PATTERN ...] [--draws N]``

RUN is the directory of a run of the suite ``default``, which is made if there is none. Its stored outputs and fresh
draws of its textures are judged again. Prints for each limit and factor Kendall's tau between the order of the methods
by mean ``quality`` and that with the table as it is, the largest change of a method's mean, the share of verdicts that
change, and the mean quality and the false alarms (quality below 0.9) of fresh draws. Every limit of ``nrbench show
limits`` is changed alone.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from fnmatch import fnmatch
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import kendalltau
from validation import LEAST_FRESH, Subject, print_table, subject_of

import nrbench
from nrbench.imaging.convert import Image
from nrbench.imaging.files import read_image
from nrbench.metrics import appearance, integrity, randomness
from nrbench.metrics.judgment import texture_reference
from nrbench.metrics.perception import limits

FACTORS = (0.8, 1.25)
Outputs = list[tuple[str, Image]]
CACHES = (
    texture_reference.reference_from_draws,
    texture_reference._reference_of,
    integrity.learn_elements,
    randomness.gather_tiles,
    appearance._looks_of_draws,
    appearance._looks_of_sample,
)
"""What is learned from references, which depends on the limits."""


def stored_outputs(folder: Path, patterns: Sequence[str], draws: int) -> list[tuple[Subject, Outputs]]:
    """Return the ranked outputs of each texture of a run, and fresh draws, which have the name ``fresh``."""
    found: dict[str, tuple[Subject, Outputs]] = {}
    for record in nrbench.load(folder).cells:
        wanted = not patterns or any(fnmatch(record.texture, pattern) for pattern in patterns)
        if record.status != "ok" or not wanted:
            continue
        if record.texture not in found:
            subject = subject_of(record.cell.recipe)
            found[record.texture] = subject, [("fresh", subject.draw(number)) for number in range(draws)]
        if not record.reference:
            found[record.texture][1].append((record.method, read_image(record.folder / "output.png")))
    return list(found.values())


def judge_all(textures: Sequence[tuple[Subject, Outputs]]) -> pd.DataFrame:
    """Judge all outputs by the limits as they are now."""
    for cache in CACHES:
        cache.cache_clear()
    rows = [{"method": method, **subject.judge(image)} for subject, outputs in textures for method, image in outputs]
    return pd.DataFrame(rows).astype({"score": float})


def main() -> None:
    """Change each limit and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="directory of a run of the suite default")
    parser.add_argument("--textures", nargs="*", default=[], help="patterns of the run's textures")
    parser.add_argument("--limits", nargs="*", default=["*"], help="patterns of limits")
    parser.add_argument("--draws", type=int, default=3, help="fresh draws of each texture")
    options = parser.parse_args()
    if not options.run.exists():
        nrbench.run("default", out=options.run)
    textures = stored_outputs(options.run, options.textures, options.draws)
    before = judge_all(textures)
    usual = before[before["method"] != "fresh"].groupby("method")["score"].mean()
    columns = "tau", "largest change of a mean", "verdicts changed", "fresh draws: mean", f"below {LEAST_FRESH}"
    tell = print_table("limit", "value", *columns)
    for limit in [None, *limits.TABLE]:
        name = limit.name if limit else "unchanged"
        if limit and not any(fnmatch(name, pattern) for pattern in options.limits):
            continue
        for factor in FACTORS if limit else (1,):
            kind = type(getattr(limits, name)) if limit else float
            value = kind(np.rint(limit.value * factor) if kind is int else limit.value * factor) if limit else "-"
            if limit:
                setattr(limits, name, value)
            table = judge_all(textures) if limit else before
            if limit:
                setattr(limits, name, kind(limit.value))
            means = table[table["method"] != "fresh"].groupby("method")["score"].mean().reindex(usual.index)
            fresh = table.loc[table["method"] == "fresh", "score"]
            kept = [frame["regularity"].astype(float) >= limits.PRESERVED for frame in (before, table)]
            shift, moved = (means - usual).abs().max(), (kept[0] != kept[1]).mean()
            alarms = f"{(~(fresh >= LEAST_FRESH)).sum()} of {len(fresh)}"
            cells = f"{kendalltau(usual, means).statistic:.2f}", f"{shift:.2f}", f"{moved:.3f}", f"{fresh.mean():.3f}"
            tell(name, value if limit is None else f"{value:g}", *cells, alarms)


if __name__ == "__main__":
    main()
