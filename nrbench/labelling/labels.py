"""Pages on which people label the outputs of a run without the methods' names, and the answers that they save."""

from __future__ import annotations

import base64
import csv
import hashlib
import json
import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup

from nrbench.errors import BadInput
from nrbench.runs.records import CellRecord, Run
from nrbench.runs.store import RunDirectory
from nrbench.storage import read_json, write_json
from nrbench.streams import stream

ANSWERS = ("preserved", "lost", "cannot say")
"""A person's possible answers, in the order of the keys 1, 2, 3."""
COLUMNS = ("item", "answer", "seconds", "order")
"""The columns of a file of answers."""
PRESERVED = "regularity.preserved"
_LETTERS = "bcdfghjkmnpqrstvwxz"
_LEAST_GAP = 10
_TEMPLATES = Path(__file__).parent / "templates"
_PIXEL_CHUNKS = (b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND")


@dataclass(frozen=True)
class Item:
    """An output on a page. The same output may be two items.

    Parameters
    ----------
    id
        Ten random letters without vowels, so that the id is neither a number for a spreadsheet nor a word.
    cell
        Key of the cell; it is in the key file only, never on the page.
    again
        Whether the output is shown for the second time. The two answers measure a person's self-agreement.
    """

    id: str
    cell: str
    again: bool


@dataclass(frozen=True)
class LabelPage:
    """The content of a page to label: its name, and its items in the order in which they are shown."""

    name: str
    items: Sequence[Item]

    def key_file(self, root: Path) -> Path:
        """Return the path of the page's key file, which lists the cell of each item."""
        return _folder(root) / f"{self.name}.json"


@dataclass(frozen=True)
class Answer:
    """One person's answer to one item.

    Parameters
    ----------
    item
        The item, with the cell's key.
    answer
        One of :data:`ANSWERS`.
    seconds
        Seconds from the display of the picture to the answer.
    order
        Position of the item in the order of the page, from 1.
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
        The stem of the name of the file with the answers.
    answers
        The answers, in the order of the file.
    """

    name: str
    answers: Sequence[Answer]

    def by_cell(self, again: bool = False) -> dict[str, str]:
        """Return the first answers, or with ``again`` the second answers, by the key of the cell."""
        return {each.item.cell: each.answer for each in self.answers if each.item.again == again}


def verdict_as_answer(record: CellRecord) -> str:
    """Return the verdict on a cell as one of :data:`ANSWERS`; "undecided" is ``cannot say``."""
    preserved = record.values.get(PRESERVED)
    return ANSWERS[2] if preserved is None else ANSWERS[0] if preserved else ANSWERS[1]


def labelled_cells(run: Run) -> list[CellRecord]:
    """Return the cells that people label: those with an output, of textures that have a lattice."""
    ended = [record for record in run.cells if record.status == "ok" and (record.folder / "output.png").is_file()]
    return [each for each in ended if each.lattice_truth is not None or each.values.get(PRESERVED) is not None]


def make_page(run: Run, repeat: float = 0.1, seed: int = 0) -> LabelPage:
    """Return a page with its items in random order. The same run, share and seed give the same page.

    Parameters
    ----------
    run
        The run whose finished cells are shown.
    repeat
        Share of the outputs, in [0, 1], that are shown a second time, about ten items later or more.
    seed
        Seed of order, ids and repetitions. The random stream also depends on the cells, so that ids differ between
        runs.

    Raises
    ------
    BadInput
        When the run has nothing to show.
    """
    cells = sorted(record.key for record in labelled_cells(run))
    if not cells:
        raise BadInput(f"{run.root}: has no output of a texture with a lattice; nothing can be labelled")
    entropy = json.dumps([cells, float(repeat), int(seed)])
    rng = stream("labels", entropy)
    order = [cells[i] for i in rng.permutation(len(cells))]
    showings = _showings(len(order), math.ceil(repeat * len(order) - 1e-9), rng)
    ids = _random_ids(len(showings), rng)
    name = hashlib.blake2b(entropy.encode(), digest_size=4).hexdigest()
    return LabelPage(name, [Item(id, order[i], again) for id, (i, again) in zip(ids, showings, strict=True)])


def _showings(count: int, repeats: int, rng: np.random.Generator) -> list[tuple[int, bool]]:
    """Return (index of the output, whether it is shown for the second time) of each item."""
    gap = min(_LEAST_GAP, count // 2)
    early = max(count - gap, repeats)
    again = rng.choice(early, repeats, replace=False)
    times = [(float(i), int(i), False) for i in range(count)]
    times += [(float(rng.uniform(i + gap, max(count, i + gap) + 0.5)), int(i), True) for i in again]
    return [(i, second) for _, i, second in sorted(times)]


def _random_ids(count: int, rng: np.random.Generator) -> list[str]:
    ids: dict[str, None] = {}
    while len(ids) < count:
        ids["".join(rng.choice(list(_LETTERS), 10))] = None
    return list(ids)


def write_key(root: Path, page: LabelPage) -> Path:
    """Write the key file of a page, which lists the cell of each item, and return its path."""
    path = page.key_file(root)
    write_json(path, {"sheet": page.name, "items": [asdict(item) for item in page.items]})
    return path


def _folder(root: Path) -> Path:
    return root / "labels"


def page_html(root: Path, page: LabelPage) -> str:
    """Return a page as one HTML file with all its pictures, without names of cells, methods or textures.

    Parameters
    ----------
    root
        The run directory.
    page
        The items.
    """
    env = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES), autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True
    )
    style, script = (Markup(env.get_template(f"label.{kind}").render()) for kind in ("css", "js"))
    return env.get_template("label.html").render(
        style=style,
        script=script,
        style_hash=content_hash(style),
        script_hash=content_hash(script),
        content=Markup(json.dumps(_content(root, page), separators=(",", ":"))),
        answers=ANSWERS,
    )


