"""Collect the pictures of a run for the page: each texture's sample, its lattices, and every output with its scores."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from nrbench.labelling.labels import Question
from nrbench.lattice.geometry import Lattice, Points, Vector
from nrbench.runs.records import CellRecord, Run

from ..statistics.format import describe_column, format_number
from ..statistics.method_comparison import Comparison
from ..statistics.summaries import COSTS, Method, method_of, sort_headlines_first
from ..statistics.verdicts import QUALITY, name_silence, verdict
from .pictures import DEFECTS, PagePicture, PictureStore

MAX_LINES = 400
"""More lines would hide the picture."""
SAME_LATTICE = 0.05
"""Lattices whose reduced vectors agree within this many px share one drawing."""
SOURCE_MAP = "source map"
"""Name of the layer that shows where in the sample each pixel comes from."""
_WEAKEST = 4
"""Number of weak outputs that are shown of a method."""
_FULL = 0.995
"""From this quality on, which is printed as 1.00, no peril limits an output."""


@dataclass(frozen=True)
class LatticeOverlay:
    """SVG paths in the pixel coordinates of the sample.

    Parameters
    ----------
    lines
        The lines of the lattice; empty if there are more than :data:`MAX_LINES`.
    arrows
        The two vectors of the lattice, as arrows from a lattice point near the middle.
    vectors
        The coordinates of the vectors in px, as text.
    """

    lines: str
    arrows: tuple[str, str]
    vectors: tuple[str, str]


@dataclass(frozen=True)
class ScoreLine:
    """One score of a cell as text, with the description of its column and the reason if there is no value."""

    name: str
    text: str
    meaning: str
    reason: str


def score_lines(run: Run, record: CellRecord, names: Iterable[str]) -> list[ScoreLine]:
    """Return those of the scores that a cell of a run has, and its seconds if they are among ``names``."""
    lines = []
    for name in names:
        if name == "seconds" and record.seconds is not None:
            lines.append(ScoreLine("time", f"{format_number(record.seconds)} s", describe_column(COSTS[name]), ""))
        elif name in record.values:
            value, column = record.values[name], run.columns[name]
            unit = f" {column.unit}" if column.unit and value is not None else ""
            meaning, reason = describe_column(column), record.reasons.get(name, "")
            text = name_silence(record, name) or format_number(value) + unit
            lines.append(ScoreLine(name, text, meaning, reason))
    return lines


@dataclass(frozen=True)
class OutputFigure:
    """The pictures of one output.

    Parameters
    ----------
    record
        The cell.
    output
        The output; None if there is none.
    layers
        The pictures that can be laid over it: marks of metrics, or the source map. Each has the number of the toggle
        that shows it, and its name.
    insets
        The metrics' pictures of another size than the output, by name.
    lattice
        The lattice of the output, as lines over it; None if it is not known.
    """

    record: CellRecord
    output: PagePicture | None
    layers: Sequence[tuple[int, str, PagePicture]]
    insets: Sequence[tuple[str, PagePicture]]
    lattice: LatticeOverlay | None


@dataclass(frozen=True)
class TextureDraw:
    """One replicate of a texture: its sample, the lattices and the outputs.

    Parameters
    ----------
    replicate
        Its number.
    sample
        The sample; None if it could not be rendered.
    scale
        Page pixels for each pixel of the outputs.
    truth, agreeing
        The true lattice, and the methods that found it by themselves.
    used
        Every other lattice that a method used, with the names of these methods.
    figures
        The outputs.
    """

    replicate: int
    sample: PagePicture | None
    scale: float
    truth: LatticeOverlay | None
    agreeing: Sequence[str]
    used: Sequence[tuple[Sequence[str], LatticeOverlay]]
    figures: Sequence[OutputFigure]


@dataclass(frozen=True)
class MethodFailings:
    """Where a method fails.

    Parameters
    ----------
    method
        The method.
    textures
        Number of textures on which it ran.
    lost, unfinished
        The cells of textures on which it lost the lattice, and on which it gave no output: the first of each texture.
    weakest
        Its weakest outputs with their worst places, from the weakest; one for a texture.
    """

    method: Method
    textures: int
    lost: Sequence[CellRecord]
    unfinished: Sequence[CellRecord]
    weakest: Sequence[tuple[CellRecord, PagePicture | None]]


def score_shade(score: float | None) -> int | None:
    """Return the shade of a score, from 0 (worst) to 10."""
    return None if score is None else round(10 * min(1.0, max(0.0, score)))


def list_layers(textures: Sequence[Sequence[TextureDraw]]) -> list[tuple[int, str]]:
    """Return number and name of the pictures that lie over outputs of a gallery, in the order of their toggles."""
    figures = [figure for draws in textures for draw in draws for figure in draw.figures]
    return sorted({(index, title) for figure in figures for index, title, _ in figure.layers})


def begin_figures(run: Run, pictures: PictureStore) -> list[Future[OutputFigure]]:
    """Begin to make the figures of all outputs in threads: pictures are coded outside of Python's lock."""
    names = dict.fromkeys(title for record in run.cells for title in record.pictures)
    titles = [*sort_headlines_first(names), SOURCE_MAP]
    pool = ThreadPoolExecutor(2)
    figures = [pool.submit(_output_figure, record, titles, pictures) for record in run.cells]
    pool.shutdown(wait=False)
    return figures


