"""What the command ``lattice`` says of a lattice: as text, as JSON, and in the table of a comparison."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from nrbench.api.surveying import SHOWN, candidate_dict, known_vectors, rank_candidates, vector_texts
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Alternative, Detection

if TYPE_CHECKING:
    from nrbench.tracking.bent_lattice import Deformation
    from nrbench.views.deformed import Followed


@dataclass(frozen=True)
class LatticeResult:
    """The result of a detector or of the user: a lattice, or why there is none.

    ``detection`` is that of a detector. ``has_origin`` says whether the origin is known. ``seconds`` is set in a
    comparison. ``failed`` marks a detector that raised an error. ``deformation`` is that of a bent image, of which
    ``lattice`` is the mean lattice, and ``detection`` what the detector found in the straightened image, whose own
    lattice is ``straightened`` if it was written. ``detector`` is empty if a lattice was given that was followed.
    """

    detector: str
    lattice: Lattice | None
    detection: Detection | None = None
    reason: str = ""
    has_origin: bool = False
    seconds: float | None = None
    failed: bool = False
    deformation: Deformation | None = None
    straightened: Lattice | None = None

    @classmethod
    def of_detection(cls, detector: str, detection: Detection, seconds: float | None = None) -> LatticeResult:
        """Return the result of a detector."""
        return cls(detector, detection.lattice, detection, has_origin=detection.has_origin, seconds=seconds)

    @classmethod
    def of_followed(cls, detector: str, followed: Followed, straightened: Lattice | None = None) -> LatticeResult:
        """Return the mean lattice of an image that may be bent; its origin is known if the image was straightened."""
        (found, detection), known = followed, straightened is not None
        if detection is not None:
            detection = replace(detection, lattice=found.lattice, has_origin=known)
        return cls(detector, found.lattice, detection, has_origin=known, deformation=found, straightened=straightened)

    @property
    def candidates(self) -> list[Alternative]:
        """The first candidates of a detector, the chosen lattice among them."""
        return rank_candidates(self.detection)[:SHOWN] if self.detection else []

    @property
    def vectors(self) -> str:
        """The two vectors, and the origin where it is known, as text."""
        return ", ".join(vector_texts(self.lattice, self.has_origin)) if self.lattice else ""

    def print(self, as_json: bool) -> None:
        """Print the result on standard output."""
        if as_json:
            print(json.dumps(self.as_dict()))
        elif self.lattice is None:
            print(f"no lattice: {self.reason}")
        else:
            found = self.vectors if self.deformation is None else describe_deformation(self.deformation)
            confidence = "" if self.detection is None else f", confidence {self.detection.confidence:.3f}"
            print(f"{found}{self.detector and f', {self.detector}'}{confidence}")
            for number, each in enumerate(self.candidates[1:], 2):
                vectors = ", ".join(vector_texts(each.lattice, each.has_origin))
                print(f"candidate {number}: {vectors}, {each.relation}, confidence {each.confidence:.3f}")

    def as_dict(self) -> dict[str, Any]:
        """Return the lattice for JSON, with the alternatives and the probabilities of a detector; or the reason."""
        if self.lattice is None:
            return {"lattice": None, "reason": self.reason}
        found: dict[str, Any] = dict(known_vectors(self.lattice, self.has_origin))
        if self.detector:
            found |= {"detector": self.detector, "confidence": self.detection and self.detection.confidence}
        if self.detection is not None:
            probabilities = self.detection.probabilities
            found["probabilities"] = probabilities and probabilities._asdict()
            found["alternatives"] = [candidate_dict(each) for each in self.detection.alternatives]
        if self.deformation is not None:
            straight = {"straightened": self.straightened.as_dict()} if self.straightened else {}
            found["deformation"] = {**self.deformation.as_dict(), **straight}
        return found

    def comparison_dict(self) -> dict[str, Any]:
        """Return the entry of a comparison for JSON."""
        head = {} if self.lattice else {"detector": self.detector}
        seconds = {} if self.seconds is None else {"seconds": self.seconds}
        return {**head, **self.as_dict(), **seconds, **({"error": True} if self.failed else {})}

    def rows(self) -> list[str]:
        """Return the lines of a comparison's table: one for each of the first candidates, or why there is none."""
        seconds = "-" if self.seconds is None else f"{self.seconds:.3f}"
        if self.lattice is None:
            why = self.reason if self.failed else f"no lattice: {self.reason}"
            return [f"{self.detector:<12} {'-':<20} {'-':<20} {'-':>10} {seconds:>8}  {why}"]
        lines = []
        for number, candidate in enumerate(self.candidates, 1):
            t1, t2 = (f"({x:.3f}, {y:.3f})" for x, y in (candidate.lattice.t1, candidate.lattice.t2))
            name, cost = (self.detector, seconds) if number == 1 else (f"  {number}", "")
            line = f"{name:<12} {t1:<20} {t2:<20} {candidate.confidence:>10.3f} {cost:>8}  {candidate.relation}"
            lines.append(line.rstrip())
        return lines


def describe_deformation(found: Deformation) -> str:
    """Return the mean lattice and the deformation in one line of text."""
    vectors = ", ".join(vector_texts(found.lattice, has_origin=False))
    if not found.covered:
        return f"{vectors}, could not be followed: whether the image is bent is not known"
    if not found.bent:
        return f"{vectors}, not bent"
    kind = "smooth displacements" if found.homography is None else "a homography (perspective)"
    return f"mean lattice {vectors}, bent by {kind} of amplitude {found.amplitude:.2f} s"
