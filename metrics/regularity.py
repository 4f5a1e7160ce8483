"""Regularity: whether the elements of the output lie where the lattice puts them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice, Points
from nrbench.lattice.relation import lattice_error
from nrbench.plugins.forms import Column, Observation, Score, Value

from .judgment.examination import Examination, examine
from .judgment.texture_reference import CannotTell
from .perception import limits
from .perception.visible import draw_in_bands, tint_places
from .registration.followed import FollowedPicture
from .registration.lattice_net import Mask
from .registration.lattice_nodes import LatticeNodes

COLORS = ((1.0, 0.6, 0.0), (0.9, 0.1, 0.1))
"""Colors of a cell that is a little out of place, and of one that is wholly out of place."""
_LEAST_SHOWN = 0.05
"""Amount out of place from which on a cell has a color."""


def _distance(meaning: str, unit: str = "of s") -> Column:
    over = ", over the shortest lattice vector s" if unit == "of s" else ""
    return Column(f"{meaning}{over}.", unit, (0.0, math.inf), "lower")


@dataclass(frozen=True)
class Regularity:
    r"""How well the output keeps the lattice, measured on its pixels.

    Windows of one to three cells, at every half cell, are compared with the mean cell of the texture at all
    displacements (:class:`~nrbench.metrics.registration.followed.FollowedPicture`). With the variance :math:`v` of each
    point of the cell in CIELAB, the displacement of a window :math:`x` minimizes

    .. math:: \sum_p \frac{(x(p + d) - m(p))^2}{v(p) + JND^2}.

    A window is in place if it lies where the windows around it that are in place put it. Smooth bending and drift leave
    all of them in place; what lies beyond a slip, and what shows the pattern nowhere, is out of place. The free phase
    does not count, nor does a drift within 2 %, the uncertainty of a lattice marked by hand: larger drifts lower the
    score, down to 0 at 6 %. Where the references drift more, because the texture bends, more is allowed.

    A method is judged by the lattice that it declares (``lattice_used``): of the output's drifts from this lattice and
    from the true one the smaller counts, and places are those of the declared lattice if the output lies nearer to it.
    Randomness, integrity and appearance follow the same one. The representative tile, for example, rounds its period to
    whole pixels and says so. A declared lattice counts if it is the true one, or a supercell of it, to 1 px of the true
    vectors as in ``lattice_recovery``, and stretches and turns them by at most 6 %. Any other lattice excuses nothing.
    A supercell excuses no more than the true lattice stretched alike: the places of the single tiles are measured.
    The distance of the declared lattice from the true one is ``lattice_recovery.drift``.

    Let b be the share of the output that is out of place beyond what chance explains in the references. A window whose
    departure lies between the limit of the references and a quarter of s counts in part. The score is 1 - 2 b: half of
    the tiles in another phase is no lattice. ``preserved`` is the verdict: a score of at least 0.85. It is undecided if
    more than a third of the references themselves is out of place.

    The references are fresh draws of the model. For a photograph they are four strips of the sample, each compared with
    the mean cell of the other three. Without a model the given lattice is used, reduced to the smallest one by which
    the sample repeats. If none is given, the detector ``dominance`` finds the lattice of the sample; no method uses it
    by default. The record ``lattice_from`` names the source: model, given, or dominance.

    Beside one sample the phase coherence of matches is a second judge
    (:class:`~nrbench.metrics.registration.coherence.SampleMatches`). If each single cell of the sample shows its place,
    so that the windows are of one cell, registration decides. Otherwise the larger share out of place counts. Of drifts
    the smaller one counts. The record ``decided_by`` names whose share it is. Where the sample is too small or too
    uneven for one of both, the other decides.
    """

    version: ClassVar[str] = "13"
    uses: ClassVar[tuple[str, ...]] = ("dominance",)
    columns: ClassVar[Mapping[str, Column]] = {
        "preserved": Column("Whether the output kept the lattice everywhere.", better="higher"),
        "score": Column("Tiles in place: 1 all, 0 if half of them are out of place.", better="higher"),
        "misplaced_share": Column("Share of the output that is out of place, beyond chance.", better="lower"),
        "torn_share": Column("Share of the cells that show the pattern nowhere.", better="lower"),
        "misplacement_median": _distance("Median distance of windows from their place"),
        "misplacement_p95": _distance("95th percentile of the distance of windows from their place"),
        "misplacement_median_px": _distance("Median distance of windows from their place", "px"),
        "misplacement_p95_px": _distance("95th percentile of the distance of windows from their place", "px"),
        "worst_slip": _distance("Largest difference between the displacements of the two sides of a line"),
        "misplacement_ratio": Column(
            "Bending of the output over that of the references.", range=(0.0, math.inf), better="one"
        ),
        "drift": Column(
            "Stretch or rotation of the whole output from the true lattice.", "%", (0.0, math.inf), "lower"
        ),
        "lattice_exact": Column(
            "Whether the output's own least-squares lattice is the true one, to 1 px of its vectors.", better="higher"
        ),
        "lattice_vector_error": _distance("Larger error of the generating vectors of the output's own lattice", "px"),
        "lattice_vector_error_in_s": _distance("Larger error of the generating vectors of the output's own lattice"),
        "lattice_area_ratio": Column(
            "Area of the output's own cell over the true cell's.", range=(0.0, math.inf), better="one"
        ),
    }

    def score(self, observation: Observation) -> Score:
        """Return the scores, and the picture ``defects`` of the places that are out of place, if there are any."""
        return observation.shared(_score)


@dataclass(frozen=True)
class _Finding:
    """What registration, or coherence, says of an output."""

    by: str
    nodes: LatticeNodes
    bad: NDArray[np.float64]
    usual: float
    usual_drift: float

    @property
    def share(self) -> float:
        """Share out of place, beyond what chance explains."""
        return float(max(0.0, self.bad[self.nodes.valid].mean() - self.usual) / (1 - self.usual))

    def straightness(self, declared: Points) -> float:
        """Return 1 if the drift is not more than the references', falling to 0.

        Where the declared lattice is followed, the output's drift is that from it; else the declared one is deducted.
        """
        wider = max(1.0, min(limits.OF_NOISE * self.usual_drift, limits.MOST_DRIFT) / limits.DRIFT)
        most, own = limits.MOST_DRIFT, np.eye(2) + self.nodes.drift
        drift = min(np.linalg.norm(np.linalg.solve(np.eye(2) + each, own) - np.eye(2), 2) for each in (declared, 0))
        return float(np.clip((most * wider - drift) / ((most - limits.DRIFT) * wider), 0, 1))


def _find(examination: Examination) -> list[_Finding]:
    """Return what can be told by registration and by coherence."""
    found = []
    with suppress(CannotTell):
        followed, reference = examination.followed, examination.reference
        if reference.most_misplaced <= limits.MOST_OWN:
            usual = max(float(np.linalg.norm(picture.drift, 2)) for picture in reference.pictures)
            found.append(_Finding("registration", followed, examination.misplacement, reference.most_misplaced, usual))
    own = examination.matches
    matched = own and examination.follow(own.follow)
    if matched and own and own.picture:
        bad, usual = matched.misplacement(own.slip_limit), float(np.linalg.norm(own.picture.drift, 2))
        found.append(_Finding("coherence", matched, bad, own.most_misplaced, usual))
    return found


def _score(observation: Observation) -> Score:
    examination, reasons = examine(observation), dict[str, str]()
    records: dict[str, Any] = {"lattice_from": examination.known_lattice.origin}
    found = _find(examination)
    values: dict[str, Value] = dict.fromkeys(Regularity.columns)
    try:
        _measure(examination, values, reasons, records)
    except CannotTell as reason:
        reasons = dict.fromkeys(Regularity.columns, str(reason))
    if not found:
        return Score(values, reasons, records=records)
    sure = [finding for finding in found if finding.by == "registration" and finding.nodes.size == 1]
    worst = max(sure or found, key=lambda finding: finding.share)
    straightness = max(finding.straightness(examination.declared) for finding in found)
    score = max(0.0, 1 - limits.SLOPE * worst.share) * straightness
    values |= {"misplaced_share": worst.share, "score": score, "preserved": score >= limits.PRESERVED}
    reasons = {name: reason for name, reason in reasons.items() if values[name] is None}
    records |= {
        "decided_by": worst.by,
        "window_cells": worst.nodes.size,
        "misplacement_limit": worst.nodes.limit,
        "expected_share": worst.usual,
        "misplaced_shares": {finding.by: finding.share for finding in found},
    }
    shown = [(each.nodes, each.bad) for each in sure or found]
    any_shown = any((bad[nodes.valid] > _LEAST_SHOWN).any() for nodes, bad in shown)
    pictures = {"defects": draw_misplaced(observation.output, shown)} if any_shown else {}
    return Score(values, reasons, pictures, records)


def _measure(
    examination: Examination, values: dict[str, Value], reasons: dict[str, str], records: dict[str, Any]
) -> None:
    """Enter all but the share, the score and the verdict, measured by registration."""
    followed, reference = examination.traced, examination.reference
    distances = followed.away[followed.valid]
    for name, level in (("misplacement_median", 0.5), ("misplacement_p95", 0.95)):
        far = float(np.quantile(distances, level))
        values |= {name: far, f"{name}_px": followed.net.s * far}
    median, torn = reference.usual_misfit
    blank = reference.find_blank(followed)
    values["torn_share"] = float((blank | (followed.misfit > torn))[followed.valid].mean())
    values["worst_slip"] = float(followed.slip.max(initial=0))
    usual = float(np.mean([picture.bending for picture in reference.pictures]))
    values["misplacement_ratio"] = followed.bending / usual if usual >= limits.AMPLITUDE else None
    if values["misplacement_ratio"] is None:
        reasons["misplacement_ratio"] = "not applicable: the geometry of the texture does not vary"
    if reference.most_misplaced > limits.MOST_OWN:
        share = f"up to {reference.most_misplaced:.0%} of the reference itself is out of place by chance"
        reasons |= dict.fromkeys(("misplaced_share", "preserved", "score"), f"undecided: {share}")
    values |= _compare_lattice(examination, followed.in_place & ~blank, reasons)
    records |= {
        "reference": "sample" if reference.from_sample else "model",
        "slip_limit": reference.slip_limit,
        "expected_share": reference.most_misplaced,
        "misfit": [median, torn],
        "lattice": None if values["drift"] is None else _own_lattice(followed).as_dict(),
    }


def _compare_lattice(examination: Examination, in_place: Mask, reasons: dict[str, str]) -> dict[str, Value]:
    """Return the output's own lattice beside the true one: the affine part of the displacements."""
    names = ("drift", "lattice_exact", "lattice_vector_error", "lattice_vector_error_in_s", "lattice_area_ratio")
    followed, vectors = examination.traced, examination.reference.net.vectors
    share = float(in_place[followed.valid].mean())
    if share < 0.5:
        reasons |= dict.fromkeys(names, f"not measured: only {share:.0%} of the windows lie on one lattice")
        return dict.fromkeys(names)
    own, true = _own_lattice(followed), Lattice.from_basis(vectors)
    error = lattice_error(own, true, (followed.lab.shape[0], followed.lab.shape[1]))
    drift = 100 * float(np.linalg.norm(np.linalg.solve(vectors, own.matrix) - np.eye(2), 2))
    values = (drift, error.relation == "exact", error.vector, error.vector / true.s, error.area_ratio)
    return dict(zip(names, values, strict=True))


