"""Write the report of a run as one self-contained HTML file."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

from markupsafe import Markup

from nrbench.errors import strip_control
from nrbench.labelling.labels import content_hash
from nrbench.labelling.questions import ANSWERS, WHOLE_SCORE
from nrbench.runs.records import CellRecord, Run
from nrbench.runs.store import RUN_FILE
from nrbench.storage import write_text

from .csv import csv_text, summary_table
from .latex import bibliography, latex_text
from .page.environment import make_environment
from .page.forest_plot import forest_axes
from .page.gallery import SOURCE_MAP, build_disagreement, build_gallery, list_failings, list_layers, score_shade
from .page.inline_svg import inline_svg
from .page.pictures import CROP, PictureStore
from .plots.cost_plane import has_cost, plot_cost
from .plots.critical_difference import plot_ranks
from .plots.heat_map import plot_heat_map
from .plots.perils_plane import plot_perils_plane
from .plots.series_plot import plot_claim, plot_levels
from .statistics.detections import KINDS, STOCHASTIC, DetectorComparison, compare_detectors
from .statistics.expectations import SENTENCE, compare_with_published, evaluate_claims
from .statistics.levels import BROKEN, compare_levels
from .statistics.method_comparison import LEADING_SIGN, compare_methods
from .statistics.people import compare_people
from .statistics.summaries import describe_scores, list_patch_terms, other_score_rows, perils_points
from .statistics.verdicts import (
    BASELINE_LEGEND,
    BASELINE_SIGN,
    MARKS,
    MEANINGS,
    explain_valid_baseline,
    explain_verdict,
    verdict,
)

_KEY_VERSIONS = ("nrbench", "python", "numpy", "scipy", "scikit-image", "numba", "pandas", "pillow")
_MOST_DIFFERENCES = 1000
"""More paired differences than this are in the CSV tables only: their number grows with the square of the methods."""
_LEVELS_WIDTH = 8.7
"""Width of the plot of levels, inches: three columns."""


_FILTERS: Mapping[str, Callable[..., Any]] = {
    "score_shade": score_shade,
    "strip_control": strip_control,
    "verdict": verdict,
    "explain_verdict": explain_verdict,
    "explain_valid_baseline": explain_valid_baseline,
}


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
        Answer files of the labelling pages of ``nrbench label``. They add the agreement of people with the scores.
    tests
        Whether to test which methods differ. Without tests there is no leading group.
    baseline
        The method with which the others are compared, by its name or label; by default the best ranked one.
    """

    single_file: bool = False
    labels: tuple[Path, ...] = ()
    tests: bool = True
    baseline: str = ""

    version: ClassVar[str] = "1"
    folder: ClassVar[str] = "report"

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write ``report.html`` and return its path."""
        path = directory / "report.html"
        write_text(path, self.render(run, directory))
        return [path]

    def render(self, run: Run, directory: Path) -> str:
        """Return the page as it will lie in ``directory``."""
        comparison = compare_methods(run, self.tests, self.baseline)
        pictures = PictureStore(directory, self.single_file)
        detectors = compare_detectors(run)
        points, panels = perils_points(comparison.summaries), compare_levels(run, comparison)
        people, claims = compare_people(run, self.labels), evaluate_claims(run)
        disagreements = {
            name: [(one, build_disagreement(run, one.record, asked.question, pictures)) for one in asked.disagreements]
            for name, asked in (people.questions.items() if people else ())
        }
        sections = build_gallery(run, comparison, pictures)
        failings = list_failings(comparison, pictures)
        embed = pictures.embeds()
        references = (i for i, method in enumerate(comparison.methods) if i and method.reference)
        content: dict[str, Any] = {
            "info": run.info,
            "created": _creation_time(run),
            "command": shlex.join(map(str, run.info.get("argv") or [])),
            "versions": _split_versions(run.info.get("versions", {})),
            "run": run,
            "comparison": comparison,
            "patch_terms": list_patch_terms(run),
            "first_reference": next(references, -1),
            "more_rows": other_score_rows(run, comparison.summaries),
            "axes": forest_axes(comparison.summary_rows),
            "points": points,
            "plane": inline_svg(plot_perils_plane(points, "svg"), "plane") if points else "",
            "ranks": inline_svg(plot_ranks(comparison), "ranks") if comparison.tests else "",
            "heat_map": inline_svg(plot_heat_map(comparison), "heat") if comparison.has_ranking else "",
            "cost_plane": inline_svg(plot_cost(comparison), "cost") if has_cost(comparison) else "",
            "summary_csv": csv_text(summary_table(comparison)),
            "summary_latex": latex_text(run, comparison) if comparison.scored and comparison.rows else "",
            "bibliography": bibliography(run),
            "panels": panels,
            "level_plot": inline_svg(plot_levels(panels, "svg", _LEVELS_WIDTH), "levels") if panels else "",
            "broken": BROKEN,
            "leading_sign": LEADING_SIGN,
            "leading_legend": comparison.leading_legend,
            "sections": sections,
            "layers": list_layers(sections),
            "failings": failings,
            "crop": CROP,
            "most_differences": _MOST_DIFFERENCES,
            "source_map": SOURCE_MAP,
            "address": cache(lambda picture: pictures.address(picture, embed)),
            "embedded": embed,
            "unfinished": _unfinished_cells(run.cells),
            "missing": _missing_cells(run.cells),
            "failed_scores": _failed_scores(run.cells),
            "columns": describe_scores(run),
            "meanings": MEANINGS,
            "marks": MARKS,
            "claims": claims,
            "claim_plots": [inline_svg(plot_claim(one, "svg"), f"claim{i}") for i, one in enumerate(claims)],
            "published": compare_with_published(run, comparison),
            "published_sentence": SENTENCE,
            "baseline_sign": BASELINE_SIGN,
            "baseline_legend": BASELINE_LEGEND,
            "single_file": self.single_file,
            "scored": comparison.scored,
            "detectors": detectors,
            "families": _families(detectors),
            "kinds": KINDS,
            "people": people,
            "answers": ANSWERS,
            "whole_score": WHOLE_SCORE,
            "disagreements": disagreements,
        }
        page = _fill_template(content)
        pictures.sweep()
        return page


def _fill_template(content: Mapping[str, Any]) -> str:
    """Return the page; its content policy names style and script by hash, so that nothing else on it can run."""
    environment = make_environment(_FILTERS, autoescape=True)
    style = Markup(environment.get_template("style.css").render(content))
    script = Markup(environment.get_template("script.js").render())
    hashes = {"style_hash": content_hash(style), "script_hash": content_hash(script)}
    return environment.get_template("report.html").render(content, style=style, script=script, **hashes)


def _families(detectors: DetectorComparison | None) -> list[str]:
    """Return the families of the textures that have a lattice."""
    groups = detectors.groups if detectors else []
    return list(dict.fromkeys(group.family for group in groups if group.departure != STOCHASTIC))


def _creation_time(run: Run) -> str:
    """Return the creation time of the run, from its record or the time of its file."""
    known, file = run.info.get("created"), run.root / RUN_FILE
    if known or not file.is_file():
        return str(known or "")
    return datetime.fromtimestamp(file.stat().st_mtime, UTC).strftime("%Y-%m-%d %H:%M UTC")


def _split_versions(versions: Mapping[str, str]) -> tuple[dict[str, str], dict[str, str]]:
    """Return the versions that matter most, and the others."""
    main = {name: versions[name] for name in _KEY_VERSIONS if name in versions}
    return main, {name: version for name, version in versions.items() if name not in main}


def _unfinished_cells(cells: Sequence[CellRecord]) -> list[CellRecord]:
    """Return the cells that ended without an output: failures first, then refusals."""
    rest = [record for record in cells if record.status not in ("ok", "missing")]
    return sorted(rest, key=lambda record: record.status == "refused")


def _missing_cells(cells: Sequence[CellRecord]) -> dict[str, int]:
    """Return how many cells of each texture have not run: most of a run can be missing while it goes on."""
    return dict(Counter(record.texture for record in cells if record.status == "missing"))


def _failed_scores(cells: Sequence[CellRecord]) -> list[tuple[CellRecord, str, str]]:
    """Return the cells on which a metric failed, each with the metric and the reason."""
    failures = {
        (i, name.partition(".")[0], why): record
        for i, record in enumerate(cells)
        for name, why in record.reasons.items()
        if why.startswith("failed:")
    }
    return [(record, metric, why) for (_, metric, why), record in failures.items()]
