"""Detect the lattices of a folder of pictures, and write ``truth.csv`` and contact sheets by which people check it."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, NamedTuple

import numpy as np

from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice, Vector
from nrbench.pictures.files import list_pictures, read_image, write_image
from nrbench.pictures.overlays import contact_sheet, draw_overview, zoom_panels
from nrbench.pictures.truth import KNOWN_FILE, ORIGIN, SHEET, TRUTH_FILE, VECTORS, TruthRow, TruthTable, table_text
from nrbench.plugins.forms import Alternative, Detection, Detector, NoLatticeFound
from nrbench.plugins.parameters import parse_spec
from nrbench.storage import write_text

SHOWN = 3
"""Number of candidates that are drawn and listed."""
FIELDS = ("file", *VECTORS, *ORIGIN, "confidence", "detector", "candidates", "reason")
"""The columns of ``truth.csv``. Of these, ``nrbench run`` reads ``file``, the vectors and the origin."""
FOLDER = "lattices"
"""The folder of the contact sheets, within that of ``truth.csv``: `nrbench run` ignores subfolders."""
ON_PAGE = 8
"""Number of pictures on a contact sheet."""
REJECTED = "rejected"
"""The relation of a candidate that the detector rejected."""
_LETTERS = 38
"""Number of letters on a line of a caption."""
_LINES = 5
"""Number of lines of a caption."""
_BLANK: Image = np.ones((1, 1, 3), np.float32)
Progress = Callable[[int, int, str], object]
"""``progress(done, total, name)`` is called after each picture."""


def rank_candidates(detection: Detection) -> list[Alternative]:
    """Return the chosen lattice, then its alternatives in their order; the relation of the chosen one is empty."""
    chosen = Alternative(detection.lattice, detection.confidence, "", has_origin=detection.has_origin)
    return [chosen, *detection.alternatives]


def draw_candidates(image: Image, candidates: Sequence[Alternative]) -> tuple[list[Image], list[str]]:
    """Return a panel and a caption for each of the first :data:`SHOWN` candidates, see :func:`zoom_panels`."""
    shown = candidates[:SHOWN]
    panels = zoom_panels(image, [candidate.lattice for candidate in shown])
    return panels, [_candidate_caption(number, candidate) for number, candidate in enumerate(shown, 1)]


def _candidate_caption(number: int, candidate: Alternative) -> str:
    confidence = f"confidence {candidate.confidence:.2f}"
    lines = vector_texts(candidate.lattice, candidate.has_origin, "z.2f")
    return "\n".join([f"{number}: {candidate.relation or 'chosen'}", confidence, *lines])


def vector_texts(lattice: Lattice, has_origin: bool, form: str = ".3f") -> list[str]:
    """Return the vectors, and the origin if it is known, each as ``name = (x, y) px`` with numbers of a format."""
    known = known_vectors(lattice, has_origin).items()
    return [f"{name} = ({x:{form}}, {y:{form}}) px" for name, (x, y) in known]


def known_vectors(lattice: Lattice, has_origin: bool) -> dict[str, Vector]:
    """Return t1 and t2, and the origin if it is known."""
    known = {"t1": lattice.t1, "t2": lattice.t2}
    return {**known, "origin": lattice.origin} if has_origin else known


def candidate_dict(candidate: Alternative) -> dict[str, Any]:
    """Return a mapping that can be written as JSON: the vectors, and what is known about the candidate."""
    return {
        **known_vectors(candidate.lattice, candidate.has_origin),
        **{name: value for name, value in vars(candidate).items() if name not in ("lattice", "has_origin")},
    }


def lattice_text(lattice: Lattice, has_origin: bool) -> str:
    """Return ``"x1,y1,x2,y2"``, or with the origin if it is known ``"x1,y1,x2,y2,x,y"``, to a ten-thousandth px."""
    numbers = [number for vector in known_vectors(lattice, has_origin).values() for number in vector]
    return ",".join(repr(round(float(number), 4) + 0.0) for number in numbers)


class SurveyedPicture(NamedTuple):
    """What a survey found in one picture.

    Parameters
    ----------
    name
        The name of the file.
    lattice
        The lattice that counts as known; None if there is none.
    confidence
        The detector's confidence in the first candidate; None if the lattice was read from ``truth.csv``, or if there
        is no candidate.
    candidates
        The chosen lattice, then the most probable others; if the detector rejected its best candidate, this one.
    reason
        Why no lattice is known.
    failed
        Whether the picture could not be read, or the detector raised an error.
    kept
        The row of an earlier ``truth.csv`` that was kept.
    has_origin
        Whether the origin of the lattice is known.
    """

    name: str
    lattice: Lattice | None = None
    confidence: float | None = None
    candidates: tuple[Alternative, ...] = ()
    reason: str = ""
    failed: bool = False
    kept: TruthRow | None = None
    has_origin: bool = False

    @property
    def is_doubtful(self) -> bool:
        """Whether the detector found a lattice, but with too low a confidence."""
        return self.lattice is None and any(each.relation != REJECTED for each in self.candidates)

    def row(self, detector: str) -> Mapping[str, object]:
        """Return the line of ``truth.csv``."""
        if self.kept is not None:
            return self.kept.values
        row: dict[str, object] = {"file": self.name, "detector": detector, "reason": self.reason}
        if self.lattice is not None:
            names = (*VECTORS, *ORIGIN)
            row |= dict(zip(names, lattice_text(self.lattice, self.has_origin).split(","), strict=False))
        if self.confidence is not None:
            row["confidence"] = f"{self.confidence:.3f}"
        listed = [
            (lattice_text(each.lattice, each.has_origin), f"{each.confidence:.3f}, {each.relation}".removesuffix(", "))
            for each in self.candidates[:SHOWN]
        ]
        row["candidates"] = "; ".join(f"{numbers} ({note})" for numbers, note in listed)
        return row

    def as_dict(self) -> dict[str, Any]:
        """Return a mapping that can be written as JSON."""
        return {
            "file": self.name,
            **(known_vectors(self.lattice, self.has_origin) if self.lattice else {"lattice": None}),
            "confidence": self.confidence,
            "candidates": [candidate_dict(candidate) for candidate in self.candidates],
            "reason": self.reason,
            "failed": self.failed,
            "kept": self.kept is not None,
        }


@dataclass
class Survey:
    """Detect the lattices of all pictures of a folder.

    Parameters
    ----------
    folder
        The pictures; ``nrbench run`` takes the same ones. Subfolders are ignored.
    detector
        A detector with its parameters, ``name:param=value,...``.
    output
        The directory of ``truth.csv``; its subfolder :data:`FOLDER` holds the contact sheets. None: ``folder``, where
        ``nrbench run`` reads the table.
    least
        Vectors of a lower confidence are not written as known, only as candidates: a lattice of a confidence below 0.5
        is more probably wrong than right.
    existing
        What is done with a ``truth.csv`` that exists: ``"refuse"`` it, ``"keep"`` its lines and detect the lattices of
        the other pictures only, or ``"replace"`` it.

    Raises
    ------
    BadInput
        If there is no such folder or no picture in it, the detector is not known, or a ``truth.csv`` exists that is to
        be refused or that is malformed.
    """

    folder: Path
    detector: str = field(default_factory=lambda: plugins.in_role("detector"))
    output: Path | None = None
    least: float = 0.5
    existing: str = "refuse"
    findings: list[SurveyedPicture] = field(default_factory=list, init=False)
    pages: list[Path] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        self.directory = self.folder if self.output is None else self.output
        self.table = self.directory / TRUTH_FILE
        self._detector: Detector = plugins.build("detectors", *parse_spec(self.detector))
        self._pictures = [path for path in list_pictures(self.folder) if not self._is_rendered_sheet(path)]
        if not self._pictures:
            raise BadInput(f"directory {self.folder}: has no picture; put PNG, JPEG or TIFF files into it")
        if self.table.exists() and self.existing == "refuse":
            raise BadInput(
                f"{self.table}: exists, and may hold your corrections; pass --keep to keep its lines and add the "
                "missing pictures, --force to replace it, or -o with another directory"
            )
        keeps = self.existing == "keep" and self.table.exists()
        self._known = TruthTable.read(self.directory) if keeps else TruthTable(FIELDS, {})
        self._waiting: list[tuple[list[Image], list[str]]] = []

    def _is_rendered_sheet(self, path: Path) -> bool:
        return path.name == SHEET and (self.folder / KNOWN_FILE).is_file()

    def run(self, progress: Progress) -> None:
        """Detect all lattices, and write the table and the contact sheets. What was found is written if it is stopped.

        Raises
        ------
        BadInput
            If the directory cannot be written.
        """
        try:
            (self.directory / FOLDER).mkdir(parents=True, exist_ok=True)
            for place in (self.directory, self.directory / FOLDER):  # before hours of work, not after them
                with TemporaryFile(dir=place):
                    pass
        except OSError as error:
            raise BadInput(f"{self.directory}: cannot be written ({error.strerror}); pass another -o") from None
        try:
            for done, path in enumerate(self._pictures, 1):
                finding, image = self._examine(path)
                self.findings.append(finding)
                self._add_to_page(finding, image)
                progress(done, len(self._pictures), printable(path.name))
        finally:
            self._write_page()
            self._write_table()
        self._remove_old_pages()

    def _examine(self, path: Path) -> tuple[SurveyedPicture, Image | None]:
        """Return what is found in one picture, and the picture; whatever goes wrong is a finding."""
        known = self._known.rows.get(path.name)
        image = None
        if not _is_unicode(path.name):
            return SurveyedPicture(path.name, reason="the name is no Unicode text; rename the file", failed=True), None
        try:
            image = read_image(path)
            if known is not None:
                return _read_row(path.name, known), image
            return self._detect(path.name, image), image
        except BadInput as error:
            reason = str(error).removeprefix(f"picture {path}: ")
        except Exception as error:
            reason = f"failed: {type(error).__name__}: {error}"
        return SurveyedPicture(path.name, reason=reason, failed=True, kept=known), image

    def _detect(self, name: str, image: Image) -> SurveyedPicture:
        try:
            detection = self._detector.detect(image)
        except NoLatticeFound as none:
            if none.best is None:
                return SurveyedPicture(name, reason=none.reason)
            best = replace(rank_candidates(none.best)[0], relation=REJECTED)
            return SurveyedPicture(name, None, none.best.confidence, (best,), none.reason)
        candidates, confidence = tuple(rank_candidates(detection)), float(detection.confidence)
        if confidence < self.least:
            reason = f"confidence below {self.least:g}: choose one of the candidates"
            return SurveyedPicture(name, None, confidence, candidates, reason)
        return SurveyedPicture(name, detection.lattice, confidence, candidates, has_origin=detection.has_origin)

    def _add_to_page(self, finding: SurveyedPicture, image: Image | None) -> None:
        """Draw a picture with its lattice and the candidates; write the page when it is full."""
        panels = [_BLANK if image is None else draw_overview(image, finding.lattice)]
        captions = [_picture_caption(finding, image)]
        if image is not None and finding.candidates:
            drawn, texts = draw_candidates(image, finding.candidates)
            panels, captions = panels + drawn, captions + texts
        elif image is not None and finding.lattice is not None:
            panels += zoom_panels(image, [finding.lattice])
            captions.append(
                "\n".join([f"from {TRUTH_FILE}", *vector_texts(finding.lattice, finding.has_origin, "z.2f")])
            )
        self._waiting.append((panels, captions))
        if len(self._waiting) == ON_PAGE:
            self._write_page()

    def _write_page(self) -> None:
        if not self._waiting:
            return
        columns = max(len(row) for row, _ in self._waiting)
        panels, captions = [], []
        for row, texts in self._waiting:
            missing = columns - len(row)
            panels += row + [_BLANK] * missing
            captions += [text + "\n" * (_LINES - 1 - text.count("\n")) for text in texts] + [""] * missing
        path = self.directory / FOLDER / f"page-{len(self.pages) + 1}.png"
        self.pages.append(write_image(path, contact_sheet(panels, captions, columns)))
        self._waiting = []

    def _write_table(self) -> None:
        fields = [*self._known.fields, *(name for name in FIELDS if name not in self._known.fields)]
        rows = [each.row(self.detector) for each in self.findings if _is_unicode(each.name)]
        seen = {each.name for each in self.findings}
        others = [row.values for name, row in self._known.rows.items() if name not in seen]
        if len(rows) + len(others) > len(self._known.rows) or not self.table.exists():
            write_text(self.table, table_text(fields, [*rows, *others]))

    def _remove_old_pages(self) -> None:
        """Remove the pages of an earlier survey that had more of them."""
        number = len(self.pages) + 1
        while (old := self.directory / FOLDER / f"page-{number}.png").is_file():
            old.unlink()
            number += 1


def _read_row(name: str, row: TruthRow) -> SurveyedPicture:
    """Return the lattice of a line of ``truth.csv``."""
    if not row.vectors:
        return SurveyedPicture(name, reason=row.values.get("reason", "") or "no lattice is known", kept=row)
    lattice = Lattice(row.vectors["t1"], row.vectors["t2"], row.vectors.get("origin", (0.0, 0.0)))
    return SurveyedPicture(name, lattice, kept=row, has_origin="origin" in row.vectors)


def _picture_caption(finding: SurveyedPicture, image: Image | None) -> str:
    lines = textwrap.wrap(printable(finding.name), _LETTERS, max_lines=2, placeholder="...") or [""]
    if image is not None:
        lines.append(f"{image.shape[1]} x {image.shape[0]} px")
    state = finding.reason
    if finding.lattice is not None:
        state = f"kept from {TRUTH_FILE}" if finding.kept else f"candidate 1 is in {TRUTH_FILE}"
    return "\n".join([*lines, *textwrap.wrap(printable(state), _LETTERS, max_lines=_LINES - len(lines))])


def printable(text: str) -> str:
    """Return a text on one line: line ends, control characters and what is no Unicode are written as escapes."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape", "backslashreplace").decode() for c in text)


def _is_unicode(name: str) -> bool:
    return not any("\ud800" <= letter <= "\udfff" for letter in name)
