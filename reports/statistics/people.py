"""Whether judge and people agree on what is preserved."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from nrbench.labelling.labels import ANSWERS, Person, read_people, verdict_as_answer
from nrbench.runs.records import CellRecord, Run

from .kappa import Tables, mean_kappa, tables
from .statistics import Estimate

JUDGE = "judge"
DECIDED = ANSWERS[:2]


@dataclass(frozen=True)
class Agreement:
    """How far two raters agree, or the mean over pairs of raters.

    Parameters
    ----------
    first, second
        Who; for a mean what it is of, and over how many pairs.
    kappa
        Cohen's kappa over :data:`~nrbench.labelling.labels.ANSWERS`; of several pairs the mean.
    decided
        The same over items on which both say preserved or lost.
    equal
        Share of equal answers; None without items.
    n
        Items that both have answered, summed over pairs.
    table
        How often the first said i and the second j, summed over pairs, in the order of ``ANSWERS``.
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
    """An output on which somebody and the judge say different things.

    Parameters
    ----------
    record
        The cell.
    judge
        What the judge says, in the words of people.
    people
        What each person says.
    plain
        Whether one says preserved and the other lost.
    """

    record: CellRecord
    judge: str
    people: Mapping[str, str]
    plain: bool


@dataclass(frozen=True)
class People:
    """All of it.

    Parameters
    ----------
    people
        Whose answers there are.
    outputs
        How many outputs have an answer.
    judged
        The judge with each person; the mean over them last where there are several.
    between
        Every two people; the mean over them last where there are several pairs.
    selves
        Each person's first and second showing of one output.
    disagreements
        The plain ones first.
    """

    people: Sequence[Person]
    outputs: int
    judged: Sequence[Agreement]
    between: Sequence[Agreement]
    selves: Sequence[Agreement]
    disagreements: Sequence[Disagreement]


def people(run: Run, files: Sequence[Path]) -> People | None:
    """Return how judge and people agree, from the files that the pages saved; None without files.

    The first showing of an output counts; the second is for self-agreement only.
    """
    persons = read_people(run, files)
    if not persons:
        return None
    records = {record.key: record for record in run.cells}
    textures = {key: record.texture for key, record in records.items()}
    firsts = {person.name: person.by_cell() for person in persons}
    judge = {key: verdict_as_answer(record) for key, record in records.items()}
    names = list(firsts)
    return People(
        people=persons,
        outputs=len(set().union(*firsts.values())),
        judged=_with_mean([(JUDGE, name, judge, firsts[name]) for name in names], textures, JUDGE),
        between=_with_mean(
            [(a, b, firsts[a], firsts[b]) for a, b in itertools.combinations(names, 2)], textures, "people"
        ),
        selves=[
            _agreement([(person.name, "shown again", person.by_cell(), person.by_cell(again=True))], textures)
            for person in persons
        ],
        disagreements=_disagreements(run, judge, firsts),
    )


Pair = tuple[str, str, Mapping[str, str], Mapping[str, str]]
"""Two raters' names, and what each says by cell."""


def _with_mean(pairs: Sequence[Pair], textures: Mapping[str, str], first: str) -> list[Agreement]:
    found = [_agreement([pair], textures) for pair in pairs]
    return [*found, _agreement(pairs, textures, first)] if len(pairs) > 1 else found


def _agreement(pairs: Sequence[Pair], textures: Mapping[str, str], first: str = "") -> Agreement:
    known = list(dict.fromkeys(textures.values()))
    found = np.stack([_tables(pair, textures, known) for pair in pairs])
    total = found.sum((0, 1))
    n = int(total.sum())
    one, another = (first, f"mean of {len(pairs)}") if first else pairs[0][:2]
    return Agreement(
        first=one,
        second=another,
        kappa=mean_kappa(found),
        decided=mean_kappa(found[..., :2, :2]),
        equal=float(np.trace(total)) / n if n else None,
        n=n,
        table=[[int(count) for count in row] for row in total],
    )


def _tables(pair: Pair, textures: Mapping[str, str], known: Sequence[str]) -> Tables:
    _, _, first, second = pair
    both = [cell for cell in second if cell in first]
    units = [textures[cell] for cell in both]
    return tables([first[cell] for cell in both], [second[cell] for cell in both], units, ANSWERS, known)


def _disagreements(run: Run, judge: Mapping[str, str], firsts: Mapping[str, Mapping[str, str]]) -> list[Disagreement]:
    found = []
    for record in run.cells:
        said = {name: answers[record.key] for name, answers in firsts.items() if record.key in answers}
        verdict = judge[record.key]
        if any(answer != verdict for answer in said.values()):
            plain = verdict in DECIDED and any(answer in DECIDED and answer != verdict for answer in said.values())
            found.append(Disagreement(record, verdict, said, plain))
    return sorted(found, key=lambda one: not one.plain)


def labels_table(run: Run, files: Sequence[Path]) -> pd.DataFrame:
    """Return one row an answer: who, of which output, what, when, and what the judge says."""
    records = {record.key: record for record in run.cells}
    names = [
        "person",
        "texture",
        "method",
        "lattice_source",
        "replicate",
        "again",
        "answer",
        "judge",
        "seconds",
        "order",
    ]
    rows = []
    for person in read_people(run, files):
        for one in person.answers:
            record = records[one.item.cell]
            head = [person.name, record.texture, record.method, record.lattice_source, record.replicate]
            tail = [one.item.again, one.answer, verdict_as_answer(record), one.seconds, one.order, record.key]
            rows.append([*head, *tail])
    return pd.DataFrame(rows, columns=[*names, "key"])


def agreement_table(found: People) -> pd.DataFrame:
    """Return one row a pair of raters: kappa with its interval, share of equal answers, how many items."""
    kinds = {"judge and people": found.judged, "people": found.between, "self": found.selves}
    rows = [
        [kind, one.first, one.second, one.n, one.equal, *_parts(one.kappa), *_parts(one.decided)]
        for kind, several in kinds.items()
        for one in several
    ]
    names = [f"{name}{part}" for name in ("kappa", "kappa_decided") for part in ("", "_low", "_high")]
    return pd.DataFrame(rows, columns=["kind", "first", "second", "items", "share_equal", *names])


def _parts(estimate: Estimate) -> tuple[float | None, float | None, float | None]:
    return estimate.value, estimate.low, estimate.high
