"""Folders of pictures with ``truth.csv`` and contact sheets: textures that are drawn, and lattices that are detected.

People check the detected lattices by the contact sheets.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from nrbench import plugins
from nrbench.api.arguments import detect_among
from nrbench.errors import BadInput, require
from nrbench.imaging.convert import Image
from nrbench.imaging.masks import MaskedImage
from nrbench.lattice.geometry import Lattice, Vector
from nrbench.pictures.files import list_pictures, read_image, read_masked, write_image
from nrbench.pictures.overlays import contact_sheet, draw_overview, zoom_panels
from nrbench.pictures.truth import (
    KNOWN_FILE,
    ORIGIN,
    SHEET,
    TRUTH_FIELDS,
    TRUTH_FILE,
    VECTORS,
    TruthRow,
    TruthTable,
    read_known,
    table_text,
)
from nrbench.plugins.forms import Alternative, Detection, Detector, NoLatticeFound, Texture
from nrbench.plugins.parameters import parse_spec, size_text
from nrbench.storage import make_writable, write_json, write_text
from nrbench.streams import pixels_hash
from nrbench.suites.plan import Sample
from nrbench.suites.suite import Suite, validated_suite

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
_BLANK: Image = np.ones((1, 1, 3), np.float32)
OnPicture = Callable[[int, int, str], object]
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
        sheet = SHEET if (self.folder / KNOWN_FILE).is_file() else ""  # that of a render
        self._pictures = [path for path in list_pictures(self.folder) if path.name != sheet]
        require(bool(self._pictures), f"directory {self.folder}: has no picture; put PNG, JPEG or TIFF files into it")
        if self.table.exists() and self.existing == "refuse":
            raise BadInput(
                f"{self.table}: exists, and may hold your corrections; pass --keep to keep its lines and add the "
                "missing pictures, --force to replace it, or -o with another directory"
            )
        keeps = self.existing == "keep" and self.table.exists()
        self._known = TruthTable.read(self.directory) if keeps else TruthTable(FIELDS, {})
        self._waiting: list[tuple[list[Image], list[str]]] = []

    def run(self, progress: OnPicture) -> None:
        """Detect all lattices, and write the table and the contact sheets. What was found is written if it is stopped.

        Raises
        ------
        BadInput
            If the directory cannot be written.
        """
        for place in (self.directory, self.directory / FOLDER):  # before hours of work, not after them
            make_writable(place, "pass another -o")
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
            masked = read_masked(path)
            image = masked.image
            if known is not None:
                return _read_row(path.name, known), image
            return self._detect(path.name, masked), image
        except BadInput as error:
            reason = str(error).removeprefix(f"picture {path}: ")
        except Exception as error:
            reason = f"failed: {type(error).__name__}: {error}"
        return SurveyedPicture(path.name, reason=reason, failed=True, kept=known), image

    def _detect(self, name: str, masked: MaskedImage) -> SurveyedPicture:
        try:
            detection = detect_among(self._detector, masked, bent=True)
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
            captions += texts + [""] * missing
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
    lines = [printable(finding.name)]
    if image is not None:
        lines.append(f"{image.shape[1]} x {image.shape[0]} px")
    state = finding.reason
    if finding.lattice is not None:
        state = f"kept from {TRUTH_FILE}" if finding.kept else f"candidate 1 is in {TRUTH_FILE}"
    return "\n".join([*lines, printable(state)])


def printable(text: str) -> str:
    """Return a text on one line: line ends, control characters and what is no Unicode are written as escapes."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape", "backslashreplace").decode() for c in text)


def _is_unicode(name: str) -> bool:
    return not any("\ud800" <= letter <= "\udfff" for letter in name)


_ELSEWHERE = "pass another -o, or move it away"
_ByName = dict[str, tuple[Sample, Texture]]
"""Textures to be written, by file name."""


