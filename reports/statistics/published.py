"""Compare the verdicts of a run with those that the report of 2004 published for the same figures.

The textures of a run are analogues: they were drawn from the descriptions of the figures. Rates over many figures can
be compared. A single figure cannot, so the agreement by figure is shown beside the agreement that chance reaches.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from nrbench.runs.records import Run
from nrbench.streams import stream

from .comparison import Comparison, Method
from .estimates import Estimate, count_answers, estimate_mean, estimate_rate, kappa
from .verdicts import tabulate_cells

SENTENCE = (
    "The textures are analogues, not the report's images: they were drawn from the descriptions of its figures. "
    "They are a fixed list and no sample of a population of textures."
)
GROUPS: Mapping[str, tuple[int, int, tuple[str, ...]]] = {
    "figures 3-7": (3, 7, ("graph-cuts", "tile-set", "regularized-patch", "patch-based")),
    "figures 8-29": (8, 29, ("graph-cuts", "tile-set", "regularized-patch", "patch-based")),
    "figures 8-45": (8, 45, ("graph-cuts", "tile-set")),
    "six figures": (16, 36, ("quilting",)),
}
"""The figures on which the report ran methods: the first, the last, and the methods that ran on all of them. Image
quilting ran on six of the figures 16 to 36."""
LATTICES: Mapping[str, tuple[str, ...]] = {
    "tile-set": ("own", "given"),
    "regularized-patch": ("given", "own"),
}
"""The sources of the lattice as in the report, preferred one first: tile-set found its own, and the user drew that of
the regularized patch-based method."""
WORDS = ("preserved", "lost")
_SHUFFLES = 2000


@dataclass(frozen=True)
class PublishedFigure:
    """One figure of the report (tables 2 and 3).

    Parameters
    ----------
    number, description
        As printed.
    kind
        Class of the texture: brick, woven, tiles, motif or damaged. The class is ours, made from the description.
    verdicts
        ``preserved`` or ``lost`` by method; a method that the report did not run on this figure is absent.
    """

    number: int
    description: str
    kind: str
    verdicts: Mapping[str, str]


@cache
def read_published() -> tuple[PublishedFigure, ...]:
    """Return the verdicts of the report's tables 2 and 3, in the order of the figures."""
    text = files(__package__).joinpath("published_verdicts.csv").read_text("utf-8")
    return tuple(
        PublishedFigure(
            int(row.pop("figure")),
            row.pop("description"),
            row.pop("class"),
            {method: word for method, word in row.items() if word},
        )
        for row in csv.DictReader(text.splitlines())
    )


@dataclass(frozen=True)
class FigureRow:
    """One figure: the published verdict and the measured share of each method.

    Parameters
    ----------
    figure
        The figure.
    texture
        Name of the analogue.
    measured
        Share of the replicates that preserve the lattice, for each method of the comparison; None without a verdict.
    """

    figure: PublishedFigure
    texture: str
    measured: Sequence[float | None]


@dataclass(frozen=True)
class RateRow:
    """The published and the measured success rate of a method over the same figures.

    Parameters
    ----------
    group
        A key of :data:`GROUPS`.
    method
        The method as measured.
    published
        The published rate over all figures of the group, with its interval: a bootstrap over figures, or Wilson's
        interval if all figures agree.
    same, measured
        The published and the measured rate over the figures with a measured verdict, with such intervals.
    difference
        Measured minus published over these figures, with a bootstrap interval over figures.
    """

    group: str
    method: Method
    published: Estimate
    same: Estimate
    measured: Estimate
    difference: Estimate


@dataclass(frozen=True)
class ClassRow:
    """The agreement of measured with published verdicts on one class of textures.

    Parameters
    ----------
    kind
        The class; "all" for all figures.
    pairs
        Number of published verdicts with a measured one.
    agreement
        Mean over figures of the share of agreeing verdicts, with a bootstrap interval over figures.
    """

    kind: str
    pairs: int
    agreement: Estimate


