"""What each limit of the judge decides: the ranking and the false alarms when it is multiplied by 0.8 and by 1.25.

``python benchmarks/sensitivity.py RUN [--textures PATTERN ...] [--limits PATTERN ...] [--draws N] [--keep FILE.csv]``

RUN is the directory of a run of the suite ``default``, which is made if there is none. Its stored outputs and fresh
draws of its textures are judged again. Prints for each limit and factor Kendall's tau between the order of the methods
by mean ``quality`` and that with the table as it is, the largest change of a method's mean, the share of verdicts that
change, and the mean quality and the false alarms (quality below 0.9) of fresh draws. Every limit of ``nrbench show
limits`` is changed alone. Of a share or quantile near 1, such as 0.999, the rest to 1 is multiplied.

Then it prints, for each factor with a tau below 0.9, the pairs of methods whose order turns, how far their means are
apart, and the standard error of the difference between textures.

A result that was computed without reading a limit is kept when that limit changes (:class:`Memory`). ``--keep`` writes
the qualities of all outputs for each change; a file that is there is read, and only the textures that it lacks are
judged. ``--draws`` is the number of draws of each texture whose outputs are judged, with a fresh one each.
"""

import functools
import itertools
import sys
import time
from collections.abc import Callable, Hashable, Iterator, Sequence
from fnmatch import fnmatch
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import kendalltau
from studies import read_options
from validation import FIRST_DRAW, LEAST_FRESH, Subject, print_table, subject_of

import nrbench
from nrbench.imaging.convert import quantize
from nrbench.metrics import appearance
from nrbench.metrics.perception import limits
from nrbench.metrics.perception.visible import measure_detail, measure_levels, measure_looks
from nrbench.metrics.quality import Quality
from nrbench.pictures.files import read_image
from nrbench.plugins.forms import Observation
from nrbench.runs.records import CellRecord

FACTORS = (0.8, 1.25)
LEAST_TAU = 0.9
"""Tau below which a limit decides the order of the methods."""
_NEAR_ONE = 0.2
"""Difference to 1 up to which a limit without a unit is near 1."""
_UNCHANGED = "unchanged"
_FRESH = "fresh"
Outputs = list[tuple[str, Observation]]
"""Outputs of a texture, each with its method."""
_PACKAGE = f"{nrbench.__name__}.metrics"


class _Result(NamedTuple):
    """A kept result, the limits that were read for it, and the owner, whose id must not be given away."""

    value: Any
    read: frozenset[str]
    owner: object


