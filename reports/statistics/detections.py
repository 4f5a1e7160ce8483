"""Summarize the answers of a run's lattice detectors: accuracy, errors, times, and calibration of the confidence."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from nrbench.lattice.geometry import Lattice
from nrbench.lattice.relation import lattice_error
from nrbench.runs.records import CellRecord, Run
from nrbench.runs.store import FAILED

from .estimates import estimate_proportion

ANSWER_COLUMNS = (
    *("detector", "texture", "family", "departure", "level", "regular_share", "replicate", "answer", "right", "found"),
    *("confidence", "vector_error", "vertex_recall", "vertex_precision", "seconds", "reason"),
)
"""The columns of :func:`tabulate_answers`."""
KINDS = ("exact", "supercell", "subcell", "wrong", "none", "failed")
"""The kinds of answer on textures that have a lattice."""
STOCHASTIC = "stochastic"
VERTEX_COLUMNS = ("vertex_recall", "vertex_precision")
"""The columns of vertices; their means over draws have the same names."""
GROUP_KEYS = ("detector", "family", "departure", "level")
BINS = 10
"""Number of bins of :func:`calibrate`."""


@dataclass(frozen=True)
class Calibration:
    """Confidence compared with truth.

    Parameters
    ----------
    bins
        One row a bin that is not empty, by ascending confidence: its ends ``low`` and ``high``, the mean ``confidence``
        of its answers, the share of them that are ``right`` with Wilson's interval, and their ``share`` of all answers.
    error
        Expected calibration error: the mean over answers of the distance between the share of right answers in the
        answer's bin and the mean confidence there (M. P. Naeini, G. F. Cooper, M. Hauskrecht, "Obtaining well
        calibrated probabilities using Bayesian binning", AAAI 2015); None if there are no answers.
    n
        Number of answers.
    """

    bins: pd.DataFrame
    error: float | None
    n: int


@dataclass(frozen=True)
class DetectorComparison:
    """The summary of each detector, and its answers by groups of textures.

    Parameters
    ----------
    summaries
        One row a ``detector``: the share of ``exact`` answers on draws of textures that have a lattice, and by family
        in ``families``; the share of ``false`` lattices found on draws of stochastic textures, which have none; the
        median ``vector_error`` of exact answers, px; the means :data:`VERTEX_COLUMNS` over draws; the median and the
        largest wall time of a detection, ``seconds`` and ``slowest``; the ``calibration``; and in ``kinds`` the number
        of answers of each of :data:`KINDS`, on textures that have a lattice.
    groups, levels
        The rows of :func:`group_answers` of each detector by (family, departure), and by (family, departure, level).
    """

    summaries: pd.DataFrame
    groups: Mapping[tuple[Any, ...], Mapping[str, Any]]
    levels: Mapping[tuple[Any, ...], Mapping[str, Any]]


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
        a stochastic texture. :data:`VERTEX_COLUMNS` come from the metric ``lattice_recovery``.
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
        **{name: record.values.get(f"lattice_recovery.{name}") for name in VERTEX_COLUMNS},
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
    by_detector = answers.groupby("detector", sort=False)
    return DetectorComparison(
        summaries=pd.DataFrame({"detector": name, **_summarize_detector(part)} for name, part in by_detector),
        groups=_by_detector(group_answers(answers, GROUP_KEYS[:3])),
        levels=_by_detector(group_answers(answers[answers["level"].notna()], GROUP_KEYS)),
    )


def _summarize_detector(answers: pd.DataFrame) -> dict[str, Any]:
    stochastic = answers["departure"] == STOCHASTIC
    regular, confident = answers[~stochastic], answers[answers["found"] & answers["confidence"].notna()]
    kinds = regular["answer"].str.partition(" ")[0]
    families = regular.groupby("family", sort=False)["right"]
    return {
        "exact": estimate_proportion(regular["right"]),
        "false": estimate_proportion(answers[stochastic]["found"]),
        "families": {str(family): estimate_proportion(right) for family, right in families},
        "vector_error": _of_known(regular[regular["right"]]["vector_error"], "median"),
        **{name: _of_known(regular[name], "mean") for name in VERTEX_COLUMNS},
        "seconds": _of_known(answers["seconds"], "median"),
        "slowest": _of_known(answers["seconds"], "max"),
        "calibration": calibrate(confident["confidence"].to_numpy(float), confident["right"].to_numpy(bool)),
        "kinds": {kind: int((kinds == kind).sum()) for kind in KINDS},
    }


def group_answers(answers: pd.DataFrame, keys: Sequence[str]) -> pd.DataFrame:
    """Return one row a group of answers with equal values of some columns, such as those of :data:`GROUP_KEYS`.

    Returns
    -------
    pandas.DataFrame
        The keys; the number ``n`` of answers, and of lattices ``found``; the share ``right`` with Wilson's interval;
        the median ``vector_error`` of the right answers, px; the means :data:`VERTEX_COLUMNS`; and the median
        ``seconds`` of a detection, None if there are none.
    """
    table = pd.DataFrame(
        {
            **dict(zip(keys, cast(tuple[Any, ...], group), strict=True)),
            **{"n": len(part), "found": int(part["found"].sum()), "right": estimate_proportion(part["right"])},
            "vector_error": _of_known(part[part["right"]]["vector_error"], "median"),
            **{name: _of_known(part[name], "mean") for name in VERTEX_COLUMNS},
            "seconds": _of_known(part["seconds"], "median"),
        }
        for group, part in answers.groupby(list(keys), sort=False)
    )
    return table.astype(object).where(table.notna(), None)


def _by_detector(groups: pd.DataFrame) -> dict[tuple[Any, ...], dict[str, Any]]:
    """Return the rows of groups by their keys but the detector, then by detector."""
    found: dict[tuple[Any, ...], dict[str, Any]] = {}
    for row in groups.to_dict("records"):
        textures = tuple(row[key] for key in GROUP_KEYS[1:] if key in row)
        found.setdefault(textures, {})[row["detector"]] = row
    return found


def _of_known(values: pd.Series[Any], statistic: str) -> float | None:
    """Return the mean, the median or the maximum of the known values; None if there are none."""
    value = float(values.astype(float).agg(statistic))
    return None if math.isnan(value) else value


def calibrate(confidence: NDArray[np.float64], right: NDArray[np.bool_]) -> Calibration:
    """Compare confidence with truth in :data:`BINS` bins of equal width.

    Parameters
    ----------
    confidence
        ``(n,)`` in [0, 1].
    right
        ``(n,)``: whether each answer was right.
    """
    index = np.clip((confidence * BINS).astype(int), 0, BINS - 1)
    bins: list[dict[str, Any]] = [
        {
            **{"low": i / BINS, "high": (i + 1) / BINS, "confidence": float(confidence[index == i].mean())},
            **{"right": estimate_proportion(right[index == i]), "share": float((index == i).mean())},
        }
        for i in np.unique(index)
    ]
    gaps = [one["share"] * abs((one["right"].value or 0.0) - one["confidence"]) for one in bins]
    return Calibration(pd.DataFrame(bins), math.fsum(gaps) if gaps else None, len(confidence))
