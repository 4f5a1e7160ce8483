"""What the detectors of a run's lattice axis answered: one row an answer, and how far to trust each detector."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import pandas as pd

from nrbench.lattice.comparison import lattice_error
from nrbench.runs.records import CellRecord, Run
from nrbench.runs.store import FAILED

from ..page.overlay import parsed
from ..plots.calibration import Calibration, calibration
from .statistics import Estimate, wilson

ANSWERS = (
    *("detector", "texture", "family", "departure", "level", "regular_share", "replicate", "answer", "right", "found"),
    *("confidence", "vector_error", "seconds", "reason"),
)
"""The columns of :func:`answers`."""
KINDS = ("exact", "supercell", "subcell", "wrong", "none", "failed")
"""The kinds of answer on textures that have a lattice."""
STOCHASTIC = "stochastic"


@dataclass(frozen=True)
class Trust:
    """How far to trust one detector.

    Parameters
    ----------
    detector
        As the lattice axis names it.
    exact
        Share of exact answers on draws of textures that have a lattice.
    false
        Share of lattices found on draws of stochastic textures, which have none.
    families
        ``exact`` by family.
    vector_error
        Median larger error of the two vectors, px, of the exact answers; None where there are none.
    seconds, slowest
        Median and largest wall seconds of a detection; None where none ended.
    calibration
        How often a lattice is right, by the confidence it was given with.
    kinds
        How many answers were of each of :data:`KINDS`, on textures that have a lattice.
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
class Group:
    """The answers on textures of one family, departure and level, as each detector gave them.

    Parameters
    ----------
    family, departure, level
        Level None: all levels.
    places
        By detector: the share of right answers.
    errors
        By detector: the median vector error of the exact answers, px; None where there are none.
    """

    family: str
    departure: str
    level: float | None
    places: Mapping[str, Estimate]
    errors: Mapping[str, float | None]


@dataclass(frozen=True)
class Detectors:
    """All of it: one :class:`Trust` a detector, and the answers by family and departure, without and with levels."""

    trusts: Sequence[Trust]
    groups: Sequence[Group]
    levels: Sequence[Group]


def answers(run: Run) -> pd.DataFrame:
    """Return one row an answer of a detector of the lattice axis, on one draw of a texture; columns :data:`ANSWERS`.

    ``answer`` is exact, supercell k, subcell 1/k or wrong where a lattice was found, none where not, ``false lattice``
    where one was found on a stochastic texture, and failed where the detector did. ``right`` is whether that is what it
    should have answered. Draws of which the truth is not known, or that no detector has seen, are left out; a draw
    that several methods used counts once.
    """
    rows = {row["name"]: row for row in run.info.get("suite", {}).get("content", {}).get("texture", [])}
    asked = {(r.lattice_source, r.texture, r.replicate): r for r in reversed(run.cells) if r.cell.detector}
    found = [_answer(record, rows.get(record.texture, {})) for record in reversed(asked.values())]
    return pd.DataFrame([row for row in found if row], columns=list(ANSWERS))


def _answer(record: CellRecord, row: Mapping[str, Any]) -> dict[str, Any] | None:
    detected, stochastic = record.cell.detected, record.kind == STOCHASTIC
    failed = detected is None and record.status in FAILED and record.phase == "detect"
    if not (detected or failed) or (record.lattice_truth is None and not stochastic):
        return None
    answer, error = ("failed", None) if detected is None else _compared(record, stochastic)
    return {
        "detector": record.lattice_source,
        "texture": record.texture,
        "family": record.family,
        "departure": STOCHASTIC if stochastic else row.get("departure", ""),
        "level": row.get("level"),
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


def _compared(record: CellRecord, stochastic: bool) -> tuple[str, float | None]:
    """Return the kind of a detector's answer, and its vector error where there is a truth to compare with."""
    detected, truth = record.cell.detected, parsed(record.lattice_truth)
    if detected is None or detected.lattice is None:
        return "none", None
    if truth is None or stochastic:
        return "false lattice", None
    error = lattice_error(detected.lattice, truth, record.cell.recipe.shape)
    return error.label, error.vector


def detectors(run: Run) -> Detectors | None:
    """Return how far to trust each detector of a run's lattice axis; None where none has answered."""
    table = answers(run)
    if table.empty:
        return None
    names = list(dict.fromkeys(table["detector"]))
    return Detectors(
        trusts=[_trust(name, table[table["detector"] == name]) for name in names],
        groups=_groups(table, ["family", "departure"]),
        levels=_groups(table[table["level"].notna()], ["family", "departure", "level"]),
    )


def rate(successes: pd.Series[bool]) -> Estimate:
    """Return a share with Wilson's interval; its unit is the draw: each is a fresh one of its texture's model."""
    n = len(successes)
    if n == 0:
        return Estimate(None)
    low, high = wilson(float(successes.sum()), n) or (None, None)
    return Estimate(float(successes.mean()), low, high, n, n)


def _trust(name: str, table: pd.DataFrame) -> Trust:
    stochastic = table["departure"] == STOCHASTIC
    regular, given = table[~stochastic], table[table["found"] & table["confidence"].notna()]
    kinds = regular["answer"].str.partition(" ")[0]
    families = regular.groupby("family", sort=False)["right"]
    return Trust(
        detector=name,
        exact=rate(regular["right"]),
        false=rate(table[stochastic]["found"]),
        families={str(family): rate(right) for family, right in families},
        vector_error=median(regular[regular["right"]]["vector_error"]),
        seconds=median(table["seconds"]),
        slowest=None if table["seconds"].isna().all() else float(table["seconds"].max()),
        calibration=calibration(given["confidence"].to_numpy(float), given["right"].to_numpy(bool)),
        kinds={kind: int((kinds == kind).sum()) for kind in KINDS},
    )


def median(values: Iterable[float | None]) -> float | None:
    """Return the median of what is known; None where nothing is."""
    known = pd.Series([value for value in values if value is not None and not math.isnan(value)], dtype=float)
    return None if known.empty else float(known.median())


def _groups(table: pd.DataFrame, keys: list[str]) -> list[Group]:
    found = []
    for key, part in table.groupby(keys, sort=False):
        family, departure, *level = cast(tuple[Any, ...], key)
        own = {str(name): rows for name, rows in part.groupby("detector", sort=False)}
        places = {name: rate(rows["right"]) for name, rows in own.items()}
        errors = {name: median(rows[rows["right"]]["vector_error"]) for name, rows in own.items()}
        found.append(Group(str(family), str(departure), float(level[0]) if level else None, places, errors))
    return found