def build_gallery(
    comparison: Comparison, figures: Iterable[Future[OutputFigure]], pictures: PictureStore
) -> list[list[TextureDraw]]:
    """Return the replicates of every texture of the comparison, from the figures of :func:`begin_figures`."""
    by_cell = {id(figure.record): figure for figure in (each.result() for each in figures)}
    textures = []
    for row in comparison.rows:
        replicates: dict[int, list[OutputFigure]] = {}
        for entry in row.entries:
            for record in entry.records if entry else ():
                replicates.setdefault(record.replicate, []).append(by_cell[id(record)])
        textures.append([_texture_draw(replicates[number], pictures) for number in sorted(replicates)])
    return textures


def list_failings(comparison: Comparison, pictures: PictureStore) -> list[MethodFailings]:
    """Return where each ranked method fails, in the order of the ranking: references fail by their nature."""
    found = []
    for place, method in enumerate(comparison.methods):
        if not method.reference and comparison.summaries[place].rank:
            cells = [entry.records for row in comparison.rows if (entry := row.entries[place])]
            found.append(_failings(method, cells, pictures))
    return found


def _failings(method: Method, cells: Sequence[Sequence[CellRecord]], pictures: PictureStore) -> MethodFailings:
    """Return where a method fails, of its cells on each texture."""

    def first(wanted: Callable[[CellRecord], bool]) -> list[CellRecord]:
        return [next(filter(wanted, records)) for records in cells if any(map(wanted, records))]

    def quality(record: CellRecord) -> float:
        value = record.values.get(QUALITY)
        return 1.0 if value is None else float(value)

    worst = sorted((min(records, key=quality) for records in cells), key=quality)
    return MethodFailings(
        method,
        sum(any(one.status != "missing" for one in records) for records in cells),
        lost=first(lambda one: verdict(one) == "lost"),
        unfinished=first(lambda one: one.status not in ("ok", "missing")),
        weakest=[(record, _worst_crop(record, pictures)) for record in worst[:_WEAKEST] if quality(record) < _FULL],
    )


def _worst_crop(record: CellRecord, pictures: PictureStore) -> PagePicture | None:
    layers = [record.pictures[name] for name in DEFECTS if name in record.pictures]
    return pictures.worst_crop(record.folder / "output.png", *layers)


def load_disagreement(
    record: CellRecord, question: Question, pictures: PictureStore
) -> tuple[PagePicture | None, PagePicture | None, PagePicture | None]:
    """Return the sample, the output and the map of its defects that belong to a question; None where there is none."""
    output = pictures.load(record.folder / "output.png")
    drawn = (record.pictures.get(name) for name in DEFECTS if name.startswith(f"{question.metric}."))
    defects = next(filter(None, drawn), None)
    return pictures.load(record.folder / "sample.png"), output, pictures.load(defects) if output else None


def _texture_draw(figures: Sequence[OutputFigure], pictures: PictureStore) -> TextureDraw:
    records = [figure.record for figure in figures]
    sample = next(filter(None, (pictures.load(record.folder / "sample.png") for record in records)), None)
    known = next((record.lattice_truth for record in records if record.lattice_truth), None)
    truth = Lattice.from_dict(known).reduced() if known else None
    shape = (sample.height, sample.width) if sample else (1, 1)
    return TextureDraw(
        replicate=records[0].replicate,
        sample=sample,
        scale=next((figure.output.scale for figure in figures if figure.output), 1.0),
        truth=trace_lattice(truth, shape) if truth and sample else None,
        agreeing=[
            method_of(record).label
            for record in records
            if record.lattice_source not in ("given", "none") and _uses(record, truth)
        ],
        used=_used_lattices(records, truth, shape) if sample else [],
        figures=figures,
    )


def _output_figure(record: CellRecord, titles: Sequence[str], pictures: PictureStore) -> OutputFigure:
    path = record.folder / "output.png"
    output = pictures.load(path) if record.status == "ok" else None
    layers: list[tuple[int, str, PagePicture]] = []
    insets: list[tuple[str, PagePicture]] = []
    for index, title in enumerate(titles if output else (), 1):
        layer = record.pictures.get(title)
        source = title == SOURCE_MAP
        laid = pictures.source_map(record.folder / "source.npz") if source else pictures.overlay(path, layer)
        if laid:
            layers.append((index, title, laid))
        elif inset := pictures.load(layer):
            insets.append((title, inset))
    lattice = _output_lattice(record, (output.height, output.width)) if output else None
    return OutputFigure(record, output, layers, insets, lattice)