class Memory:
    """Results of the judge, with the limits that were read for each.

    It stands in for all caches of the metrics: cached functions, cached properties and what an observation shares.
    While a limit is changed, results for which it was not read are kept, and all others are computed again.
    """

    def __init__(self) -> None:
        self._usual: dict[Hashable, _Result] = {}
        self._changed: dict[Hashable, _Result] = {}
        self._read: list[set[str]] = [set()]
        self.limit = ""

    def note(self, limit: str) -> None:
        """Note that a limit is read."""
        self._read[-1].add(limit)

    def clear(self) -> None:
        """Forget all results."""
        self._usual.clear()
        self.change("")

    def change(self, limit: str) -> None:
        """Forget the results of the last change; from now on, results for which ``limit`` was read do not count."""
        self.limit = limit
        self._changed.clear()

    def recall(self, key: Hashable, owner: object, make: Callable[[], Any]) -> Any:
        """Return a result, which is computed only if there is none that counts."""
        found = self._changed.get(key)
        if found is None and (found := self._usual.get(key)) and self.limit in found.read:
            found = None
        if found is None:
            self._read.append(set())
            try:
                value = make()
            finally:
                read = self._read.pop()
                self._read[-1] |= read
            found = _Result(value, frozenset(read), owner)
            (self._changed if self.limit else self._usual)[key] = found
        self._read[-1] |= found.read
        return found.value

    def cover(self, package: str) -> None:
        """Replace all caches of a package, and note whenever a limit is read."""
        modules = [module for name, module in sys.modules.items() if name.startswith(package)]
        functions = {
            value: self._function(value)
            for module in modules
            for value in vars(module).values()
            if isinstance(value, functools._lru_cache_wrapper) and value.__module__.startswith(package)
        }
        for module in modules:
            for name, value in list(vars(module).items()):
                if isinstance(value, functools._lru_cache_wrapper) and value in functions:
                    setattr(module, name, functions[value])
                if isinstance(value, type) and value.__module__ == module.__name__:
                    for part, cached in list(vars(value).items()):
                        if isinstance(cached, functools.cached_property):
                            setattr(value, part, property(self._property(cached.func)))
        for measure in (measure_looks, measure_detail, measure_levels):
            setattr(appearance, measure.__name__, self._measure(measure))
        Observation.shared = self._shared()  # type: ignore[method-assign]
        names, note = {limit.name for limit in limits.TABLE}, self.note

        class Noting(ModuleType):
            """The table of limits; each limit that is read is noted."""

            def __getattribute__(self, name: str) -> Any:
                if name in names:
                    note(name)
                return super().__getattribute__(name)

        limits.__class__ = Noting

    def _function(self, cached: Any) -> Callable[..., Any]:
        make = cached.__wrapped__

        def call(*given: Any, **named: Any) -> Any:
            key = (make, given, tuple(named.items()))
            return self.recall(key, None, lambda: make(*given, **named))

        return call

    def _measure(self, make: Callable[[Any], Any]) -> Callable[[Any], Any]:
        return lambda lab: self.recall((make, id(lab)), lab, lambda: make(lab))

    def _property(self, make: Callable[[Any], Any]) -> Callable[[Any], Any]:
        return lambda owner: self.recall((make, id(owner)), owner, lambda: make(owner))

    def _shared(self) -> Callable[[Observation, Callable[[Observation], Any]], Any]:
        return lambda seen, make: self.recall((make, id(seen._shared)), seen, lambda: make(seen))


def read_outputs(folder: Path, patterns: Sequence[str], draws: int) -> Iterator[tuple[str, Outputs]]:
    """Yield each texture of a run with its ranked outputs, by method, and fresh draws, by the name ``fresh``."""

    def wanted(record: CellRecord) -> bool:
        named = not patterns or any(fnmatch(record.texture, pattern) for pattern in patterns)
        return record.status == "ok" and named and not record.reference and record.lattice_source != "own"

    records = sorted(filter(wanted, nrbench.load(folder).cells), key=lambda record: record.texture)
    for texture, group in itertools.groupby(records, key=lambda record: record.texture):
        subjects: dict[int, Subject] = {}
        found: Outputs = []
        for record in group:
            output, number = read_image(record.folder / "output.png"), record.cell.recipe.replicate
            if number >= draws:
                continue
            if number not in subjects:
                subject = subjects[number] = subject_of(record.cell.recipe)
                assert subject.again is not None
                drawn = subject.again((output.shape[0], output.shape[1]), FIRST_DRAW + number)
                found.append((_FRESH, subject.observe(quantize(drawn.image))))
            found.append((record.method, subjects[number].observe(output)))
        yield texture, found


def changed_limits(patterns: Sequence[str]) -> Iterator[tuple[str, float, float]]:
    """Yield the name, the factor and the new value of each change; at first ``unchanged``."""
    yield _UNCHANGED, 1.0, np.nan
    for limit in limits.TABLE:
        if any(fnmatch(limit.name, pattern) for pattern in patterns):
            whole, rest = isinstance(getattr(limits, limit.name), int), 1 - limit.value
            for factor in FACTORS:
                value = 1 - rest * factor if not limit.unit and 0 < rest < _NEAR_ONE else limit.value * factor
                yield limit.name, factor, int(np.rint(value)) if whole else value


