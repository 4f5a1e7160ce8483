"""Compare the automatic verdicts of a run with the answers of people, and people with each other."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from nrbench.labelling.labels import ANSWERS, Person, read_people, verdict_as_answer
from nrbench.runs.records import CellRecord, Run

from .estimates import Estimate, count_answers, mean_kappa

JUDGE = "judge"
"""The name of the automatic verdict among the raters."""
DECIDED = ANSWERS[:2]
LABEL_COLUMNS = (
    *("person", "texture", "method", "lattice_source", "replicate", "again", "answer", "judge", "seconds", "order"),
    "key",
)
"""The columns of :func:`labels_table`."""


@dataclass(frozen=True)
class RaterAgreement:
    """The agreement of two raters, or its mean over pairs of raters.

    Parameters
    ----------
    first, second
        The raters. For a mean: the common rater or group, and the number of pairs.
    kappa
        Cohen's kappa over :data:`~nrbench.labelling.labels.ANSWERS`; for several pairs the mean.
    decided
        The same over the items that both answered with preserved or lost.
    equal
        Share of equal answers; None without items.
    n
        Number of items that both answered, summed over pairs.
    table
        How often the first answered i and the second j, summed over pairs, in the order of ``ANSWERS``.
    """

    first: str
    second: str
    kappa: Estimate
    decided: Estimate
    equal: float | None
    n: int
    table: Sequence[Sequence[int]]


@dataclass(frozen=True)
class Disagreement:
    """An output on which at least one person and the automatic verdict differ.

    Parameters
    ----------
    record
        The cell.
    verdict
        The automatic verdict, as one of the answers that people can give.
    people
        The answer of each person.
    opposite
        Whether one of them is preserved and the other lost.
    """

    record: CellRecord
    verdict: str
    people: Mapping[str, str]
    opposite: bool


@dataclass(frozen=True)
class PeopleComparison:
    """The agreement of people with the automatic verdict, with each other and with themselves.

    Parameters
    ----------
    people
        The people who gave answers.
    outputs
        Number of outputs with an answer.
    with_verdict
        The automatic verdict with each person; if there are several, their mean comes last.
    between
        Every two people; if there are several pairs, their mean comes last.
    selves
        Each person's answers to the first and to the second showing of the same output.
    disagreements
        The opposite ones first.
    """

    people: Sequence[Person]
    outputs: int
    with_verdict: Sequence[RaterAgreement]
    between: Sequence[RaterAgreement]
    selves: Sequence[RaterAgreement]
    disagreements: Sequence[Disagreement]


RaterPair = tuple[str, str, Mapping[str, str], Mapping[str, str]]
"""The names of two raters, and the answers of each by cell."""


def compare_people(run: Run, files: Sequence[Path]) -> PeopleComparison | None:
    """Compare people with the automatic verdict, from the answer files of the labelling pages; None without files.

    The first showing of an output counts. The second showing counts for self-agreement only.
    """
    people = read_people(run, files)
    if not people:
        return None
    textures = {record.key: record.texture for record in run.cells}
    answers = {person.name: person.by_cell() for person in people}
    verdicts = {record.key: verdict_as_answer(record) for record in run.cells}
    names = list(answers)
    pairs = [(a, b, answers[a], answers[b]) for a, b in itertools.combinations(names, 2)]
    repeats = [(person.name, "shown again", person.by_cell(), person.by_cell(again=True)) for person in people]
    return PeopleComparison(
        people=people,
        outputs=len(set().union(*answers.values())),
        with_verdict=_agreements([(JUDGE, name, verdicts, answers[name]) for name in names], textures, JUDGE),
        between=_agreements(pairs, textures, "people"),
        selves=[_agreement([pair], textures) for pair in repeats],
        disagreements=_list_disagreements(run, verdicts, answers),
    )


def _agreements(pairs: Sequence[RaterPair], textures: Mapping[str, str], group: str) -> list[RaterAgreement]:
    """Return the agreement of each pair, and the mean of several pairs last."""
    each = [_agreement([pair], textures) for pair in pairs]
    return [*each, _agreement(pairs, textures, group)] if len(pairs) > 1 else each


def _agreement(pairs: Sequence[RaterPair], textures: Mapping[str, str], group: str = "") -> RaterAgreement:
    units = list(dict.fromkeys(textures.values()))
    tables = []
    for _, _, first, second in pairs:
        both = [cell for cell in second if cell in first]
        answers = ([first[cell] for cell in both], [second[cell] for cell in both])
        tables.append(count_answers(*answers, [textures[cell] for cell in both], ANSWERS, units))
    counts = np.stack(tables)
    total = counts.sum((0, 1))
    n = int(total.sum())
    one, another = (group, f"mean of {len(pairs)}") if group else pairs[0][:2]
    return RaterAgreement(
        first=one,
        second=another,
        kappa=mean_kappa(counts),
        decided=mean_kappa(counts[..., :2, :2]),
        equal=float(np.trace(total)) / n if n else None,
        n=n,
        table=[[int(count) for count in row] for row in total],
    )


def _list_disagreements(
    run: Run, verdicts: Mapping[str, str], answers: Mapping[str, Mapping[str, str]]
) -> list[Disagreement]:
    disagreements = []
    for record in run.cells:
        own = {name: by_cell[record.key] for name, by_cell in answers.items() if record.key in by_cell}
        verdict = verdicts[record.key]
        if any(answer != verdict for answer in own.values()):
            opposite = verdict in DECIDED and any(answer in DECIDED and answer != verdict for answer in own.values())
            disagreements.append(Disagreement(record, verdict, own, opposite))
    return sorted(disagreements, key=lambda one: not one.opposite)


def labels_table(run: Run, files: Sequence[Path]) -> pd.DataFrame:
    """Return one row an answer: the person, the output, the answer, its time, and the automatic verdict."""
    records = {record.key: record for record in run.cells}
    rows = []
    for person in read_people(run, files):
        for one in person.answers:
            record = records[one.item.cell]
            output = [record.texture, record.method, record.lattice_source, record.replicate, one.item.again]
            rows.append(
                [person.name, *output, one.answer, verdict_as_answer(record), one.seconds, one.order, record.key]
            )
    return pd.DataFrame(rows, columns=list(LABEL_COLUMNS))


def agreement_table(comparison: PeopleComparison) -> pd.DataFrame:
    """Return one row a pair of raters: number of items, share of equal answers, kappa with its interval."""
    kinds = {"judge and people": comparison.with_verdict, "people": comparison.between, "self": comparison.selves}
    rows = [
        [kind, one.first, one.second, one.n, one.equal]
        + [part for estimate in (one.kappa, one.decided) for part in (estimate.value, estimate.low, estimate.high)]
        for kind, agreements in kinds.items()
        for one in agreements
    ]
    names = [f"{name}{part}" for name in ("kappa", "kappa_decided") for part in ("", "_low", "_high")]
    return pd.DataFrame(rows, columns=["kind", "first", "second", "items", "share_equal", *names])
