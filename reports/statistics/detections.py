"""Summarize the answers of a run's lattice detectors: accuracy, errors, times, and calibration of the confidence."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from nrbench.lattice.geometry import Lattice
from nrbench.lattice.relation import lattice_error
from nrbench.runs.records import CellRecord, Run
from nrbench.runs.store import FAILED

from .estimates import Estimate, estimate_proportion

ANSWER_COLUMNS = (
    *("detector", "texture", "family", "departure", "level", "regular_share", "replicate", "answer", "right", "found"),
    *("confidence", "vector_error", "seconds", "reason"),
)
"""The columns of :func:`tabulate_answers`."""
KINDS = ("exact", "supercell", "subcell", "wrong", "none", "failed")
"""The kinds of answer on textures that have a lattice."""
STOCHASTIC = "stochastic"
GROUP_KEYS = ("detector", "family", "departure", "level")
BINS = 10
"""Number of bins of :func:`calibrate`."""


@dataclass(frozen=True)
class CalibrationBin:
    """The answers whose confidence lies in one range.

    Parameters
    ----------
    low, high
        The range.
    confidence
        Mean confidence of the answers.
    right
        Share of the answers that are right, with Wilson's interval.
    share
        Their share of all answers.
    """

    low: float
    high: float
    confidence: float
    right: Estimate
    share: float


@dataclass(frozen=True)
class Calibration:
    """Confidence compared with truth.

    Parameters
    ----------
    bins
        The bins that are not empty, by ascending confidence.
    error
        Expected calibration error: the mean over answers of the distance between the share of right answers in the
        answer's bin and the mean confidence there (M. P. Naeini, G. F. Cooper, M. Hauskrecht, "Obtaining well
        calibrated probabilities using Bayesian binning", AAAI 2015); None if there are no answers.
    n
        Number of answers.
    """

    bins: Sequence[CalibrationBin]
    error: float | None
    n: int


@dataclass(frozen=True)
class DetectorSummary:
    """The accuracy and the speed of one detector.

    Parameters
    ----------
    detector
        The detector, as the lattice axis names it.
    exact
        Share of exact answers on draws of textures that have a lattice.
    false
        Share of lattices found on draws of stochastic textures, which have none.
    families
        ``exact`` by family.
    vector_error
        Median over exact answers of the larger error of the two vectors, px; None if there are no exact answers.
    seconds, slowest
        Median and largest wall time of a detection, s; None if no detection ended.
    calibration
        How often a lattice is right, by its confidence.
    kinds
        Number of answers of each of :data:`KINDS`, on textures that have a lattice.
    """

    detector: str
    exact: Estimate
    false: Estimate
    families: Mapping[str, Estimate]
    vector_error: float | None
    seconds: float | None
    slowest: float | None
    calibration: Calibration
    kinds: Mapping[str, int]


@dataclass(frozen=True)
class AnswerGroup:
    """The answers of one detector on a group of textures.

    Parameters
    ----------
    n, found
        Number of answers, and of lattices found.
    right
        Share of right answers.
    vector_error
        Median vector error of the right answers, px; None if there are none.
    seconds
        Median wall time of a detection, s; None if no detection ended.
    """

    n: int
    found: int
    right: Estimate
    vector_error: float | None
    seconds: float | None


@dataclass(frozen=True)
class DetectorComparison:
    """The summary of each detector, and its answers by groups of textures.

    Parameters
    ----------
    summaries
        One for each detector.
    groups, levels
        The answers of each detector by (family, departure), and by (family, departure, level).
    """

    summaries: Sequence[DetectorSummary]
    groups: Mapping[tuple[Any, ...], Mapping[str, AnswerGroup]]
    levels: Mapping[tuple[Any, ...], Mapping[str, AnswerGroup]]


def tabulate_answers(run: Run) -> pd.DataFrame:
    """Return one row an answer: one detector of the lattice axis on one draw of a texture.

    A draw that several methods used counts once. Draws without a known truth, and draws that no detector has processed,
    are left out.

    Returns
    -------
    pandas.DataFrame
        The columns :data:`ANSWER_COLUMNS`. On a texture with a lattice ``answer`` is ``exact``, ``supercell k``,
        ``subcell 1/k``, ``wrong``, or ``none`` if no lattice was found. On a stochastic texture it is ``none`` or
        ``false lattice``. It is ``failed`` if the detector failed. ``right`` is true for ``exact``, and for ``none`` on
        a stochastic texture.
    """
    textures = {row["name"]: row for row in run.info.get("suite", {}).get("content", {}).get("texture", [])}
    draws = {(r.lattice_source, r.texture, r.replicate): r for r in reversed(run.cells) if r.cell.detector}
    rows = [_answer_row(record, textures.get(record.texture, {})) for record in reversed(draws.values())]
    return pd.DataFrame([row for row in rows if row], columns=list(ANSWER_COLUMNS))


def _answer_row(record: CellRecord, texture: Mapping[str, Any]) -> dict[str, Any] | None:
    detected, stochastic = record.cell.detected, record.kind == STOCHASTIC
    failed = detected is None and record.status in FAILED and record.phase == "detect"
    if not (detected or failed) or (record.lattice_truth is None and not stochastic):
        return None
    answer, error = ("failed", None) if detected is None else _compare_with_truth(record, detected.lattice)
    return {
        "detector": record.lattice_source,
        "texture": record.texture,
        "family": record.family,
        "departure": STOCHASTIC if stochastic else texture.get("departure", ""),
        "level": texture.get("level"),
        "regular_share": record.regular_share,
        "replicate": record.replicate,
        "answer": answer,
        "right": answer == ("none" if stochastic else "exact"),
        "found": detected is not None and detected.lattice is not None,
        "confidence": detected.confidence if detected else None,
        "vector_error": error,
        "seconds": detected.seconds if detected else None,
        "reason": detected.reason if detected else record.message,
    }


def _compare_with_truth(record: CellRecord, lattice: Lattice | None) -> tuple[str, float | None]:
    """Return the kind of an answer, and its vector error if there is a truth to compare with."""
    if lattice is None:
        return "none", None
    if record.lattice_truth is None or record.kind == STOCHASTIC:
        return "false lattice", None
    error = lattice_error(lattice, Lattice.from_dict(record.lattice_truth), record.cell.recipe.shape)
    return error.label, error.vector


def compare_detectors(run: Run) -> DetectorComparison | None:
    """Compare the detectors of a run's lattice axis; None if there are no answers."""
    answers = tabulate_answers(run)
    if answers.empty:
        return None
    names = list(dict.fromkeys(answers["detector"]))
    return DetectorComparison(
        summaries=[_summarize_detector(name, answers[answers["detector"] == name]) for name in names],
        groups=_by_detector(group_answers(answers, GROUP_KEYS[:3])),
        levels=_by_detector(group_answers(answers[answers["level"].notna()], GROUP_KEYS)),
    )


