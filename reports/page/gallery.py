"""Collect the pictures of a run for the page: each texture's sample, its lattices, and every output with its scores."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from nrbench.labelling.questions import Question
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Column
from nrbench.runs.records import CellRecord, Run

from ..plots.marks import DEFECTS
from ..statistics.format import describe_column, format_number
from ..statistics.method_comparison import Comparison, ComparisonRow
from ..statistics.summaries import COSTS, Method, headline_columns, sort_headlines_first
from ..statistics.verdicts import QUALITY, SCORE, explain_verdict, verdict
from .lattice_overlay import LatticeOverlay, align_basis, trace_lattice
from .pictures import PagePicture, PictureStore

SAME_LATTICE = 0.05
"""Lattices whose reduced vectors agree within this many px share one drawing."""
SOURCE_MAP = "source map"
"""Name of the layer that shows where in the sample each pixel comes from."""
_MAX_LOST_SHADE = 3
_WEAKEST = 4
"""Number of weak outputs that are shown of a method."""
_FULL = 0.995
"""From this quality on, which is printed as 1.00, no peril limits an output."""


@dataclass(frozen=True)
class PictureLayer:
    """A picture that the page can lay over an output: the marks of a metric, or the source map.

    Parameters
    ----------
    index
        Number of the toggle that shows it.
    title
        Its name.
    picture
        The picture.
    """

    index: int
    title: str
    picture: PagePicture


@dataclass(frozen=True)
class ScoreLine:
    """One score of a cell as text, with the description of its column and the reason if there is no value."""

    name: str
    text: str
    meaning: str
    reason: str


@dataclass(frozen=True)
class _ScoreTexts:
    """The scores of a run as text; what does not depend on the cell is computed once."""

    columns: Mapping[str, Column]
    meanings: Mapping[str, str]
    headline: Sequence[str]
    every: Sequence[str]

    @classmethod
    def of(cls, run: Run) -> _ScoreTexts:
        headline = [name for name in headline_columns(run) if name != SCORE]
        described = {name: describe_column(column) for name, column in {**run.columns, **COSTS}.items()}
        return cls(run.columns, described, headline, sort_headlines_first(run.columns))

    def select(self, record: CellRecord, names: Iterable[str]) -> list[ScoreLine]:
        """Return those of the scores that the cell has, and its seconds if they are among ``names``."""
        lines = []
        for name in names:
            if name == "seconds" and record.seconds is not None:
                lines.append(ScoreLine("time", f"{format_number(record.seconds)} s", self.meanings[name], ""))
            elif name in record.values:
                value = record.values[name]
                unit = f" {self.columns[name].unit}" if self.columns[name].unit and value is not None else ""
                reason = record.reasons.get(name, "")
                lines.append(ScoreLine(name, format_number(value) + unit, self.meanings[name], reason))
        return lines


@dataclass(frozen=True)
class OutputFigure:
    """One output with its verdict and scores.

    Parameters
    ----------
    record, method
        The cell, and its method.
    score, shade
        The number beside the mark, and its shade; None if there is none.
    limit
        The peril that limits the quality; empty if there is no quality, or no peril.
    output
        The output; None if there is none.
    layers
        The pictures that can be laid over it.
    insets
        The metrics' pictures of another size than the output, by name.
    lattice
        The lattice of the output, as lines over it; None if it is not known.
    headline, scores
        The headline scores, and all scores.
    """

    record: CellRecord
    method: Method
    score: float | None
    shade: int | None
    limit: str
    output: PagePicture | None
    layers: Sequence[PictureLayer]
    insets: Sequence[tuple[str, PagePicture]]
    lattice: LatticeOverlay | None
    headline: Sequence[ScoreLine]
    scores: Sequence[ScoreLine]


@dataclass(frozen=True)
class DisagreementFigure:
    """An output on which people and the automatic answer to a question differ.

    Parameters
    ----------
    method
        The method of the cell.
    sample, output, layer
        The sample, the output and the map of its defects; None if there is none.
    scale
        Page pixels for each pixel, the same for all three.
    explanation
        Why the score has no value; empty if it has one.
    scores
        The scores of the metric that answers the question.
    """

    method: Method
    sample: PagePicture | None
    output: PagePicture | None
    layer: PagePicture | None
    scale: float
    explanation: str
    scores: Sequence[ScoreLine]


@dataclass(frozen=True)
class UsedLattice:
    """A lattice that differs from the true one, with the methods that used it."""

    labels: Sequence[str]
    overlay: LatticeOverlay


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
        Every other lattice that a method used.
    figures
        The outputs.
    """

    replicate: int
    sample: PagePicture | None
    scale: float
    truth: LatticeOverlay | None
    agreeing: Sequence[str]
    used: Sequence[UsedLattice]
    figures: Sequence[OutputFigure]


