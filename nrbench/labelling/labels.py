"""Pages on which people label the outputs of a run without the methods' names, and the answers that they save."""

from __future__ import annotations

import base64
import hashlib
import io
import json
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import jinja2
import numpy as np
import pandas as pd
import PIL.Image
from markupsafe import Markup
from pydantic import Field, TypeAdapter, ValidationError

from nrbench.errors import BadInput
from nrbench.pictures.files import read_image, to_rgb
from nrbench.plugins.forms import describe_silence
from nrbench.runs.records import CellRecord, Run
from nrbench.runs.store import RunDirectory
from nrbench.storage import decimal_point, make_writable, read_json, read_table, write_json, write_text
from nrbench.streams import pixels_hash, stream

ANSWERS = ("yes", "no", "cannot say")
"""The possible answers to every question, in the order of the keys 1, 2, 3."""
PRESERVED = "regularity.preserved"
WHOLE_SCORE = 0.95
"""``integrity.score`` below which elements are called broken: more than one in twenty is, beyond chance."""

COLUMNS = ("item", "question", "answer", "seconds", "order", "labeled_by")
"""The columns of a file of answers. It has one row for each item and question; ``labeled_by`` is the same in all."""
_LETTERS = "bcdfghjkmnpqrstvwxz"
_LEAST_GAP = 10
_TEMPLATES = Path(__file__).parent / "templates"


@dataclass(frozen=True)
class Question:
    """A question about an output.

    Parameters
    ----------
    name
        Its name in files and tables.
    text
        The question.
    meanings
        What yes and no mean.
    column
        The score that measures the same.
    rule
        The answer that the scores of a cell give: True for yes, False for no, None if it cannot be said. A question
        without a rule is about a matter of degree. No value of its score separates yes from no.
    """

    name: str
    text: str
    meanings: tuple[str, str]
    column: str
    rule: Callable[[CellRecord], bool | None] | None = None

    @property
    def metric(self) -> str:
        """The metric of the score."""
        return self.column.partition(".")[0]

    def automatic_answer(self, record: CellRecord) -> str | None:
        """Return the answer that the scores of a cell give, one of :data:`ANSWERS`; None without a rule."""
        if self.rule is None:
            return None
        answer = self.rule(record)
        return ANSWERS[2] if answer is None else ANSWERS[0] if answer else ANSWERS[1]


def _is_preserved(record: CellRecord) -> bool | None:
    preserved = record.values.get(PRESERVED)
    return None if preserved is None else bool(preserved)


def _has_whole_elements(record: CellRecord) -> bool | None:
    """Return whether nearly all elements are whole, or joined ones would look whole in this texture."""
    score = record.values.get("integrity.score")
    if score is not None:
        return score >= WHOLE_SCORE
    silence = describe_silence(record.reasons.get("integrity.score", ""))
    return True if record.values.get(PRESERVED) and silence == "no peril" else None


LATTICE = Question(
    "lattice",
    "Is the lattice kept?",
    (
        "all elements of the output are in the pattern of the sample: none is missing, doubled, cut short or out of "
        "line. Judge their places, not their colors.",
        "the pattern is broken at some place; one element is enough.",
    ),
    PRESERVED,
    _is_preserved,
)
ELEMENTS = Question(
    "elements",
    "Are the elements whole?",
    (
        "each element looks like one piece, as in the sample. If all elements are so much alike that a joint could not "
        "be seen, they look whole.",
        "an element is cut, or joined of parts that do not belong together, such as a brick of two colors; one element "
        "is enough.",
    ),
    "integrity.score",
    _has_whole_elements,
)
MORE = Question(
    "more",
    "Does it look like more of the same?",
    (
        "the output could be another part of the same wall, cloth or floor.",
        "it could not: it is broken, repeats itself like wallpaper, is blurred, or looks different.",
    ),
    "quality.score",
)
QUESTIONS: Mapping[str, Question] = {question.name: question for question in (LATTICE, ELEMENTS, MORE)}
"""All questions by name, in the order in which a page asks them."""