@dataclass(frozen=True)
class PublishedComparison:
    """A run beside the report of 2004.

    Parameters
    ----------
    methods
        The methods that the report ran and the run has.
    figures
        The figures of which the run has an analogue.
    rates, classes
        Rates over groups of figures, and the agreement by class of texture.
    kappa
        Cohen's kappa of measured and published verdicts, figure by figure; None if it does not exist. A share of
        one half or more counts as preserved.
    chance
        Mean and 95th percentile of kappa if the published verdicts are paired at random with measured ones of figures
        of the same description; None if kappa does not exist.
    """

    methods: Sequence[Method]
    figures: Sequence[FigureRow]
    rates: Sequence[RateRow]
    classes: Sequence[ClassRow]
    kappa: float | None
    chance: tuple[float, float] | None

    def table(self, regular: bool) -> list[FigureRow]:
        """Return the rows of table 2 (regular textures, figures 3 to 7) or of table 3 (figures 8 to 45)."""
        return [row for row in self.figures if (row.figure.number <= 7) == regular]


def compare_with_published(run: Run, comparison: Comparison) -> PublishedComparison | None:
    """Compare a run with the report; None if it has no analogue of a figure, or none of the report's methods.

    Parameters
    ----------
    run
        The run. The rows of its suite say which texture is the analogue of which figure.
    comparison
        The comparison of the run, which gives the methods.
    """
    rows = run.info.get("suite", {}).get("content", {}).get("texture", [])
    names = {row["figure"]: row["name"] for row in rows if row.get("figure")}
    methods = [one for name in _report_methods() if (one := _find_method(name, comparison.methods)) is not None]
    known = [figure for figure in read_published() if figure.number in names]
    if not known or not methods:
        return None
    cells = tabulate_cells(run)
    shares = [_measured_shares(cells[cells["label"] == method.label]) for method in methods]
    figures = [
        FigureRow(figure, names[figure.number], [own.get(names[figure.number]) for own in shares]) for figure in known
    ]
    observed, chance = _compare_cells(figures, methods)
    kinds = list(dict.fromkeys(figure.kind for figure in known))
    return PublishedComparison(
        methods=methods,
        figures=figures,
        rates=[
            rate
            for group, (_, _, ran) in GROUPS.items()
            for i, method in enumerate(methods)
            if method.base in ran and (rate := _rate(group, method, figures, i)) is not None
        ],
        classes=[_class_agreement(kind, figures, methods) for kind in [*kinds, "all"]],
        kappa=observed,
        chance=chance,
    )


def _report_methods() -> list[str]:
    return list(dict.fromkeys(method for figure in read_published() for method in figure.verdicts))


def _find_method(name: str, methods: Sequence[Method]) -> Method | None:
    """Return the column of a method, with default parameters and the report's source of the lattice if it exists."""
    sources = LATTICES.get(name, ())

    def preference(method: Method) -> tuple[bool, int]:
        source = method.lattice_source
        return method.name != name, sources.index(source) if source in sources else len(sources)

    return min((method for method in methods if method.base == name), key=preference, default=None)


def _measured_shares(cells: pd.DataFrame) -> dict[str, float]:
    """Return the share of preserved replicates by texture; failures and refusals count as lost."""
    decided = cells[cells["verdict"].isin(["preserved", "lost", "failed", "refused"])]
    return {
        str(name): float(value)
        for name, value in decided["verdict"].eq("preserved").groupby(decided["texture"]).mean().items()
    }


def _in_group(row: FigureRow, group: str, name: str) -> bool:
    first, last, _ = GROUPS[group]
    return first <= row.figure.number <= last and name in row.figure.verdicts


def _rate(group: str, method: Method, figures: Sequence[FigureRow], index: int) -> RateRow | None:
    name = method.base
    rows = [row for row in figures if _in_group(row, group, name)]
    if not rows:
        return None
    published = np.array([row.figure.verdicts[name] == WORDS[0] for row in rows], float)
    measured = np.array([np.nan if (share := row.measured[index]) is None else share for row in rows])
    decided = np.isfinite(measured)
    gap = measured[decided] - published[decided]
    return RateRow(
        group=group,
        method=method,
        published=estimate_rate(published, len(rows)),
        same=estimate_rate(published[decided], len(rows)),
        measured=estimate_rate(measured[decided], len(rows)),
        difference=estimate_mean(gap, len(rows)),
    )