def _own_lattice(followed: FollowedPicture) -> Lattice:
    """Return the lattice of the net, moved by the affine part of the displacements."""
    net, where = followed.net, followed.in_place
    phase = (followed.expected[where] @ net.vectors).mean(0) - followed.centers[where].mean(0) @ followed.drift
    turned = np.eye(2) + followed.drift
    x, y = net.origin @ turned + phase
    return Lattice.from_basis(net.vectors @ turned, (float(x), float(y)))


def draw_misplaced(output: Image, found: Sequence[tuple[LatticeNodes, NDArray[np.float64]]]) -> Image:
    """Return the output in faint gray, with the cells around the nodes that are out of place in :data:`COLORS`."""

    def draw(band: Image, top: int) -> Image:
        height, width = band.shape[:2]
        amount = np.zeros((height, width))
        for nodes, bad in found:
            places = np.rint(2 * nodes.net.locate_pixels((height, width), top) - nodes.size).astype(np.intp)
            i, j = (place.clip(0, number - 1) for place, number in zip(places, bad.shape, strict=True))
            amount = np.maximum(amount, np.where(nodes.valid, bad, 0)[i, j])
        marked = amount > _LEAST_SHOWN
        return tint_places(band, marked, np.where(amount[marked, np.newaxis] < 0.5, COLORS[0], COLORS[1]))

    return draw_in_bands(output, draw)
