"""What people see in the outputs of a run: blind pages to label, their key files, the answers that come back."""

from __future__ import annotations

import csv
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nrbench.errors import BadInput
from nrbench.runs.records import CellRecord, Run
from nrbench.runs.store import read_json, write_json
from nrbench.streams import stream

ANSWERS = ("preserved", "lost", "cannot say")
"""What a person can answer, in the order of the keys 1, 2, 3."""
COLUMNS = ("item", "answer", "seconds", "order")
"""The columns of an answer file."""
PRESERVED = "regularity.preserved"
_LETTERS = "bcdfghjkmnpqrstvwxz"
_LEAST_GAP = 10


@dataclass(frozen=True)
class Item:
    """One showing of an output.

    Parameters
    ----------
    id
        Ten letters that say nothing: neither a number that a spreadsheet would change, nor a word.
    cell
        Key of the cell; it stands in the key file alone, never on the page.
    again
        Whether the output was shown before, for self-agreement.
    """

    id: str
    cell: str
    again: bool


@dataclass(frozen=True)
class Sheet:
    """A page to label: its name and its items in the order in which they are shown."""

    name: str
    items: Sequence[Item]

    def key_file(self, root: Path) -> Path:
        """Return where the key of the page lies, beside the run's other files."""
        return _folder(root) / f"{self.name}.json"


@dataclass(frozen=True)
class Answer:
    """What one person answered to one item.

    Parameters
    ----------
    item
        The item; it holds the cell's key.
    answer
        One of :data:`ANSWERS`.
    seconds
        From the picture to the answer.
    order
        Place in the order of showing, from 1.
    """

    item: Item
    answer: str
    seconds: float
    order: int


@dataclass(frozen=True)
class Person:
    """One person's answers.

    Parameters
    ----------
    name
        The stem of the file they came in.
    answers
        In the file's order.
    """

    name: str
    answers: Sequence[Answer]

    def by_cell(self, again: bool = False) -> dict[str, str]:
        """Return the answer by cell's key, of the first showing or of the second."""
        return {one.item.cell: one.answer for one in self.answers if one.item.again == again}


def judge_says(record: CellRecord) -> str:
    """Return what the judge says of a cell, in the words of people: undecided is ``cannot say``."""
    preserved = record.values.get(PRESERVED)
    return ANSWERS[2] if preserved is None else ANSWERS[0] if preserved else ANSWERS[1]


def shown(run: Run) -> list[CellRecord]:
    """Return the cells that people are asked about: those with an output, of textures that have a lattice to keep."""
    ended = [record for record in run.cells if record.status == "ok" and (record.folder / "output.png").is_file()]
    return [one for one in ended if one.lattice_truth is not None or one.values.get(PRESERVED) is not None]


def make_sheet(run: Run, repeat: float = 0.1, seed: int = 0) -> Sheet:
    """Return a page's items in random order; the same run, share and seed give the same page.

    Parameters
    ----------
    run
        Its cells that have ended are shown.
    repeat
        Share of the outputs that are shown a second time, at least some ten items later, in [0, 1].
    seed
        Seed of order, names and repeats. The stream also depends on the cells, so that no two runs share a name.

    Raises
    ------
    BadInput
        When the run has nothing to show.
    """
    cells = sorted(record.key for record in shown(run))
    if not cells:
        raise BadInput(f"{run.root}: has no output of a texture with a lattice; nothing can be labelled")
    entropy = json.dumps([cells, float(repeat), int(seed)])
    rng = stream("labels", entropy)
    order = [cells[i] for i in rng.permutation(len(cells))]
    places = _showings(len(order), math.ceil(repeat * len(order) - 1e-9), rng)
    names = _names(len(places), rng)
    name = hashlib.blake2b(entropy.encode(), digest_size=4).hexdigest()
    return Sheet(name, [Item(id, order[i], again) for id, (i, again) in zip(names, places, strict=True)])


