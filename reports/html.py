"""Write the report of a run as one self-contained HTML file."""

from __future__ import annotations

import math
import shlex
from base64 import b64encode
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from markupsafe import Markup

from nrbench.errors import strip_control
from nrbench.labelling.labels import ANSWERS, WHOLE_SCORE
from nrbench.plugins.forms import Column
from nrbench.runs.records import CellRecord, Run
from nrbench.storage import write_files
from nrbench.version import find_project

from .csv import csv_text
from .latex import LatexTables, bibliography
from .page import gallery
from .page.pictures import CROP, PictureStore
from .page.plots import (
    plot_claim,
    plot_cost,
    plot_heat_map,
    plot_levels,
    plot_perils_plane,
    plot_ranks,
    timed_methods,
)
from .statistics.detections import compare_detectors
from .statistics.estimates import NO_ESTIMATE
from .statistics.expectations import BROKEN, compare_levels, compare_with_published, evaluate_claims
from .statistics.format import format_number, format_percent, render_page
from .statistics.frames import method_classes, print_improvements, print_parameters, print_patches, summary_table
from .statistics.labelers import compare_labelers
from .statistics.method_comparison import ComparisonOptions
from .statistics.summaries import (
    COSTS,
    MethodSummary,
    SummaryRow,
    describe_scores,
    headline_columns,
    other_score_rows,
    perils_points,
    sort_headlines_first,
)
from .statistics.verdicts import PERILS, SCORE

_LEVELS_WIDTH = 8.7
"""Width of the plot of levels, inches: three columns."""