def model_suite(spec: str) -> Suite:
    """Return a suite of a single model, ``name:param=value,...``; raise BadInput if it is not valid."""
    name, parameters = parse_spec(spec)
    plugins.build("datasets", name, parameters)
    return validated_suite({"name": name, "texture": [{"name": name, "dataset": name, "parameters": parameters}]}, spec)


def write_textures(samples: Iterable[Sample], directory: Path) -> list[Path]:
    """Write each texture as ``NAME.png`` (``NAME-REPLICATE.png`` from the second on), its truth, and a contact sheet.

    Other pictures of an earlier render in ``directory`` are kept with their truth, and are also on the contact sheet. A
    picture of the same name is replaced if a model can draw it again. All checks precede the first write.

    Returns
    -------
    list of Path
        The files written.

    Raises
    ------
    BadInput
        When a texture cannot be drawn, two textures have the same name, ``directory`` is a file, or a file would be
        lost (a truth file of another origin, or another picture of the same name).
    """
    existing = _Rendered.read(directory)
    by_name = _by_name(samples)
    for name, (_, texture) in by_name.items():
        existing.check_replaceable(directory / name, texture.image)
    if (directory / SHEET).exists() and not (directory / KNOWN_FILE).is_file():
        raise BadInput(f"{directory / SHEET}: exists, and was not written by `nrbench render`; {_ELSEWHERE}")
    rendered = dataclasses.replace(
        existing,
        rows={**existing.rows, **{name: _row(name, *pair) for name, pair in by_name.items()}},
        textures={**existing.textures, **{name: _known(*pair) for name, pair in by_name.items()}},
    )
    sheet = _sheet(directory, by_name, rendered)
    directory.mkdir(parents=True, exist_ok=True)
    for name, (_, texture) in by_name.items():
        write_image(directory / name, texture.image)
    rendered.write(directory)
    write_image(directory / SHEET, sheet)
    return [directory / name for name in (*by_name, SHEET, TRUTH_FILE, KNOWN_FILE)]


def _by_name(samples: Iterable[Sample]) -> _ByName:
    """Return textures by file name. Names that differ only in case are refused, as they are equal on some systems."""
    by_name: _ByName = {}
    taken = {SHEET}
    for sample in samples:
        if sample.texture is None:
            raise BadInput(f"{sample.row.name}: cannot be drawn: {sample.fault}")
        name = f"{sample.row.name}{f'-{sample.recipe.replicate}' if sample.recipe.replicate else ''}.png"
        if name.casefold() in taken:
            raise BadInput(f"{name}: the name of two pictures; rename the texture {sample.row.name!r}")
        taken.add(name.casefold())
        by_name[name] = sample, sample.texture
    return by_name


@dataclass(frozen=True)
class _Rendered:
    """The truth files of a rendered directory.

    Parameters
    ----------
    fields
        Columns of ``truth.csv``.
    rows
        Its lines, by file name.
    textures
        The entries of ``truth.json``, by file name.
    """

    fields: Sequence[str]
    rows: Mapping[str, Mapping[str, object]]
    textures: Mapping[str, Mapping[str, Any]]

    @classmethod
    def read(cls, folder: Path) -> _Rendered:
        """Read the truth of the pictures that exist in a directory; a new directory has none.

        Raises
        ------
        BadInput
            When ``folder`` is a file, or a truth file in it is malformed or was not written by a render.
        """
        require(folder.is_dir() or not folder.exists(), f"{folder}: is a file; pass a directory as -o")
        try:
            table = TruthTable.read(folder)
        except BadInput as error:
            raise BadInput(f"{error}. Fix {TRUTH_FILE} first, or pass another -o") from None
        missing = [name for name in TRUTH_FIELDS if name not in table.fields]
        if missing:
            why = f"was not written by `nrbench render` (it lacks column {missing[0]!r})"
            raise BadInput(f"{folder / TRUTH_FILE}: {why}; {_ELSEWHERE}")
        rows = {name: row.values for name, row in table.rows.items() if (folder / name).is_file()}
        textures = {name: known for name, known in _read_textures(folder).items() if (folder / name).is_file()}
        return cls(table.fields, rows, textures)

    def check_replaceable(self, path: Path, image: Image) -> None:
        """Raise BadInput if ``image`` would replace another picture that no model can draw again."""
        recipe = self.textures.get(path.name, {}).get("recipe")
        if path.exists() and not recipe and not (path.is_file() and _holds(path, image)):
            raise BadInput(f"{path}: exists, and no model drew it; {_ELSEWHERE}, or rename the texture")

    def write(self, folder: Path) -> None:
        """Write both truth files, each atomically."""
        write_text(folder / TRUTH_FILE, table_text(self.fields, list(self.rows.values())))
        write_json(folder / KNOWN_FILE, {"sheet": SHEET, "textures": self.textures})