@dataclass(frozen=True)
class TextureSection:
    """A texture of the gallery: its row of the comparison, and its replicates."""

    row: ComparisonRow
    draws: Sequence[TextureDraw]


@dataclass(frozen=True)
class WeakOutput:
    """An output among the weakest of a method: its cell, its quality, the peril that limits it, its worst place."""

    record: CellRecord
    quality: float
    limit: str
    crop: PagePicture | None


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
        Its weakest outputs, from the weakest; one for a texture.
    """

    method: Method
    textures: int
    lost: Sequence[CellRecord]
    unfinished: Sequence[CellRecord]
    weakest: Sequence[WeakOutput]


def score_shade(score: float | None) -> int | None:
    """Return the shade of a score, from 0 (worst) to 10."""
    return None if score is None else round(10 * min(1.0, max(0.0, score)))


def list_layers(sections: Sequence[TextureSection]) -> list[tuple[int, str]]:
    """Return number and name of the pictures that lie over outputs of a gallery, in the order of their toggles."""
    figures = [one for section in sections for draw in section.draws for one in draw.figures]
    return sorted({(layer.index, layer.title) for one in figures for layer in one.layers})


def build_gallery(run: Run, comparison: Comparison, pictures: PictureStore) -> list[TextureSection]:
    """Return a section for every texture of the comparison."""
    names = dict.fromkeys(title for record in run.cells for title in record.pictures)
    titles = [*sort_headlines_first(names), SOURCE_MAP]
    with ThreadPoolExecutor(2) as pool:  # images are decoded and encoded outside of Python's lock
        list(pool.map(lambda record: _lay_over(record, titles, pictures), run.cells))
    lines, sections = _ScoreTexts.of(run), []
    for row in comparison.rows:
        replicates: dict[int, list[CellRecord]] = {}
        for entry in row.entries:
            for record in entry.records if entry else ():
                replicates.setdefault(record.replicate, []).append(record)
        draws = [_texture_draw(lines, comparison.score, titles, pictures, replicates[n]) for n in sorted(replicates)]
        sections.append(TextureSection(row, draws))
    return sections


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

    rated = [
        min(known, key=lambda pair: pair[0])
        for records in cells
        if (known := [(float(value), one) for one in records if (value := one.values.get(QUALITY)) is not None])
    ]
    weak = sorted((pair for pair in rated if pair[0] < _FULL), key=lambda pair: pair[0])[:_WEAKEST]
    return MethodFailings(
        method,
        sum(any(one.status != "missing" for one in records) for records in cells),
        lost=first(lambda one: verdict(one) == "lost"),
        unfinished=first(lambda one: one.status not in ("ok", "missing")),
        weakest=[_weak_output(record, quality, pictures) for quality, record in weak],
    )


def _weak_output(record: CellRecord, quality: float, pictures: PictureStore) -> WeakOutput:
    layers = [record.pictures[name] for name in DEFECTS if name in record.pictures]
    crop = pictures.worst_crop(record.folder / "output.png", layers)
    return WeakOutput(record, quality, _limiting_peril(record), crop)


def build_disagreement(run: Run, record: CellRecord, question: Question, pictures: PictureStore) -> DisagreementFigure:
    """Return the figure of a cell on which people and the automatic answer to a question differ."""
    output = pictures.load(record.folder / "output.png")
    names = [name for name in run.columns if name.startswith(f"{question.metric}.")]
    drawn = (record.pictures.get(name) for name in DEFECTS if name.startswith(f"{question.metric}."))
    defects = next(filter(None, drawn), None)
    return DisagreementFigure(
        method=_method_of(record),
        sample=pictures.load(record.folder / "sample.png"),
        output=output,
        layer=pictures.load(defects) if output else None,
        scale=output.scale if output else 1.0,
        explanation=explain_verdict(record, question.column),
        scores=_ScoreTexts.of(run).select(record, names),
    )


def _texture_draw(
    lines: _ScoreTexts, score: str, titles: Sequence[str], pictures: PictureStore, records: Sequence[CellRecord]
) -> TextureDraw:
    sample = next(filter(None, (pictures.load(record.folder / "sample.png") for record in records)), None)
    figures = [_output_figure(lines, record, score, titles, pictures) for record in records]
    outputs = [one.output for one in figures if one.output]
    known = next((record.lattice_truth for record in records if record.lattice_truth), None)
    truth = Lattice.from_dict(known).reduced() if known else None
    shape = (sample.height, sample.width) if sample else (1, 1)
    return TextureDraw(
        replicate=records[0].replicate,
        sample=sample,
        scale=outputs[0].scale if outputs else 1.0,
        truth=trace_lattice(truth, shape) if truth and sample else None,
        agreeing=[
            _method_of(record).label
            for record in records
            if record.lattice_source not in ("given", "none") and _uses(record, truth)
        ],
        used=_used_lattices(records, truth, shape) if sample else [],
        figures=figures,
    )


def _output_figure(
    lines: _ScoreTexts, record: CellRecord, score: str, titles: Sequence[str], pictures: PictureStore
) -> OutputFigure:
    known = record.values.get(score)
    value = None if known is None else float(known)
    shade = score_shade(value)
    if shade is not None and verdict(record) == "lost":
        shade = min(shade, _MAX_LOST_SHADE)  # a lost lattice never looks like a preserved one
    output = pictures.load(record.folder / "output.png") if record.status == "ok" else None
    layers, insets = _lay_over(record, titles, pictures)
    return OutputFigure(
        record=record,
        method=_method_of(record),
        score=value,
        shade=shade,
        limit=_limiting_peril(record),
        output=output,
        layers=layers,
        insets=insets,
        lattice=_output_lattice(record, (output.height, output.width)) if output else None,
        headline=lines.select(record, lines.headline),
        scores=lines.select(record, lines.every),
    )


def _lay_over(
    record: CellRecord, titles: Sequence[str], pictures: PictureStore
) -> tuple[list[PictureLayer], list[tuple[str, PagePicture]]]:
    """Return the layers of an output, and the pictures of its metrics that have another size."""
    layers: list[PictureLayer] = []
    insets: list[tuple[str, PagePicture]] = []
    if record.status != "ok" or not pictures.load(record.folder / "output.png"):
        return layers, insets
    for index, title in enumerate(titles, 1):
        path = record.pictures.get(title)
        if title == SOURCE_MAP:
            laid = pictures.source_map(record.folder / "output.png", record.folder / "source.npz")
        else:
            laid = pictures.overlay(record.folder / "output.png", path)
        if laid:
            layers.append(PictureLayer(index, title, laid))
        elif inset := pictures.load(path):
            insets.append((title, inset))
    return layers, insets


def _output_lattice(record: CellRecord, shape: tuple[int, int]) -> LatticeOverlay | None:
    """Return the lattice on which the output was judged, at the phase that the judge found; None if it has none."""
    judged = record.records.get("regularity", {})
    try:
        lattice = Lattice.from_dict(judged["lattice"])
        x, y = (float(value) for value in judged.get("phase") or (0.0, 0.0))
        origin = (lattice.origin[0] + x, lattice.origin[1] + y)
        return trace_lattice(Lattice(lattice.t1, lattice.t2, origin).reduced(), shape)
    except (KeyError, TypeError, ValueError, AttributeError):
        return None


def _limiting_peril(record: CellRecord) -> str:
    """Return the peril with the smallest score; empty without a quality, and for a quality of 1."""
    quality = record.values.get(QUALITY)
    return "" if quality is None or quality >= _FULL else str(record.records.get("quality", {}).get("worst", ""))


def _method_of(record: CellRecord) -> Method:
    return Method(record.method, record.lattice_source, record.reference, record.parameters)


def _uses(record: CellRecord, truth: Lattice | None) -> bool:
    """Return whether a cell used the true lattice."""
    if record.lattice_used is None or truth is None:
        return False
    return Lattice.from_dict(record.lattice_used).is_equivalent(truth, SAME_LATTICE)


def _used_lattices(records: Sequence[CellRecord], truth: Lattice | None, shape: tuple[int, int]) -> list[UsedLattice]:
    """Return the lattices that differ from the true one, each with the methods that used it."""
    groups: list[tuple[Lattice, list[str]]] = []
    for record in records:
        if record.lattice_used is None or _uses(record, truth):
            continue
        used = Lattice.from_dict(record.lattice_used)
        same = (group for group in groups if group[0].is_equivalent(used, SAME_LATTICE))
        group = next(same, None) or (used, [])
        if not group[1]:
            groups.append(group)
        group[1].append(_method_of(record).label)
    return [UsedLattice(labels, trace_lattice(align_basis(used, truth, shape), shape)) for used, labels in groups]
