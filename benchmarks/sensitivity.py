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
import re
from collections.abc import Sequence
from fnmatch import fnmatch
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
from scipy.stats import kendalltau
from validation import LEAST_FRESH, Subject, print_table, subject_of

import nrbench
from nrbench.metrics import appearance, integrity, randomness, regularity
from nrbench.metrics.judgment import texture_reference
from nrbench.metrics.perception import limits
from nrbench.metrics.quality import Quality
from nrbench.pictures.files import read_image
from nrbench.plugins.forms import Observation

FACTORS = (0.8, 1.25)
Outputs = list[tuple[str, Observation]]
CACHES = {
    regularity: (texture_reference.perceive_draws, texture_reference.reference_from_draws),
    integrity: (integrity.learn_elements,),
    randomness: (randomness.gather_tiles,),
    appearance: (appearance._measure_draws, appearance._looks_of_draws),
}
"""The module of each peril, with what is learned there, or before all of them, from references by the limits."""


def stored_outputs(folder: Path, patterns: Sequence[str], draws: int) -> Outputs:
    """Return the ranked outputs of each texture of a run, by method, and fresh draws, by the name ``fresh``."""
    subjects: dict[str, Subject] = {}
    found: Outputs = []
    for record in nrbench.load(folder).cells:
        wanted = not patterns or any(fnmatch(record.texture, pattern) for pattern in patterns)
        if record.status != "ok" or not wanted:
            continue
        if record.texture not in subjects:
            subject = subjects[record.texture] = subject_of(record.cell.recipe)
            found += [("fresh", subject.observe(subject.draw(number))) for number in range(draws)]
        if not record.reference:
            output = read_image(record.folder / "output.png")
            found.append((record.method, subjects[record.texture].observe(output)))
    return sorted(found, key=lambda pair: id(pair[1].again))


def find_user(limit: str) -> ModuleType | None:
    """Return the module of the one peril that reads a limit; None if others read it."""
    root = Path(str(appearance.__file__)).parent
    users = {path for path in root.rglob("*.py") if re.search(rf"limits\.{limit}\b", path.read_text("utf-8"))}
    return next((module for module in CACHES if users == {Path(str(module.__file__))}), None)


def judge_all(outputs: Outputs, only: ModuleType | None = None) -> pd.DataFrame:
    """Judge all outputs by the limits as they are now; with ``only``, the other perils are as they were."""
    for module, caches in CACHES.items():
        if only is None or (module is only and module is not regularity):
            for cache in caches:
                cache.cache_clear()
    rows = []
    for method, seen in outputs:
        if only is None:
            values = Quality().score(Observation(seen.sample, seen.output, seen.truth, again=seen.again)).values
        else:
            kept = seen._shared.pop(only._score, None)
            values = Quality().score(seen).values
            seen._shared[only._score] = kept
        rows.append({"method": method, **values})
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
    outputs = stored_outputs(options.run, options.textures, options.draws)
    before = pd.DataFrame([{"method": method, **Quality().score(seen).values} for method, seen in outputs])
    before = before.astype({"score": float})
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
            table = judge_all(outputs, find_user(name)) if limit else before
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