def _class_agreement(kind: str, figures: Sequence[FigureRow], methods: Sequence[Method]) -> ClassRow:
    means, pairs, of = [], 0, 0
    for row in figures:
        if kind not in (row.figure.kind, "all"):
            continue
        of += 1
        equal = [
            share if row.figure.verdicts[name] == WORDS[0] else 1 - share
            for method, share in zip(methods, row.measured, strict=True)
            if share is not None and (name := method.base) in row.figure.verdicts
        ]
        if equal:
            means.append(float(np.mean(equal)))
            pairs += len(equal)
    return ClassRow(kind, pairs, estimate_mean(means, of))


def _compare_cells(
    figures: Sequence[FigureRow], methods: Sequence[Method]
) -> tuple[float | None, tuple[float, float] | None]:
    """Return kappa figure by figure, and its mean and 95th percentile under random pairing within a description."""
    pairs = [
        (row.figure.verdicts[name], WORDS[0] if share >= 0.5 else WORDS[1], (row.figure.description, name))
        for row in figures
        for method, share in zip(methods, row.measured, strict=True)
        if share is not None and (name := method.base) in row.figure.verdicts
    ]
    if not pairs:
        return None, None
    published, measured, strata = (list(part) for part in zip(*pairs, strict=True))
    observed = _kappa_of([published], measured)[0]
    if not np.isfinite(observed):
        return None, None
    rng = stream("bootstrap", "published")
    groups = [np.flatnonzero([one == stratum for one in strata]) for stratum in dict.fromkeys(strata)]
    words = np.array(published)
    shuffled = []
    for _ in range(_SHUFFLES):
        order = np.arange(len(words))
        for group in groups:
            order[group] = rng.permutation(group)
        shuffled.append(words[order].tolist())
    values = _kappa_of(shuffled, measured)
    values = values[np.isfinite(values)]
    return float(observed), (float(values.mean()), float(np.quantile(values, 0.95)))


def _kappa_of(published: Sequence[Sequence[str]], measured: Sequence[str]) -> NDArray[np.float64]:
    """Return Cohen's kappa of each list of published verdicts with the measured ones."""
    units = [""] * len(measured)
    return kappa(np.concatenate([count_answers(each, measured, units, WORDS, [""]) for each in published]))


def published_table(published: PublishedComparison) -> pd.DataFrame:
    """Return one row a figure and method: the published verdict and the measured share of preserved replicates."""
    names = ["figure", "description", "class", "texture", "method", "lattice_source", "published", "measured_share"]
    rows = [
        [
            *(row.figure.number, row.figure.description, row.figure.kind, row.texture),
            *(method.name, method.lattice_source, row.figure.verdicts.get(method.base), share),
        ]
        for row in published.figures
        for method, share in zip(published.methods, row.measured, strict=True)
    ]
    return pd.DataFrame(rows, columns=names)


def published_rates_table(published: PublishedComparison) -> pd.DataFrame:
    """Return one row a group of figures and method: published and measured rates, and their difference."""
    parts = ("published", "same", "measured", "difference")
    names = [f"{part}{end}" for part in parts for end in ("", "_low", "_high", "_n")]
    rows = [
        [one.group, one.method.name, one.method.lattice_source]
        + [value for part in parts for value in _numbers(getattr(one, part))]
        for one in published.rates
    ]
    return pd.DataFrame(rows, columns=["figures", "method", "lattice_source", *names])


def published_classes_table(published: PublishedComparison) -> pd.DataFrame:
    """Return one row a class of textures: the agreement with its interval; kappa and its chance on the last row."""
    rows = [[one.kind, one.pairs, *_numbers(one.agreement), None, None, None] for one in published.classes]
    rows[-1][-3:] = [published.kappa, *(published.chance or (None, None))]
    names = ["class", "pairs", "agreement", "low", "high", "figures", "kappa", "chance_mean", "chance_95"]
    return pd.DataFrame(rows, columns=names)


def _numbers(one: Estimate) -> list[float | int | None]:
    return [one.value, one.low, one.high, one.n]
