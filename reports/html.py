"""Write the report of a run as one self-contained HTML file."""

from __future__ import annotations

import shlex
from base64 import b64encode
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, ClassVar

from markupsafe import Markup

from nrbench.errors import strip_control
from nrbench.labelling import questions
from nrbench.labelling.labels import content_hash
from nrbench.runs.records import CellRecord, Run
from nrbench.storage import write_text
from nrbench.version import find_project

from .csv import csv_text, summary_table
from .latex import bibliography, latex_text
from .page import gallery
from .page.environment import make_environment
from .page.forest_plot import forest_axes
from .page.method_terms import group_by_family, list_patch_terms, order_by_peril
from .page.pictures import CROP, PictureStore
from .plots.method_plots import (
    plot_claim,
    plot_cost,
    plot_heat_map,
    plot_levels,
    plot_perils_plane,
    plot_ranks,
    timed_methods,
)
from .plots.perils_points import perils_points
from .statistics.detections import compare_detectors
from .statistics.expectations import compare_with_published, evaluate_claims
from .statistics.labelers import compare_labelers
from .statistics.levels import BROKEN, compare_levels
from .statistics.method_comparison import compare_methods
from .statistics.summaries import (
    describe_scores,
    headline_columns,
    other_score_rows,
    sort_headlines_first,
)
from .statistics.verdicts import SCORE

_LEVELS_WIDTH = 8.7
"""Width of the plot of levels, inches: three columns."""


@dataclass(frozen=True)
class HtmlReport:
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
    tests
        Whether to test which methods differ. Without tests there is no leading group.
    baseline
        The method with which the others are compared, by its name or label; by default the best ranked one.
    population
        Whether intervals are over a population of textures, of which the suite is a sample, else over draws of its own.
    """

    single_file: bool = False
    labels: tuple[Path, ...] = ()
    tests: bool = True
    baseline: str = ""
    population: bool = False

    version: ClassVar[str] = "1"
    folder: ClassVar[str] = "report"

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write ``report.html`` and return its path."""
        path = directory / "report.html"
        write_text(path, self.render(run, directory))
        return [path]

    def render(self, run: Run, directory: Path) -> str:
        """Return the page as it will lie in ``directory``."""
        comparison = compare_methods(run, self.tests, self.baseline, self.population)
        pictures = PictureStore(directory, self.single_file)
        points, panels = perils_points(comparison.summaries), compare_levels(run, comparison)
        labelers, claims, timed = compare_labelers(run, self.labels), evaluate_claims(run), timed_methods(comparison)
        sections = gallery.build_gallery(run, comparison, pictures)
        content: dict[str, Any] = {
            "command": shlex.join(map(str, run.info.get("argv") or [])),
            "run": run,
            "comparison": comparison,
            "patch_terms": list_patch_terms(run),
            "first_reference": next((i for i, one in enumerate(comparison.methods) if i and one.reference), -1),
            "more_rows": other_score_rows(run, comparison.summaries),
            "axes": forest_axes(comparison.summary_rows),
            "families": group_by_family(run, comparison.summaries),
            "perils": order_by_peril(comparison.summaries),
            "project": find_project(run.info),
            "points": points,
            "plane": plot_perils_plane("svg", points) if points else b"",
            "ranks": plot_ranks("svg", comparison) if comparison.tests else b"",
            "heat_map": plot_heat_map("svg", comparison) if comparison.has_ranking else b"",
            "cost_plane": plot_cost("svg", timed) if timed else b"",
            "summary_csv": csv_text(summary_table(comparison)),
            "summary_latex": latex_text(run, comparison) if comparison.scored and comparison.rows else "",
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
            "sections": sections,
            "layers": gallery.list_layers(sections),
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
            "questions": questions,
        }
        page = _fill_template(content, pictures)
        pictures.sweep()
        return page


def _fill_template(content: Mapping[str, Any], pictures: PictureStore) -> str:
    """Return the page; its content policy names style and script by hash, so that nothing else on it can run."""
    environment = make_environment(
        {"score_shade": gallery.score_shade, "strip_control": strip_control, "as_image": _as_image}, autoescape=True
    )
    embed = pictures.embeds()
    address = cache(lambda picture: pictures.address(picture, embed))
    style = Markup(environment.get_template("style.css").render(content))
    script = Markup(environment.get_template("script.js").render())
    return environment.get_template("report.html").render(
        content,
        **{"style": style, "style_hash": content_hash(style), "script": script, "script_hash": content_hash(script)},
        **{"address": address, "embedded": embed},
    )


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