def find_questions(names: Sequence[str]) -> list[Question]:
    """Return the questions with the given names.

    Raises
    ------
    BadInput
        When a name is unknown or given twice, or there is none.
    """
    known = ", ".join(QUESTIONS)
    unknown = next((name for name in names if name not in QUESTIONS), None)
    if unknown is not None or not names:
        raise BadInput(f"question {unknown or ''!r} is not known; use some of: {known}")
    if len(set(names)) < len(names):
        raise BadInput(f"questions {', '.join(names)}: one is given twice; name each question once")
    return [QUESTIONS[name] for name in names]


@dataclass(frozen=True)
class Item:
    """An output on a page. The same output may be two items.

    Parameters
    ----------
    id
        Ten random letters without vowels, so that the id is neither a number for a spreadsheet nor a word.
    cell
        Key of the cell; it is in the key file only, never on the page.
    repeated
        Whether the output is shown for the second time, ``again`` in the key file. The two answers measure a labeler's
        self-agreement.
    """

    id: str
    cell: str
    repeated: Annotated[bool, Field(alias="again")]


ITEMS = TypeAdapter(list[Item])
"""Reads and writes the items of a key file."""


@dataclass(frozen=True)
class LabelPage:
    """The content of a page to label.

    Parameters
    ----------
    name
        Its name.
    items
        Its items, in the order in which they are shown.
    questions
        The names of the questions about each item, in the order of the page.
    """

    name: str
    items: Sequence[Item]
    questions: Sequence[str]

    def key_file(self, root: Path) -> Path:
        """Return the path of the page's key file, which lists the cell of each item."""
        return _folder(root) / f"{self.name}.json"


def labelled_cells(run: Run) -> list[CellRecord]:
    """Return the cells that people label: those with an output, of textures that have a lattice.

    A photograph has a lattice if one is known, or if the verdict used one that was detected, even if it is undecided.
    """
    ended = [record for record in run.cells if record.status == "ok" and (record.folder / "output.png").is_file()]
    return [each for each in ended if each.lattice_truth is not None or _is_judged(each)]


def _is_judged(record: CellRecord) -> bool:
    return record.values.get(PRESERVED) is not None or record.reasons.get(PRESERVED, "").startswith("undecided")


def make_page(run: Run, repeat: float = 0.1, seed: int = 0, questions: Sequence[str] = tuple(QUESTIONS)) -> LabelPage:
    """Return a page with its items in random order. The same arguments give the same page.

    Parameters
    ----------
    run
        The run whose finished cells are shown.
    repeat
        Share of the outputs, in [0, 1], that are shown a second time, about ten items later or more.
    seed
        Seed of order, ids and repetitions. The random stream also depends on the cells, so that ids differ between
        runs.
    questions
        The names of the questions to ask, in their order.

    Raises
    ------
    BadInput
        When the run has nothing to show, or a question is unknown.
    """
    asked = [question.name for question in find_questions(questions)]
    cells = sorted({record.key for record in labelled_cells(run)})
    if not cells:
        raise BadInput(f"{run.root}: has no output of a texture with a lattice; nothing can be labelled")
    entropy = json.dumps([cells, float(repeat), int(seed), asked])
    rng = stream("labels", entropy)
    order = [cells[i] for i in rng.permutation(len(cells))]
    showings = _showings(len(order), math.ceil(repeat * len(order) - 1e-9), rng)
    ids = _random_ids(len(showings), rng)
    name = hashlib.blake2b(entropy.encode(), digest_size=4).hexdigest()
    items = [Item(id, order[i], repeated) for id, (i, repeated) in zip(ids, showings, strict=True)]
    return LabelPage(name, items, asked)


