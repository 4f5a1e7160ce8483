"""A disagreement of judge and people as a picture, with the judge's numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from nrbench.runs.records import CellRecord, Run

from ..statistics.summary import Head
from ..statistics.verdicts import explanation
from .figures import ScoreLine, head_of, score_line
from .pictures import Picture, Pictures

_DEFECTS = "regularity.defects"


@dataclass(frozen=True)
class Disputed:
    """Sample, output and the judge's map of defects, and every score of regularity.

    Parameters
    ----------
    head
        The method with its lattice source.
    sample, output, layer
        The pictures; None where there is none.
    scale
        Page pixels a pixel, the same for all three.
    explanation
        Why the judge does not decide; empty where it does.
    scores
        The judge's numbers.
    """

    head: Head
    sample: Picture | None
    output: Picture | None
    layer: Picture | None
    scale: float
    explanation: str
    scores: Sequence[ScoreLine]


def disputed(run: Run, record: CellRecord, pictures: Pictures) -> Disputed:
    """Return what is shown of a cell on which people and judge disagree."""
    output, map_file = pictures.picture(record.folder / "output.png"), record.pictures.get(_DEFECTS)
    names = [name for name in run.columns if name.startswith("regularity.")]
    return Disputed(
        head=head_of(record),
        sample=pictures.picture(record.folder / "sample.png"),
        output=output,
        layer=pictures.picture(map_file) if map_file and output else None,
        scale=output.scale if output else 1.0,
        explanation=explanation(record),
        scores=[line for name in names if (line := score_line(run, record, name))],
    )