def judge_texture(outputs: Outputs, patterns: Sequence[str], memory: Memory) -> Iterator[dict[str, Any]]:
    """Yield the quality and the regularity of all outputs of a texture, as it is and for each change."""
    memory.clear()
    for name, factor, value in changed_limits(patterns):
        usual = getattr(limits, name, None)
        if usual is not None:
            setattr(limits, name, value)
            memory.change(name)
        for number, (method, seen) in enumerate(outputs):
            score = Quality().score(seen).values
            row = {"output": number, "method": method, "limit": name, "factor": factor, "value": value}
            yield row | {column: score[column] for column in ("score", "regularity")}
        if usual is not None:
            setattr(limits, name, usual)
    memory.clear()


def print_changes(table: pd.DataFrame) -> None:
    """Print one line for each change, and the pairs of methods whose order turns."""
    by = ["texture", "output"]
    changes = {key: part.set_index(by) for key, part in table.groupby(["limit", "factor"], sort=False)}
    before = changes.pop((_UNCHANGED, 1.0))
    ranked = before["method"] != _FRESH
    methods = before.loc[ranked, "method"]
    usual = before.loc[ranked, "score"].groupby(methods).mean().sort_values()
    print(usual.round(3).to_string())
    columns = "tau", "largest change of a mean", "verdicts changed", "fresh draws: mean", f"below {LEAST_FRESH}"
    tell, turned = print_table("limit", "value", *columns), []
    for (name, factor), frame in changes.items():
        means = frame.loc[ranked, "score"].groupby(methods).mean().reindex(usual.index)
        tau = kendalltau(usual, means).statistic
        kept = [part["regularity"].astype(float) >= limits.PRESERVED for part in (before, frame)]
        fresh = frame.loc[~ranked, "score"]
        shift, moved = (means - usual).abs().max(), (kept[0] != kept[1]).mean()
        alarms = f"{(~(fresh >= LEAST_FRESH)).sum()} of {len(fresh)}"
        cells = f"{tau:.2f}", f"{shift:.3f}", f"{moved:.3f}", f"{fresh.mean():.3f}", alarms
        tell(name, f"{frame['value'].iloc[0]:g}", *cells)
        if tau < LEAST_TAU:
            pairs = itertools.combinations(usual.index, 2)
            turned += [(name, factor, one, two) for one, two in pairs if means[one] >= means[two]]
    print(f"\n{len({name for name, *_ in turned})} limits with a tau below {LEAST_TAU}\n")
    tell = print_table("limit", "factor", "lower", "higher", "difference of their means", "standard error")
    wide = before[ranked].pivot_table(index="texture", columns="method", values="score")
    for name, factor, one, two in turned:
        apart = wide[two] - wide[one]
        tell(name, f"{factor:g}", one, two, f"{usual[two] - usual[one]:.3f}", f"{apart.std() / len(apart) ** 0.5:.3f}")


def main() -> None:
    """Change each limit and print the tables."""
    more = {"textures": [], "limits": ["*"], "draws": 2, "keep": ""}
    options = read_options(__doc__, ["run"], run=Path("runs/default"), **more)
    if not options.run.exists():
        nrbench.run("default", out=options.run)
    appearance._seam = lambda observation: (None, None, None)  # a seam does not count in any score
    memory, begun = Memory(), time.process_time()
    memory.cover(_PACKAGE)
    known = bool(options.keep) and Path(options.keep).exists()
    table = pd.read_csv(options.keep) if known else pd.DataFrame({"texture": []})
    for texture, outputs in read_outputs(options.run, options.textures, options.draws):
        if texture in set(table["texture"]):
            continue
        rows = pd.DataFrame(judge_texture(outputs, options.limits, memory)).assign(texture=texture)
        table = pd.concat([table, rows.astype({"score": float, "regularity": float})], ignore_index=True)
        if options.keep:
            table.to_csv(options.keep, index=False)
        print(f"{texture}: {(time.process_time() - begun) / 60:.1f} CPU minutes", file=sys.stderr, flush=True)
    print_changes(table)


if __name__ == "__main__":
    main()