def content_hash(text: str) -> str:
    """Return the hash by which a content security policy allows an inline style or script."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _content(root: Path, page: LabelPage) -> dict[str, Any]:
    """Return the data of the page's script. Each picture is stored once; items refer to pictures by number."""
    numbers: dict[str, int] = {}
    items = []
    for item in page.items:
        folder = RunDirectory(root).cell(item.cell)
        files = (without_metadata(path.read_bytes()) for path in (folder.sample, folder.output))
        pictures = [base64.b64encode(file).decode() for file in files]
        items.append([item.id, *(numbers.setdefault(picture, len(numbers)) for picture in pictures)])
    return {"sheet": page.name, "answers": ANSWERS, "items": items, "pictures": list(numbers)}


def without_metadata(png: bytes) -> bytes:
    """Return a PNG without texts, times and names of programs, which could reveal the method."""
    return png[:8] + b"".join(chunk for kind, chunk in _chunks(png) if kind in _PIXEL_CHUNKS)


def _chunks(png: bytes) -> Iterator[tuple[bytes, bytes]]:
    start = 8
    while start + 12 <= len(png):
        (length,) = struct.unpack(">I", png[start : start + 4])
        stop = start + 12 + length
        yield png[start + 4 : start + 8], png[start:stop]
        start = stop


def read_people(run: Run, files: Sequence[Path]) -> list[Person]:
    """Read the answers in files that pages of the run saved, one file for each person.

    Raises
    ------
    BadInput
        For a file that cannot be read, wrong columns, an unknown answer, an item that is answered twice, or an item
        that is on no page of this run. The message names file and line.
    """
    if not files:
        return []
    items = _known_items(run)
    names = _person_names(files)
    return [Person(name, _read_answers(Path(file), items)) for name, file in zip(names, files, strict=True)]


def _person_names(files: Sequence[Path]) -> list[str]:
    """Return the stems of the file names, or the complete paths of files with equal stems."""
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


def _read_answers(path: Path, items: Mapping[str, Item]) -> list[Answer]:
    answers = [_answer(row, items, f"{path}, line {number}") for number, row in enumerate(_rows(path), 2)]
    ids = [each.item.id for each in answers]
    twice = next((id for id in ids if ids.count(id) > 1), None)
    if twice:
        raise BadInput(f"{path}: item {twice!r} is answered twice; keep the answer that counts")
    if not answers:
        raise BadInput(f"{path} has no answers; save them with the button of the page first")
    return answers


def _rows(path: Path) -> list[dict[str, Any]]:
    """Return the rows of a file of answers. Spreadsheets may have added a byte order mark."""
    try:
        text = path.read_text("utf-8-sig")
    except (UnicodeDecodeError, IsADirectoryError, FileNotFoundError) as error:
        problem = {
            UnicodeDecodeError: "is no text in UTF-8",
            IsADirectoryError: "is a directory",
            FileNotFoundError: "there is no such file",
        }[type(error)]
        raise BadInput(f"{path}: {problem}; pass the CSV that the page saved") from error
    table = csv.DictReader(text.splitlines())
    columns = table.fieldnames or []
    if sorted(columns) != sorted(COLUMNS):
        raise BadInput(f"{path}: expected columns {', '.join(COLUMNS)}, got {', '.join(columns) or 'none'}")
    return [row for row in table if any(row.values())]


def _answer(row: Mapping[str, Any], items: Mapping[str, Item], where: str) -> Answer:
    id, answer = row["item"], row["answer"]
    if id not in items:
        raise BadInput(f"{where}: item {id!r} is on no page of this run; pass answers to a page made for it")
    if answer not in ANSWERS:
        raise BadInput(f"{where}: answer {answer!r} is not known; use one of: {', '.join(ANSWERS)}")
    try:
        seconds, order = float(row["seconds"]), int(row["order"])
    except (TypeError, ValueError) as error:
        raise BadInput(f"{where}: seconds and order must be numbers; leave them as the page saved them") from error
    if None in row or not (math.isfinite(seconds) and seconds >= 0 and order >= 1):
        raise BadInput(f"{where}: is no answer as the page saves it (item, answer, seconds >= 0, order >= 1)")
    return Answer(items[id], answer, seconds, order)
