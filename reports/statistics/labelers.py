"""Compare the scores of a run with the answers of labelers, and labelers with each other, question by question."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import rankdata

from nrbench.labelling.labels import ANSWERS, QUESTIONS, Question, read_labels
from nrbench.runs.records import CellRecord, Run
from nrbench.streams import stream

from .estimates import NO_ESTIMATE, Estimate, expanded_tail, mean_kappa, means_over_textures, rank_agreement
from .verdicts import method_label

JUDGE = "judge"
"""The name of the automatic score among the raters."""
DECIDED = YES, NO = ANSWERS[:2]
SUBSETS = ("all", "ranked", "leading five")
"""The outputs whose orders are compared: all, those of methods that are ranked, and those of the best five of them."""


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
        answer.
    outputs
        For orders: which outputs are compared, one of :data:`SUBSETS`.
    kappa
        Cohen's kappa over :data:`~nrbench.labelling.labels.ANSWERS`; for several pairs the mean.
    decided
        The same over the items that both answered with yes or no.
    spearman
        Spearman's rank correlation of the score with the mean answer, over all outputs.
    tau
        Kendall's tau-b within each texture, mean over textures. The methods of a texture are ordered by their mean
        score, and by their mean answer, such as the share of yes among the answers yes and no.
    ordered
        Share of the pairs of methods with different mean answers that the score puts in the same order, mean over
        textures. Pairs with equal scores count half.
    equal
        Share of equal answers; None without items.
    table
        How often the first answered i and the second j, summed over pairs, in the order of ``ANSWERS``.
    """

    first: str
    second: str
    n: int
    outputs: str = ""
    kappa: Estimate = NO_ESTIMATE
    decided: Estimate = NO_ESTIMATE
    spearman: Estimate = NO_ESTIMATE
    tau: Estimate = NO_ESTIMATE
    ordered: Estimate = NO_ESTIMATE
    equal: float | None = None
    table: Sequence[Sequence[int]] = ()


@dataclass(frozen=True)
class Disagreement:
    """An output on which at least one labeler and the automatic answer differ.

    Parameters
    ----------
    record
        The cell.
    verdict
        The automatic answer.
    labelers
        The answer of each labeler.
    opposite
        Whether one of them is yes and another no.
    """

    record: CellRecord
    verdict: str
    labelers: Mapping[str, str]
    opposite: bool


