"""Regularity: whether the output kept the lattice, measured on pixels against the periodic image."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from nrbench.synthesis import Column, Observation, Score, Value

from .defect_map import defect_map
from .judgement import Judgement, judge, obstacle


def _distance(meaning: str) -> Column:
    return Column(f"{meaning}, over the shortest lattice vector s.", "of s", (0.0, math.inf), "lower")


@dataclass(frozen=True)
class Regularity:
    """How well the output keeps the true lattice, without asking any detector.

    The texture's periodic image - the model's own, or the mean tile of the sample folded by the given lattice - is the
    template. Windows of the output 2 tiles wide, half a window apart, are registered against it by weighted NCC over
    one cell of displacements, sub-pixel. The displacement that most windows share is the output's phase, which is free;
    what remains, modulo the lattice and over its shortest vector s, is each window's misplacement. Then windows of one
    tile, half a cell apart, are compared with the template at that phase, every pixel weighted by the inverse of its
    variance across tiles, which shows single tiles that are displaced, missing or broken.

    All limits are relative to fresh draws of the model (of a photograph: to the sample itself, each part against the
    mean tile of the rest): see ``nrbench.metrics.limits``. For a photograph the affine part of the displacement, up to
    2 %, is taken for uncertainty of the given lattice: reported as drift, and left out of everything else. That is
    allowed once to the sample, whose lattice is fitted, and once more to the output.
    """

    version: ClassVar[str] = "1"
    columns: ClassVar[Mapping[str, Column]] = {
        "preserved": Column("Whether the output kept the lattice everywhere.", better="higher"),
        "score": Column("Share of tiles that are in place and intact.", better="higher"),
        "misplacement_median": _distance("Median displacement of windows from their place"),
        "misplacement_p95": _distance("95th percentile of the windows' displacement from their place"),
        "misplaced_share": Column("Share of windows that are out of place.", better="lower"),
        "worst_neighborhood": _distance("Largest median displacement of 3 x 3 windows"),
        "structure": Column(
            "Median correlation of windows with the periodic image, over that of fresh draws.",
            range=(-math.inf, math.inf),
            better="one",
        ),
        "bad_tiles": Column("Tiles that are displaced or broken by themselves.", "tiles", (0.0, math.inf), "lower"),
        "drift": Column("Stretch or turn of the whole output against the true lattice.", "%", (0.0, math.inf), "lower"),
    }

    def score(self, observation: Observation) -> Score:
        """Return the scores, and the picture ``defects``: the output dimmed, bad tiles in color."""
        judgement = judge(observation)
        if judgement is None or obstacle(judgement):
            return no_score(self.columns, obstacle(judgement))
        values = _values(judgement)
        reasons = {} if values["preserved"] is not None else {"preserved": f"undecided: {judgement.blindness}"}
        if values["drift"] is None:
            reasons["drift"] = "not measured: fewer than 3 x 3 windows"
        return Score(values, reasons, {"defects": defect_map(judgement)}, _records(judgement))


def no_score(columns: Mapping[str, Column], reason: str) -> Score:
    """Return None for every column, with the same reason."""
    return Score(dict.fromkeys(columns), dict.fromkeys(columns, reason))


def _values(judgement: Judgement) -> dict[str, Value]:
    misplacement = judgement.output.placement.misplacement
    return {
        "preserved": judgement.preserved,
        "score": judgement.score,
        "misplacement_median": float(np.median(misplacement)),
        "misplacement_p95": float(np.quantile(misplacement, 0.95)),
        "misplaced_share": float(judgement.misplaced.mean()),
        "worst_neighborhood": judgement.worst_neighborhood,
        "structure": judgement.structure,
        "bad_tiles": float(len(judgement.bad_places)),
        "drift": 100 * float(np.linalg.norm(judgement.drift, 2)) if min(judgement.output.placement.grid) >= 3 else None,
    }


def _records(judgement: Judgement) -> dict[str, Any]:
    placement = judgement.output.placement
    return {
        "yardstick": judgement.yardstick.source,
        "regular_share": judgement.yardstick.regular_share,
        "lattice": judgement.output.tiles.lattice.as_dict(),
        "phase": [float(value) for value in placement.phase],
        "windows": list(placement.grid),
        "misplacement_limit": judgement.limit,
        "faults": list(judgement.faults),
        "bad_places": [[float(x), float(y)] for x, y in judgement.bad_places],
    }