def _showings(count: int, repeats: int, rng: np.random.Generator) -> list[tuple[int, bool]]:
    """Return (index of the output, whether it is shown for the second time) of each item."""
    gap = min(_LEAST_GAP, count // 2)
    early = max(count - gap, repeats)
    repeated = rng.choice(early, repeats, replace=False)
    times = [(float(i), int(i), False) for i in range(count)]
    times += [(float(rng.uniform(i + gap, max(count, i + gap) + 0.5)), int(i), True) for i in repeated]
    return [(i, second) for _, i, second in sorted(times)]


def _random_ids(count: int, rng: np.random.Generator) -> list[str]:
    ids: dict[str, None] = {}
    while len(ids) < count:
        ids["".join(rng.choice(list(_LETTERS), 10))] = None
    return list(ids)


def write_page(
    root: Path, output: Path | None, repeat: float, seed: int, questions: Sequence[str]
) -> tuple[Path, Path, LabelPage]:
    """Write a page and its key; return their paths and the page.

    Parameters
    ----------
    root
        The run directory.
    output
        The file of the page; if None, it lies beside its key.
    repeat, seed, questions
        As for :func:`make_page`.

    Raises
    ------
    BadInput
        As for :func:`make_page`, and if the file cannot be written.
    """
    if output is not None and output.suffix.lower() not in (".html", ".htm"):
        raise BadInput(f"{output}: the page is HTML; end the name in .html")
    if output is not None and not output.absolute().parent.is_dir():
        raise BadInput(f"{output}: its directory does not exist; make it first")
    if not 0 <= repeat <= 1:
        raise BadInput(f"repeat {repeat}: give a share from 0 to 1")
    page = make_page(Run(root), repeat, seed, questions)
    path = output or page.key_file(root).with_suffix(".html")
    text = page_html(root, page)
    key = write_key(root, page)
    write_text(path, text)
    return path, key, page


def write_key(root: Path, page: LabelPage) -> Path:
    """Write the key file of a page, which lists the cell of each item, and return its path."""
    path = page.key_file(root)
    make_writable(path.parent, "the key of a page lies in its run: label a copy of the run")
    write_json(path, {"sheet": page.name, "items": ITEMS.dump_python(list(page.items), by_alias=True)})
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
        questions=find_questions(page.questions),
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
        files = (encode_pixels(path) for path in (folder.sample, folder.output))
        pictures = [base64.b64encode(file).decode() for file in files]
        items.append([item.id, *(numbers.setdefault(picture, len(numbers)) for picture in pictures)])
    names = {"sheet": page.name, "questions": list(page.questions), "answers": ANSWERS}
    return {**names, "items": items, "pictures": list(numbers)}


def encode_pixels(path: Path) -> bytes:
    """Return a picture as PNG without texts, times and names of programs, which could reveal the method."""
    file = io.BytesIO()
    with path.open("rb") as content, PIL.Image.open(content) as image:
        PIL.Image.fromarray(to_rgb(image)).save(file, "PNG")
    return file.getvalue()


def read_labels(run: Run, files: Sequence[Path]) -> pd.DataFrame:
    """Read the answers in files that pages of the run saved, one file for each labeler.

    Returns
    -------
    pandas.DataFrame
        One row an answer: ``labeler`` (the stem of the file), ``labeled_by`` (``person``, as the page writes, or for
        example ``vision-language model``), the output, ``again`` (whether it was shown for the second time),
        ``question``, ``answer``, ``judge`` (the automatic answer; empty for a question that has none), ``score`` (the
        value of the column of the question), ``seconds`` to the answer (from the display of the pictures for the first
        question about an item, from the answer before it for the others), ``order`` of the item on the page, from 1,
        and ``key`` of the cell. Empty without files.

    Raises
    ------
    BadInput
        For a file that cannot be read, wrong columns, an unknown question or answer, a question that is answered twice
        for one item, or an item that is on no page of this run. The message names file and line.
    """
    if not files:
        return pd.DataFrame()
    items, records, rows = _known_items(run), {record.key: record for record in run.cells}, []
    for labeler, file in zip(_labeler_names(files), files, strict=True):
        for answer in _read_answers(Path(file), items):
            item, question = items[answer["item"]], QUESTIONS[answer["question"]]
            record = records[item.cell]
            rows.append({
                **{"labeler": labeler, "labeled_by": answer["labeled_by"]},
                **{"suite": record.suite, "texture": record.texture, "method": record.method},
                **{"lattice_source": record.lattice_source, "replicate": record.replicate},
                **{"again": item.repeated, "question": question.name, "answer": answer["answer"]},
                **{"judge": question.automatic_answer(record), "score": record.values.get(question.column)},
                **{"seconds": float(answer["seconds"]), "order": int(answer["order"]), "key": record.key},
            })  # fmt: skip
    return pd.DataFrame(rows).astype({"score": float})


def labels_table(run: Run, files: Sequence[Path]) -> pd.DataFrame:
    """Return the answers of :func:`read_labels` with the hash of the output's pixels.

    The column ``pixels`` identifies an output that is made again. It is empty where the file has been removed.
    """
    table, pixels = read_labels(run, files), cache(_hash_output)
    folders = {record.key: record.folder for record in run.cells}
    return table.assign(pixels=table["key"].map(folders).map(pixels)) if len(table) else table


def _labeler_names(files: Sequence[Path]) -> list[str]:
    """Return the stems of the file names, or the complete paths of files with equal stems."""
    stems = [Path(file).stem for file in files]
    doubled = next((str(file) for i, file in enumerate(files) if file in files[:i]), None)
    if doubled:
        raise BadInput(f"{doubled}: is given twice; pass each labeler's answers once")
    return [str(file) if stems.count(stem) > 1 else stem for stem, file in zip(stems, files, strict=True)]


def _known_items(run: Run) -> dict[str, Item]:
    cells = {record.key for record in run.cells}
    pages = [read_json(path) for path in sorted(_folder(run.root).glob("*.json"))]
    items = [item for page in pages if page for item in _items_of(page)]
    if not items:
        raise BadInput(f"{run.root}: no page was made to label this run; make one by `nrbench label {run.root}`")
    return {item.id: item for item in items if item.cell in cells}


def _items_of(page: Mapping[str, Any]) -> list[Item]:
    """Return the items of a page's file; none if the file is damaged."""
    try:
        return ITEMS.validate_python(page.get("items", []))
    except ValidationError:
        return []


def _read_answers(path: Path, items: Mapping[str, Item]) -> list[dict[str, str]]:
    """Return the rows of a file of answers, all of which are valid answers of one labeler."""
    rows = _read_rows(path)
    for number, row in enumerate(rows, 2):
        _check_answer(row, items, f"{path}, line {number}")
    counts = Counter((row["item"], row["question"]) for row in rows)
    twice = next((asked for asked, count in counts.items() if count > 1), None)
    if twice:
        raise BadInput(f"{path}: item {twice[0]!r}, {twice[1]}, is answered twice; keep the answer that counts")
    if not rows:
        raise BadInput(f"{path} has no answers; save them with the button of the page first")
    kinds = {row["labeled_by"] for row in rows}
    if len(kinds) > 1 or not all(kinds):
        raise BadInput(
            f"{path}: labeled_by must be one word for all answers, such as person; keep each labeler's answers apart"
        )
    return rows


def _read_rows(path: Path) -> list[dict[str, Any]]:
    """Return the rows of a file of answers."""
    found, lines = read_table(path, ",".join(COLUMNS))
    if sorted(COLUMNS) != sorted(found):
        raise BadInput(f"{path}: expected columns {', '.join(COLUMNS)}, got {', '.join(found) or 'none'}")
    return [{**row, "seconds": decimal_point(row["seconds"])} for _, row in lines]


def _check_answer(row: Mapping[str, Any], items: Mapping[str, Item], where: str) -> None:
    id, question, answer = row["item"], row["question"], row["answer"]
    if id not in items:
        raise BadInput(f"{where}: item {id!r} is on no page of this run; pass answers to a page made for it")
    for kind, word, known in (("question", question, QUESTIONS), ("answer", answer, ANSWERS)):
        if word not in known:
            raise BadInput(f"{where}: {kind} {word!r} is not known; use one of: {', '.join(known)}")
    try:
        seconds, order = float(row["seconds"]), int(row["order"])
    except (TypeError, ValueError) as error:
        raise BadInput(f"{where}: seconds and order must be numbers; leave them as the page saved them") from error
    if None in row or not (math.isfinite(seconds) and seconds >= 0 and order >= 1):
        raise BadInput(
            f"{where}: is no answer as the page saves it ({', '.join(COLUMNS[:3])}, seconds >= 0, order >= 1)"
        )


def _hash_output(folder: Path) -> str | None:
    """Return the hash of an output's pixels; None if the file has been removed."""
    path = folder / "output.png"
    return pixels_hash(read_image(path, smallest=1)) if path.is_file() else None