@dataclass(frozen=True)
class QuestionComparison:
    """The agreement of labelers with the automatic score, with each other and with themselves on one question.

    Parameters
    ----------
    question
        The question.
    outputs
        Number of outputs with an answer.
    with_verdict
        The automatic answer with each labeler; if there are several, their mean comes last. Empty if no automatic
        answer exists.
    ranks
        The orders by score and by each labeler, for each of :data:`SUBSETS`; if there are several labelers, those by
        all of them come last. Empty if there is an automatic answer.
    between
        Every two labelers; if there are several pairs, their mean comes last.
    selves
        Each labeler's answers to the first and to the second showing of the same output.
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
class LabelerComparison:
    """The comparison of labelers with the scores of a run.

    Parameters
    ----------
    labelers
        What each labeler is, by name: ``person``, as the page writes, or for example ``vision-language model``.
    outputs
        Number of outputs with an answer.
    questions
        The comparison for each question that somebody answered, by the name of the question.
    """

    labelers: Mapping[str, str]
    outputs: int
    questions: Mapping[str, QuestionComparison]


Answers = Mapping[str, str]
"""The answers of a rater by cell."""
RaterPair = tuple[str, str, Answers, Answers]
"""The names of two raters, and the answers of each."""


def compare_labelers(run: Run, files: Sequence[Path]) -> LabelerComparison | None:
    """Compare labelers with the scores of a run, from the answer files of the labelling pages; None without files.

    The first showing of an output counts. The second showing counts for self-agreement only.
    """
    labels = read_labels(run, files)
    if labels.empty:
        return None
    asked = dict(iter(labels.groupby("question")))
    return LabelerComparison(
        labelers=dict(zip(labels["labeler"], labels["labeled_by"], strict=True)),
        outputs=labels["key"].nunique(),
        questions={name: _compare(run, asked[name], question) for name, question in QUESTIONS.items() if name in asked},
    )


def _by_labeler(labels: pd.DataFrame) -> dict[str, Answers]:
    """Return the answers of each labeler by cell."""
    parts = labels.groupby("labeler", sort=False)
    return {str(name): dict(zip(part["key"], part["answer"], strict=True)) for name, part in parts}


def _compare(run: Run, labels: pd.DataFrame, question: Question) -> QuestionComparison:
    """Compare the labelers who answered a question."""
    textures = {record.key: record.texture for record in run.cells}
    answers, again = _by_labeler(labels[~labels["again"]]), _by_labeler(labels[labels["again"]])
    verdicts = {one.key: answer for one in run.cells if (answer := question.automatic_answer(one)) is not None}
    pairs = [(a, b, answers[a], answers[b]) for a, b in itertools.combinations(answers, 2)]
    judged = [(JUDGE, name, verdicts, given) for name, given in answers.items()] if question.rule else []
    groups = {} if question.rule else {name: [given] for name, given in answers.items()}
    if len(groups) > 1:
        groups["all labelers"] = list(answers.values())
    return QuestionComparison(
        question=question,
        outputs=len(set().union(*answers.values())),
        with_verdict=_compare_each(judged, textures, JUDGE),
        ranks=[row for name, given in groups.items() for row in _rank_labelers(run, question, name, given)],
        between=_compare_each(pairs, textures, "labelers"),
        selves=[
            compare_raters([(name, "shown again", given, again.get(name, {}))], textures)
            for name, given in answers.items()
        ],
        disagreements=_list_disagreements(run, verdicts, answers),
    )


def _rank_labelers(run: Run, question: Question, name: str, labelers: Sequence[Answers]) -> list[RaterAgreement]:
    rows = []
    for record in run.cells:
        said = [given[record.key] for given in labelers if given.get(record.key) in DECIDED]
        share = said.count(YES) / len(said) if said else None
        label = method_label(record.method, record.lattice_source)
        rows.append([record.texture, label, record.reference, record.values.get(question.column), share])
    outputs = pd.DataFrame(rows, columns=["texture", "label", "reference", "score", "answer"])
    outputs = outputs.astype({"score": float, "answer": float})
    means = outputs[~outputs["reference"]].groupby("label")["score"].mean()
    return compare_orders(outputs, means.nlargest(5).index, name)


def compare_orders(outputs: pd.DataFrame, leading: Collection[str], name: str) -> list[RaterAgreement]:
    """Compare the order of outputs by a score with their order by answers, for each of :data:`SUBSETS`.

    Parameters
    ----------
    outputs
        One row an output: ``texture``, ``label`` of the method, ``reference``, ``score``, and the mean ``answer``. Rows
        without a score or an answer are left out.
    leading
        The labels of the leading five methods.
    name
        Who answered.
    """
    known = outputs.dropna(subset=["score", "answer"])
    parts = (known, known[~known["reference"]], known[known["label"].isin(leading)])
    return [_compare_order(*part, name) for part in zip(parts, SUBSETS, strict=True)]


def _compare_order(outputs: pd.DataFrame, subset: str, second: str) -> RaterAgreement:
    methods = outputs.groupby(["texture", "label"], sort=False)[["score", "answer"]].mean()
    orders = [[name, *rank_agreement(*part.to_numpy().T)] for name, part in methods.groupby("texture", sort=False)]
    means = means_over_textures(pd.DataFrame(orders, columns=["texture", "tau", "ordered"]), ["tau", "ordered"])
    textures = [part.to_numpy() for _, part in outputs.groupby("texture", sort=False)[["score", "answer"]]]
    spearman, tau, ordered = _estimate_spearman(textures), means["tau"], means["ordered"]
    return RaterAgreement(JUDGE, second, len(outputs), subset, spearman=spearman, tau=tau, ordered=ordered)


def _estimate_spearman(textures: Sequence[NDArray[np.float64]]) -> Estimate:
    """Estimate Spearman's correlation of two columns, with an interval by bootstrap over textures, which stay whole.

    There are 1999 resamples. Percentiles are expanded as those of :func:`~.estimates.mean_kappa`.
    """
    n = len(textures)

    def correlate(chosen: Iterable[int]) -> float:
        ranks = rankdata(np.concatenate([textures[i] for i in chosen]), axis=0)
        return float(np.asarray(np.corrcoef(ranks.T))[0, 1]) if np.ptp(ranks, axis=0).all() else np.nan

    value = correlate(range(n)) if n else np.nan
    if np.isnan(value) or n < 2:
        return Estimate(None if np.isnan(value) else value, n=n, of=n)
    draws = [correlate(chosen) for chosen in stream("bootstrap").integers(0, n, (1999, n))]
    tail = expanded_tail(n)
    low, high = np.nanquantile(draws, [tail, 1 - tail]).tolist()
    return Estimate(value, low, high, n, n)


def _compare_each(pairs: Sequence[RaterPair], textures: Mapping[str, str], group: str) -> list[RaterAgreement]:
    """Return the agreement of each pair, and the mean of several pairs last."""
    each = [compare_raters([pair], textures) for pair in pairs]
    return [*each, compare_raters(pairs, textures, group)] if len(pairs) > 1 else each


def compare_raters(pairs: Sequence[RaterPair], textures: Mapping[str, str], group: str = "") -> RaterAgreement:
    """Return the agreement of a pair of raters, or the mean of a group of pairs, with intervals over textures."""
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
        given = {name: by_cell[record.key] for name, by_cell in answers.items() if record.key in by_cell}
        verdict = verdicts.get(record.key)
        others = {answer for answer in given.values() if answer != verdict}
        if verdict is not None and others:
            opposite = verdict in DECIDED and not others.isdisjoint(DECIDED)
            disagreements.append(Disagreement(record, verdict, given, opposite))
    return sorted(disagreements, key=lambda found: not found.opposite)