def _showings(count: int, repeats: int, rng: np.random.Generator) -> list[tuple[int, bool]]:
    """Return (place in the order, whether again) of each showing."""
    gap = min(_LEAST_GAP, count // 2)
    early = max(count - gap, repeats)
    again = rng.choice(early, repeats, replace=False)
    when = [(float(i), int(i), False) for i in range(count)]
    when += [(float(rng.uniform(i + gap, max(count, i + gap) + 0.5)), int(i), True) for i in again]
    return [(i, second) for _, i, second in sorted(when)]


def _names(count: int, rng: np.random.Generator) -> list[str]:
    found: dict[str, None] = {}
    while len(found) < count:
        found["".join(rng.choice(list(_LETTERS), 10))] = None
    return list(found)


def write_key(root: Path, sheet: Sheet) -> Path:
    """Write which cell each item of a page is, beside the run, and return the path."""
    path = sheet.key_file(root)
    write_json(path, {"sheet": sheet.name, "items": [asdict(item) for item in sheet.items]})
    return path


def _folder(root: Path) -> Path:
    return root / "labels"


def read_people(run: Run, files: Sequence[Path]) -> list[Person]:
    """Return the answers in files that the run's pages saved, one person a file.

    Raises
    ------
    BadInput
        For a file that cannot be read, wrong columns, an answer that is none, an item that is twice in a file or on no
        page of this run; naming file and line.
    """
    if not files:
        return []
    known = _known_items(run)
    names = _person_names(files)
    return [Person(name, _read_answers(Path(file), known)) for name, file in zip(names, files, strict=True)]


def _person_names(files: Sequence[Path]) -> list[str]:
    """Return the stems; where two are equal, the whole paths."""
    stems = [Path(file).stem for file in files]
    doubled = next((str(file) for i, file in enumerate(files) if file in files[:i]), None)
    if doubled:
        raise BadInput(f"{doubled}: is given twice; pass each person's answers once")
    return [str(file) if stems.count(stem) > 1 else stem for stem, file in zip(stems, files, strict=True)]


def _known_items(run: Run) -> dict[str, Item]:
    cells = {record.key for record in run.cells}
    pages = [read_json(path) for path in sorted(_folder(run.root).glob("*.json"))]
    items = [Item(**item) for page in pages if page for item in page.get("items", [])]
    if not items:
        raise BadInput(f"{run.root}: no page was made to label this run; make one by `nrbench label {run.root}`")
    return {item.id: item for item in items if item.cell in cells}


def _read_answers(path: Path, known: Mapping[str, Item]) -> list[Answer]:
    rows = _rows(path)
    found = [_answer(row, known, f"{path}, line {number}") for number, row in enumerate(rows, 2)]
    ids = [one.item.id for one in found]
    twice = next((id for id in ids if ids.count(id) > 1), None)
    if twice:
        raise BadInput(f"{path}: item {twice!r} is answered twice; leave the answer that counts")
    if not found:
        raise BadInput(f"{path}: holds no answer; save the answers by the page's button first")
    return found


def _rows(path: Path) -> list[dict[str, Any]]:
    """Return the rows of an answer file; a byte order mark, as spreadsheets write it, is no harm."""
    try:
        text = path.read_text("utf-8-sig")
    except UnicodeDecodeError as error:
        raise BadInput(f"{path}: is no text in UTF-8; pass the CSV that the page saved") from error
    except IsADirectoryError as error:
        raise BadInput(f"{path}: is a directory; pass the CSV that the page saved") from error
    except FileNotFoundError as error:
        raise BadInput(f"{path}: there is no such file; pass the CSV that the page saved") from error
    table = csv.DictReader(text.splitlines())
    columns = table.fieldnames or []
    if sorted(columns) != sorted(COLUMNS):
        raise BadInput(f"{path}: has columns {', '.join(columns) or 'none'}; due are {', '.join(COLUMNS)}")
    return [row for row in table if any(row.values())]


def _answer(row: Mapping[str, Any], known: Mapping[str, Item], where: str) -> Answer:
    id, answer = row["item"], row["answer"]
    if id not in known:
        raise BadInput(f"{where}: item {id!r} is on no page of this run; pass answers to a page made for it")
    if answer not in ANSWERS:
        raise BadInput(f"{where}: answer {answer!r} is none; use one of: {', '.join(ANSWERS)}")
    try:
        seconds, order = float(row["seconds"]), int(row["order"])
    except (TypeError, ValueError) as error:
        raise BadInput(f"{where}: seconds and order must be numbers; leave them as the page saved them") from error
    if None in row or not (math.isfinite(seconds) and seconds >= 0 and order >= 1):
        raise BadInput(f"{where}: is no answer as the page saves it (item, answer, seconds >= 0, order >= 1)")
    return Answer(known[id], answer, seconds, order)