@dataclass(frozen=True)
class HtmlReport(ComparisonOptions):
    """The whole run on one page, ``report.html``, which works offline from ``file://``.

    It shows the ranking of the methods by quality, the comparison by texture, where each method fails and what its
    weakest outputs look like, the perils plane, where each method breaks, the claims that the suite tests, the verdicts
    beside those that the report of 2004 published, the accuracy of each detector of the lattice axis, each texture's
    sample, lattice and outputs side by side, the failures and their causes, the provenance of the run, and the meaning
    of every score.

    Parameters
    ----------
    single_file
        Embed every output with all its pixels. Otherwise the page embeds small copies and needs the folder
        ``pictures`` beside it only to show all pixels of a magnified output. A page of so many outputs that the small
        copies exceed 7 MB loads them from that folder, too.
    labels
        Answer files of the labelling pages of ``nrbench label``. They add the agreement of labelers with the scores.
    """

    single_file: bool = False
    labels: tuple[Path, ...] = ()

    version: ClassVar[str] = "1"

    def begin(self, run: Run, directory: Path) -> Callable[[], list[Path]]:
        """Begin to make the pictures in threads; return the function that writes the page with them."""
        pictures = PictureStore(directory, self.single_file)
        figures = gallery.begin_figures(run, pictures)
        return lambda: write_files(directory, {"report.html": self._render(run, pictures, figures)})

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write ``report.html`` and return its path."""
        return self.begin(run, directory)()

    def render(self, run: Run, directory: Path) -> str:
        """Return the page as it will lie in ``directory``."""
        pictures = PictureStore(directory, self.single_file)
        return self._render(run, pictures, gallery.begin_figures(run, pictures))

    def _render(self, run: Run, pictures: PictureStore, figures: Sequence[Future[gallery.OutputFigure]]) -> str:
        """Return the page."""
        comparison = self.comparison(run)
        points, panels = perils_points(comparison.summaries), compare_levels(run, comparison)
        labelers, claims, timed = compare_labelers(run, self.labels), evaluate_claims(run), timed_methods(comparison)
        content: dict[str, Any] = {
            "command": shlex.join(map(str, run.info.get("argv") or [])),
            "run": run,
            "comparison": comparison,
            "patches": print_patches(run),
            "improvements": print_improvements(comparison),
            "parameters": print_parameters(comparison),
            "first_reference": next((i for i, one in enumerate(comparison.methods) if i and one.reference), -1),
            "more_rows": other_score_rows(run, comparison.summaries),
            "axes": forest_axes(comparison.summary_rows),
            "families": _group_by_family(run, comparison.summaries),
            "perils": _order_by_peril(comparison.summaries),
            "project": find_project(run.info),
            "points": points,
            "plane": plot_perils_plane("svg", points) if points else b"",
            "ranks": plot_ranks("svg", comparison) if comparison.tests else b"",
            "heat_map": plot_heat_map("svg", comparison) if comparison.has_ranking else b"",
            "cost_plane": plot_cost("svg", timed) if timed else b"",
            "summary_csv": csv_text(summary_table(comparison)),
            "summary_latex": LatexTables().summary(comparison) if comparison.scored and comparison.rows else "",
            "bibliography": bibliography(run),
            "panels": panels,
            "level_plot": plot_levels("svg", panels, _LEVELS_WIDTH) if panels else b"",
            "broken": BROKEN,
            "disagreements": {
                name: [
                    (one, gallery.load_disagreement(one.record, asked.question, pictures))
                    for one in asked.disagreements
                ]
                for name, asked in (labelers.questions.items() if labelers else ())
            },
            "failings": gallery.list_failings(comparison, pictures),
            "crop_side": CROP,
            "gallery": gallery,
            "headline": [name for name in headline_columns(run) if name != SCORE],
            "every_score": sort_headlines_first(run.columns),
            "score_lines": partial(gallery.score_lines, run),
            "unfinished": _unfinished_cells(run.cells),
            "missing": Counter(record.texture for record in run.cells if record.status == "missing"),
            "failed_scores": _failed_scores(run.cells),
            "columns": describe_scores(run),
            "claims": claims,
            "claim_plots": [plot_claim("svg", one) for one in claims],
            "published": compare_with_published(run, comparison),
            "single_file": self.single_file,
            "detectors": compare_detectors(run),
            "labelers": labelers,
            "answers": ANSWERS,
            "whole_score": WHOLE_SCORE,
        }
        sections = gallery.build_gallery(comparison, figures, pictures)  # last, because it waits for the figures
        content |= {"sections": sections, "layers": gallery.list_layers(sections), "embedded": pictures.embeds()}
        content["address"] = cache(partial(pictures.address, embed=content["embedded"]))
        filters: dict[str, Any] = {
            "score_shade": gallery.score_shade,
            "strip_control": strip_control,
            "as_image": _as_image,
        }
        page = render_page("report.html", content, filters)
        pictures.sweep()
        return page


def _as_image(svg: bytes) -> Markup:
    """Return a plot as an element of the page, without an alternative text: its figure has one."""
    return Markup(f'<img class="plot" src="data:image/svg+xml;base64,{b64encode(svg).decode()}" alt="">')


def _unfinished_cells(cells: Sequence[CellRecord]) -> list[CellRecord]:
    """Return the cells that ended without an output: failures first, then refusals."""
    rest = [record for record in cells if record.status not in ("ok", "missing")]
    return sorted(rest, key=lambda record: record.status == "refused")


def _failed_scores(cells: Sequence[CellRecord]) -> list[tuple[CellRecord, str, str]]:
    """Return the cells on which a metric failed, each with the metric and the reason."""
    failures = {
        (i, name.partition(".")[0], why): record
        for i, record in enumerate(cells)
        for name, why in record.reasons.items()
        if why.startswith("failed:")
    }
    return [(record, metric, why) for (_, metric, why), record in failures.items()]


def _group_by_family(run: Run, summaries: Sequence[MethodSummary]) -> dict[str, list[MethodSummary]]:
    """Return the ranked methods by the family that each declares, the best first; those without one come last."""
    plugin = {record.method: record.cell.method for record in run.cells}
    classes = method_classes(run.cells)
    groups: dict[str, list[MethodSummary]] = {}
    for one in sorted((each for each in summaries if each.rank), key=lambda each: each.rank or 0):
        family = str(getattr(classes.get(plugin[one.method.name]), "family", "")) or "other methods"
        groups.setdefault(family, []).append(one)
    return dict(sorted(groups.items(), key=lambda group: group[0] == "other methods"))


def _order_by_peril(summaries: Sequence[MethodSummary]) -> dict[str, list[MethodSummary]]:
    """Return the methods that are no references by each peril, those that keep most first; unmeasured ones last."""
    methods = [one for one in summaries if not one.method.reference]

    def kept(one: MethodSummary, peril: str) -> float:
        value = one.means[peril].value if peril in one.means else None
        return -1.0 if value is None else value

    measured = [peril for peril in PERILS if any(kept(one, peril) >= 0 for one in methods)]
    return {peril: sorted(methods, key=lambda one: -kept(one, peril)) for peril in measured}


Scale = Callable[[float | None], float | None]
"""Maps a value to its place on an axis, from 0 to 100."""


Point = tuple[float | None, float | None, float | None]
"""Places of a value and of the ends of its interval on an axis; None if there is none."""


@dataclass(frozen=True)
class ForestAxis:
    """One axis, with a point for each method.

    Parameters
    ----------
    row
        The numbers of the methods.
    ends
        The ends of the axis as text.
    one
        Place of the value 1, 0 to 100, for a score that is best there; else None.
    better
        Which values are better, in words.
    points
        One for each method, by its label.
    """

    row: SummaryRow
    ends: tuple[str, str]
    one: float | None
    better: str
    points: Mapping[str, Point]


_BETTER = {"higher": "better →", "lower": "← better", "one": "best at 1", "none": ""}


def forest_axes(rows: Sequence[SummaryRow]) -> list[ForestAxis]:
    """Return an axis for each number that summarizes the methods, without the variants."""
    return [_axis(row) for row in rows if not row.variant]


def _axis(row: SummaryRow) -> ForestAxis:
    text = format_percent if row.rate else format_number
    estimates = {label: number.estimate or NO_ESTIMATE for label, number in row.numbers.items()}
    known = [x for one in estimates.values() for x in (one.value, one.low, one.high) if x is not None]
    logarithmic = row.name in COSTS and bool(known) and min(known) > 0
    low, high = _whole_decades(known) if logarithmic else _linear_range(row.column, known)
    scale = _scale(low, high, math.log if logarithmic else float)
    return ForestAxis(
        row,
        ends=(text(low), text(high)),
        one=scale(1.0) if row.column.better == "one" else None,
        better=_BETTER[row.column.better],
        points={label: (scale(one.value), scale(one.low), scale(one.high)) for label, one in estimates.items()},
    )


def _whole_decades(known: Sequence[float]) -> tuple[float, float]:
    low, high = 10.0 ** math.floor(math.log10(min(known))), 10.0 ** math.ceil(math.log10(max(known)))
    return low, high if high > low else 10 * low


def _linear_range(column: Column, known: Sequence[float]) -> tuple[float, float]:
    """Return the declared range if it is narrow, else a range that holds the known values."""
    low, high = column.range
    if column.better == "one":
        known = [*known, 1.0]
    low = low if math.isfinite(low) else min([0.0, *known])
    if not (math.isfinite(high) and high <= low + 1):
        high = max([low + 1e-9, *known]) * 1.05
    return low, high if high > low else low + 1


def _scale(low: float, high: float, transform: Callable[[float], float]) -> Scale:
    """Return the map from [low, high] to [0, 100] that is linear in the transformed value."""
    ends = (transform(low), transform(high))

    def scale(value: float | None) -> float | None:
        return None if value is None else round(float(np.interp(transform(max(value, low)), ends, (0, 100))), 2)

    return scale