def _output_lattice(record: CellRecord, shape: tuple[int, int]) -> LatticeOverlay | None:
    """Return the output's own lattice, as the judge found it; None if it found none."""
    try:
        return trace_lattice(Lattice.from_dict(record.records["regularity"]["lattice"]).reduced(), shape)
    except (KeyError, TypeError, ValueError, AttributeError):
        return None


def limiting_peril(record: CellRecord) -> str:
    """Return the peril with the smallest score; empty without a quality, and for a quality of 1."""
    quality = record.values.get(QUALITY)
    return "" if quality is None or quality >= _FULL else str(record.records.get("quality", {}).get("worst", ""))


def anchor(record: CellRecord) -> str:
    """Return the name of an output on the page. Methods of two names may share a cell, so its key is not enough."""
    return f"c-{record.key}-{zlib.crc32(method_of(record).label.encode()):08x}"


def _uses(record: CellRecord, truth: Lattice | None) -> bool:
    """Return whether a cell used the true lattice."""
    if record.lattice_used is None or truth is None:
        return False
    return Lattice.from_dict(record.lattice_used).is_equivalent(truth, SAME_LATTICE)


def _used_lattices(
    records: Sequence[CellRecord], truth: Lattice | None, shape: tuple[int, int]
) -> list[tuple[list[str], LatticeOverlay]]:
    """Return the methods that used each lattice that differs from the true one, and the lattice."""
    groups: list[tuple[Lattice, list[str]]] = []
    for record in records:
        if record.lattice_used is None or _uses(record, truth):
            continue
        used = Lattice.from_dict(record.lattice_used)
        same = [labels for lattice, labels in groups if lattice.is_equivalent(used, SAME_LATTICE)]
        if not same:
            groups.append((used, []))
        (same or [groups[-1][1]])[0].append(method_of(record).label)
    return [(labels, trace_lattice(align_basis(used, truth, shape), shape)) for used, labels in groups]


def trace_lattice(lattice: Lattice, shape: tuple[int, int]) -> LatticeOverlay:
    """Return the lines of a lattice along its two vectors, over an image of ``shape`` (height, width)."""
    start = _nearest_point(lattice, _middle(shape) - lattice.matrix.sum(0) / 2)
    first, second = (_trace_line([*start, *(start + vector)]) for vector in lattice.matrix)
    vectors = (_describe_vector("t1", lattice.t1), _describe_vector("t2", lattice.t2))
    return LatticeOverlay(_lattice_lines(lattice, shape), (first, second), vectors)


def align_basis(lattice: Lattice, truth: Lattice | None, shape: tuple[int, int]) -> Lattice:
    """Return a detected lattice in the basis of the true one, through the true point nearest the middle of the image.

    Neither the origin nor the choice of basis of a detected lattice is an error. So drawn, the two lattices show how
    the detected lines drift from the true ones. A lattice that is not equivalent to the true one keeps its own reduced
    basis. Without a true lattice the origin stays.
    """
    if truth is None:
        return lattice.reduced()
    x, y = _nearest_point(truth, _middle(shape))
    change = np.rint(truth.matrix @ np.linalg.inv(lattice.matrix))
    basis = change @ lattice.matrix if abs(abs(np.linalg.det(change)) - 1) < 0.5 else lattice.reduced().matrix
    (ax, ay), (bx, by) = basis.tolist()
    return Lattice((ax, ay), (bx, by), (float(x), float(y)))


def _describe_vector(name: str, vector: Vector) -> str:
    return f"{name} = ({vector[0]:.2f}, {vector[1]:.2f})".replace("-", "−")


def _lattice_lines(lattice: Lattice, shape: tuple[int, int]) -> str:
    height, width = shape
    corners = [(x, y) for x in (-0.5, width - 0.5) for y in (-0.5, height - 0.5)]
    cells = lattice.to_cell(corners)
    (u0, v0), (u1, v1) = cells.min(0), cells.max(0)
    along_u, along_v = np.arange(np.ceil(u0), np.floor(u1) + 1), np.arange(np.ceil(v0), np.floor(v1) + 1)
    if len(along_u) + len(along_v) > MAX_LINES:
        return ""
    ends = [((u, v0), (u, v1)) for u in along_u] + [((u0, v), (u1, v)) for v in along_v]
    return "".join(map(_trace_line, lattice.from_cell(np.reshape(ends, (-1, 2, 2))).reshape(-1, 4).tolist()))


def _trace_line(ends: Sequence[float]) -> str:
    return "M{:.2f} {:.2f}L{:.2f} {:.2f}".format(*ends)


def _middle(shape: tuple[int, int]) -> Points:
    return np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2])


def _nearest_point(lattice: Lattice, xy: Points) -> Points:
    return np.asarray(xy - lattice.wrap(xy - np.array(lattice.origin)))