def _read_textures(folder: Path) -> dict[str, dict[str, Any]]:
    content = read_known(folder, _ELSEWHERE)
    if content == {} and not (folder / KNOWN_FILE).is_file():
        return {}
    textures = content.get("textures") if isinstance(content, dict) else None
    if not (isinstance(textures, dict) and content.get("sheet") == SHEET and all(map(_is_known, textures.values()))):
        raise BadInput(f"{folder / KNOWN_FILE}: was not written by `nrbench render`; {_ELSEWHERE}")
    return textures


def _is_known(known: Any) -> bool:
    types = {"recipe": dict | None, "kind": str | None, "regular_share": float | int | None, "family": str | None}
    return isinstance(known, dict) and all(isinstance(known.get(name), each) for name, each in types.items())


def _holds(path: Path, image: Image) -> bool:
    """Return whether a file holds the given picture; this is so after an interrupted render."""
    try:
        return pixels_hash(read_image(path)) == pixels_hash(image)
    except BadInput:
        return False


def _sheet(directory: Path, by_name: _ByName, rendered: _Rendered) -> Image:
    """Return all pictures of the directory as it will be, each under its caption."""
    images = [by_name[name][1].image if name in by_name else read_image(directory / name) for name in rendered.textures]
    captions = [f"{name.removesuffix('.png')}\n{_caption(known)}" for name, known in rendered.textures.items()]
    return contact_sheet(images, captions)


def _caption(known: Mapping[str, Any]) -> str:
    kind, share, recipe = (known.get(name) for name in ("kind", "regular_share", "recipe"))
    words = [str((recipe or {}).get("dataset") or known.get("family", ""))]
    if kind:
        words.append(kind if kind == "stochastic" else f"type {kind}")
    if share is not None:
        words.append(f"regular share {share:.2f}")
    return ", ".join(words)


def _known(sample: Sample, texture: Texture) -> dict[str, Any]:
    """Return a picture's entry of ``truth.json``; :class:`~nrbench.suites.suite.TextureRow` reads some of it."""
    recipe = sample.recipe
    return {
        "family": sample.row.family or texture.family,
        "description": sample.row.description,
        "figure": sample.row.figure,
        "departure": sample.row.departure,
        "level": sample.row.level,
        "kind": texture.kind,
        "regular_share": texture.regular_share,
        "lattice": texture.lattice.as_dict() if texture.lattice else None,
        "lattices": [lattice.as_dict() for lattice in texture.lattices],
        "size": size_text(sample.shape),
        "recipe": {**recipe.as_dict(), "shape": size_text(recipe.shape)} if recipe.procedural else None,
    }


def _row(name: str, sample: Sample, texture: Texture) -> dict[str, object]:
    """Return a picture's line of ``truth.csv``; its numbers keep every digit."""
    row: dict[str, object] = {"file": name, "family": sample.row.family or texture.family, "kind": texture.kind or ""}
    row["regular_share"] = "" if texture.regular_share is None else texture.regular_share
    if texture.lattice is not None:
        for part in ("t1", "t2", "origin"):
            row[f"{part}x"], row[f"{part}y"] = map(repr, getattr(texture.lattice, part))
    return row
