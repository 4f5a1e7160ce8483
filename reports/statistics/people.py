"""Compare the scores of a run with the answers of people, and people with each other, question by question."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from nrbench.imaging.files import read_image
from nrbench.labelling.labels import Person, read_people
from nrbench.labelling.questions import ANSWERS, QUESTIONS, Question
from nrbench.runs.records import CellRecord, Run
from nrbench.streams import pixels_hash

from .estimates import NO_ESTIMATE, Estimate, as_numbers, mean_kappa, means_over_textures, rank_agreement
from .verdicts import method_label

JUDGE = "judge"
"""The name of the automatic score among the raters."""
DECIDED = YES, NO = ANSWERS[:2]


@dataclass(frozen=True)
class RaterAgreement:
    """The agreement of two raters, or its mean over pairs of raters.

    A score with a verdict has kappas, a score without one is compared by the order of the methods.

    Parameters
    ----------
    first, second
        The raters. For a mean: the common rater or group, and the number of pairs.
    n
        Number of items that both answered, summed over pairs; for orders the number of outputs with a score and an
        answer yes or no.
    kappa
        Cohen's kappa over :data:`~nrbench.labelling.questions.ANSWERS`; for several pairs the mean.
    decided
        The same over the items that both answered with yes or no.
    tau
        Kendall's tau-b within each texture, mean over textures. The methods of a texture are ordered by their mean
        score, and by their share of yes among the answers yes and no.
    ordered
        Share of the pairs of methods with different shares of yes that the score puts in the same order, mean over
        textures. Pairs with equal scores count half.
    equal
        Share of equal answers; None without items.
    table
        How often the first answered i and the second j, summed over pairs, in the order of ``ANSWERS``.
    """

    first: str
    second: str
    n: int
    kappa: Estimate = NO_ESTIMATE
    decided: Estimate = NO_ESTIMATE
    tau: Estimate = NO_ESTIMATE
    ordered: Estimate = NO_ESTIMATE
    equal: float | None = None
    table: Sequence[Sequence[int]] = ()


@dataclass(frozen=True)
class Disagreement:
    """An output on which at least one person and the automatic answer differ.

    Parameters
    ----------
    record
        The cell.
    verdict
        The automatic answer.
    people
        The answer of each person.
    opposite
        Whether one of them is yes and another no.
    """

    record: CellRecord
    verdict: str
    people: Mapping[str, str]
    opposite: bool


@dataclass(frozen=True)
class QuestionComparison:
    """The agreement of people with the automatic score, with each other and with themselves on one question.

    Parameters
    ----------
    question
        The question.
    outputs
        Number of outputs with an answer.
    with_verdict
        The automatic answer with each person; if there are several, their mean comes last. Empty if no automatic answer
        exists.
    ranks
        The order of methods by score and by each person; if there are several, that by all people comes last. Empty if
        there is an automatic answer.
    between
        Every two people; if there are several pairs, their mean comes last.
    selves
        Each person's answers to the first and to the second showing of the same output.
    disagreements
        The opposite ones first.
    """

    question: Question
    outputs: int
    with_verdict: Sequence[RaterAgreement]
    ranks: Sequence[RaterAgreement]
    between: Sequence[RaterAgreement]
    selves: Sequence[RaterAgreement]
    disagreements: Sequence[Disagreement]


@dataclass(frozen=True)
class PeopleComparison:
    """The comparison of people with the scores of a run.

    Parameters
    ----------
    people
        The people who gave answers.
    outputs
        Number of outputs with an answer.
    questions
        The comparison for each question that somebody answered, by the name of the question.
    """

    people: Sequence[Person]
    outputs: int
    questions: Mapping[str, QuestionComparison]


Answers = Mapping[str, str]
"""The answers of a rater by cell."""
RaterPair = tuple[str, str, Answers, Answers]
"""The names of two raters, and the answers of each."""


def compare_people(run: Run, files: Sequence[Path]) -> PeopleComparison | None:
    """Compare people with the scores of a run, from the answer files of the labelling pages; None without files.

    The first showing of an output counts. The second showing counts for self-agreement only.
    """
    people = read_people(run, files)
    if not people:
        return None
    answered = {answer.question for person in people for answer in person.answers}
    return PeopleComparison(
        people=people,
        outputs=len({answer.item.cell for person in people for answer in person.answers}),
        questions={name: _compare(run, people, QUESTIONS[name]) for name in QUESTIONS if name in answered},
    )


def _compare(run: Run, people: Sequence[Person], question: Question) -> QuestionComparison:
    """Compare the people who answered a question."""
    textures = {record.key: record.texture for record in run.cells}
    shown = {person.name: person.by_cell(question.name) for person in people}
    answers = {name: by_cell for name, by_cell in shown.items() if by_cell}
    again = {person.name: person.by_cell(question.name, again=True) for person in people if person.name in answers}
    known = ((record.key, question.automatic_answer(record)) for record in run.cells)
    verdicts = {key: answer for key, answer in known if answer is not None}
    pairs = [(a, b, answers[a], answers[b]) for a, b in itertools.combinations(answers, 2)]
    judged = [(JUDGE, name, verdicts, own) for name, own in answers.items()] if question.rule else []
    groups = {name: [own] for name, own in answers.items()}
    if len(groups) > 1:
        groups["all people"] = list(answers.values())
    return QuestionComparison(
        question=question,
        outputs=len(set().union(*answers.values())),
        with_verdict=_agreements(judged, textures, JUDGE),
        ranks=[] if question.rule else [_rank_agreement(run, question, *group) for group in groups.items()],
        between=_agreements(pairs, textures, "people"),
        selves=[_agreement([(name, "shown again", own, again[name])], textures) for name, own in answers.items()],
        disagreements=_list_disagreements(run, verdicts, answers),
    )


def _rank_agreement(run: Run, question: Question, name: str, people: Sequence[Answers]) -> RaterAgreement:
    rows = []
    for record in run.cells:
        said = [own[record.key] for own in people if own.get(record.key) in DECIDED]
        score = record.values.get(question.column)
        if said and score is not None:
            label = method_label(record.method, record.lattice_source)
            rows.append([record.texture, label, float(score), said.count(YES) / len(said)])
    cells = pd.DataFrame(rows, columns=["texture", "label", "score", "yes"])
    methods = cells.groupby(["texture", "label"], sort=False, as_index=False).mean()
    orders = [
        [texture, *rank_agreement(part["score"].to_numpy(), part["yes"].to_numpy())]
        for texture, part in methods.groupby("texture", sort=False)
    ]
    table = pd.DataFrame(orders, columns=["texture", "tau", "ordered"])
    means = means_over_textures(table, ["tau", "ordered"])
    return RaterAgreement(JUDGE, name, len(cells), tau=means["tau"], ordered=means["ordered"])


def _agreements(pairs: Sequence[RaterPair], textures: Mapping[str, str], group: str) -> list[RaterAgreement]:
    """Return the agreement of each pair, and the mean of several pairs last."""
    each = [_agreement([pair], textures) for pair in pairs]
    return [*each, _agreement(pairs, textures, group)] if len(pairs) > 1 else each


def _agreement(pairs: Sequence[RaterPair], textures: Mapping[str, str], group: str = "") -> RaterAgreement:
    units = {texture: i for i, texture in enumerate(dict.fromkeys(textures.values()))}
    counts = np.zeros((len(pairs), len(units), len(ANSWERS), len(ANSWERS)))
    for table, (_, _, first, second) in zip(counts, pairs, strict=True):
        for cell in second.keys() & first.keys():
            table[units[textures[cell]], ANSWERS.index(first[cell]), ANSWERS.index(second[cell])] += 1
    total = counts.sum((0, 1)).astype(int)
    n = int(total.sum())
    names = (group, f"mean of {len(pairs)}") if group else pairs[0][:2]
    return RaterAgreement(
        *names,
        n,
        kappa=mean_kappa(counts),
        decided=mean_kappa(counts[..., :2, :2]),
        equal=float(np.trace(total)) / n if n else None,
        table=total.tolist(),
    )


def _list_disagreements(run: Run, verdicts: Answers, answers: Mapping[str, Answers]) -> list[Disagreement]:
    disagreements = []
    for record in run.cells:
        own = {name: by_cell[record.key] for name, by_cell in answers.items() if record.key in by_cell}
        verdict = verdicts.get(record.key)
        others = {answer for answer in own.values() if answer != verdict}
        if verdict is not None and others:
            opposite = verdict in DECIDED and not others.isdisjoint(DECIDED)
            disagreements.append(Disagreement(record, verdict, own, opposite))
    return sorted(disagreements, key=lambda found: not found.opposite)


def labels_table(run: Run, files: Sequence[Path]) -> pd.DataFrame:
    """Return one row an answer: the person, the output, the question, the answer, its time, and the score.

    ``judge`` is the automatic answer; it is empty for a question that has none. ``score`` is the value of the column of
    the question. ``pixels`` is the hash of the output's pixels, which identifies an output that is made again.
    """
    records = {record.key: record for record in run.cells}
    people = read_people(run, files)
    pixels = {key: _hash_output(records[key]) for key in {one.item.cell for person in people for one in person.answers}}
    rows = []
    for person in people:
        for answer in person.answers:
            record, question = records[answer.item.cell], QUESTIONS[answer.question]
            rows.append({
                **{"person": person.name, "suite": record.suite, "texture": record.texture, "method": record.method},
                **{"lattice_source": record.lattice_source, "replicate": record.replicate},
                **{"again": answer.item.again, "question": question.name, "answer": answer.answer},
                "judge": question.automatic_answer(record),
                "score": as_numbers([record.values.get(question.column)])[0],
                **{"seconds": answer.seconds, "order": answer.order, "key": record.key, "pixels": pixels[record.key]},
            })  # fmt: skip
    return pd.DataFrame(rows)


def _hash_output(record: CellRecord) -> str | None:
    """Return the hash of an output's pixels; None if the file has been removed."""
    path = record.folder / "output.png"
    return pixels_hash(read_image(path, smallest=1)) if path.is_file() else None


def agreement_table(comparison: PeopleComparison) -> pd.DataFrame:
    """Return agreement row a question and pair of raters: number of items, and the agreement with its interval.

    Pairs with answers have the share of equal answers and kappa; a question without an automatic answer has the
    agreement of the orders of methods in their place.
    """
    return pd.DataFrame(
        {"question": name, "kind": kind, "first": agreement.first, "second": agreement.second, "items": agreement.n}
        | {"share_equal": agreement.equal}
        | agreement.kappa.columns("kappa", "kappa_", ("low", "high"))
        | agreement.decided.columns("kappa_decided", "kappa_decided_", ("low", "high"))
        | agreement.tau.columns("tau", "tau_", ("low", "high"))
        | agreement.ordered.columns("ordered", "ordered_", ("low", "high"))
        for name, asked in comparison.questions.items()
        for kind, agreements in (
            ("judge and people", [*asked.ranks, *asked.with_verdict]),
            ("people", asked.between),
            ("self", asked.selves),
        )
        for agreement in agreements
    )