def _summarize_detector(name: str, answers: pd.DataFrame) -> DetectorSummary:
    stochastic = answers["departure"] == STOCHASTIC
    regular, confident = answers[~stochastic], answers[answers["found"] & answers["confidence"].notna()]
    kinds = regular["answer"].str.partition(" ")[0]
    families = regular.groupby("family", sort=False)["right"]
    return DetectorSummary(
        detector=name,
        exact=estimate_proportion(regular["right"]),
        false=estimate_proportion(answers[stochastic]["found"]),
        families={str(family): estimate_proportion(right) for family, right in families},
        vector_error=median_of_known(regular[regular["right"]]["vector_error"]),
        seconds=median_of_known(answers["seconds"]),
        slowest=None if answers["seconds"].isna().all() else float(answers["seconds"].max()),
        calibration=calibrate(confident["confidence"].to_numpy(float), confident["right"].to_numpy(bool)),
        kinds={kind: int((kinds == kind).sum()) for kind in KINDS},
    )


def group_answers(answers: pd.DataFrame, keys: Sequence[str]) -> dict[tuple[Any, ...], AnswerGroup]:
    """Return the answers by the values of some columns of :func:`tabulate_answers`, such as :data:`GROUP_KEYS`."""
    return {
        cast(tuple[Any, ...], group): AnswerGroup(
            n=len(part),
            found=int(part["found"].sum()),
            right=estimate_proportion(part["right"]),
            vector_error=median_of_known(part[part["right"]]["vector_error"]),
            seconds=median_of_known(part["seconds"]),
        )
        for group, part in answers.groupby(list(keys), sort=False)
    }


def _by_detector(groups: Mapping[tuple[Any, ...], AnswerGroup]) -> dict[tuple[Any, ...], dict[str, AnswerGroup]]:
    """Return groups whose first key is the detector by the other keys, then by detector."""
    found: dict[tuple[Any, ...], dict[str, AnswerGroup]] = {}
    for (detector, *textures), group in groups.items():
        found.setdefault(tuple(textures), {})[detector] = group
    return found


def median_of_known(values: Iterable[float | None]) -> float | None:
    """Return the median of the known values; None if there are none."""
    known = pd.Series(list(values), dtype=float).dropna()
    return None if known.empty else float(known.median())


def calibrate(confidence: NDArray[np.float64], right: NDArray[np.bool_]) -> Calibration:
    """Compare confidence with truth in :data:`BINS` bins of equal width.

    Parameters
    ----------
    confidence
        ``(n,)`` in [0, 1].
    right
        ``(n,)``: whether each answer was right.
    """
    n = len(confidence)
    index = np.clip((confidence * BINS).astype(int), 0, BINS - 1)
    bins = []
    for i in np.unique(index):
        inside = index == i
        share, rate = float(inside.mean()), estimate_proportion(right[inside])
        bins.append(CalibrationBin(i / BINS, (i + 1) / BINS, float(confidence[inside].mean()), rate, share))
    gaps = [one.share * abs((one.right.value or 0.0) - one.confidence) for one in bins]
    return Calibration(bins, math.fsum(gaps) if bins else None, n)
