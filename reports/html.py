"""The report as one HTML file that needs nothing else."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, ClassVar

import jinja2
from markupsafe import Markup

from nrbench.labelling.labels import ANSWERS, content_hash
from nrbench.runs.records import CellRecord, Run
from nrbench.runs.store import RUN_FILE
from nrbench.storage import write_aside

from .page import format as wording
from .page.disputed import disputed
from .page.figures import layer_titles, shade
from .page.gallery import gallery
from .page.pictures import Pictures
from .perils import drawn
from .plots.forest_plot import panels
from .statistics.baselines import LEGEND, SIGN
from .statistics.comparison import comparison
from .statistics.detections import KINDS, STOCHASTIC, Detectors, detectors
from .statistics.people import people
from .statistics.perils import places
from .statistics.summary import headlines, known_columns
from .statistics.summary_rows import others
from .statistics.verdicts import MEANINGS, PRESERVED

_TEMPLATES = Path(__file__).parent / "page" / "templates"
_KEY_VERSIONS = ("nrbench", "python", "numpy", "scipy", "scikit-image", "numba", "pandas", "pillow")


@dataclass(frozen=True)
class HtmlReport:
    """The whole run on one page, ``report.html``: works from ``file://``, asks no network.

    The comparison with success rates and their intervals, how far to trust each detector of the lattice axis, each
    texture's sample, lattice and outputs side by side, what
    failed and why, what the run was made with, and what every score means.

    Parameters
    ----------
    embed_mib
        Pictures go into the page up to this many MiB; beyond, the page links the run's own files and must stay beside
        them.
    labels
        Files of people's answers, as ``nrbench label`` has them saved: adds how judge and people agree.
    """

    embed_mib: float = 60.0
    labels: tuple[Path, ...] = ()

    version: ClassVar[str] = "1"
    folder: ClassVar[str] = "report"

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write ``report.html`` and return its path."""
        path, page = directory / "report.html", self.render(run, directory).encode("utf-8", "backslashreplace")
        write_aside(path, lambda aside: aside.write_bytes(page))
        return [path]

    def render(self, run: Run, directory: Path) -> str:
        """Return the page; ``directory`` is where it will lie."""
        found = comparison(run)
        pictures = Pictures.of(run.cells, directory, self.embed_mib * 2**20)
        asked = detectors(run)
        shown = places(found.summaries)
        labelled = people(run, self.labels)
        doubted = labelled.disagreements if labelled else ()
        content: dict[str, Any] = {
            "info": run.info,
            "created": _created(run),
            "versions": _versions(run.info.get("versions", {})),
            "run": run,
            "found": found,
            "first_reference": next((i for i, head in enumerate(found.heads) if i and head.reference), -1),
            "others": others(run, found.summaries),
            "panels": panels(found.summaries, headlines(run)),
            "places": shown,
            "plane": _svg_source(drawn(shown, "svg")) if shown else "",
            "sections": gallery(run, found, pictures),
            "titles": layer_titles(run),
            "unfinished": _unfinished(run.cells),
            "broken_scores": _broken_scores(run.cells),
            "columns": known_columns(run),
            "meanings": MEANINGS,
            "no_cheat_sign": SIGN,
            "no_cheat_legend": LEGEND,
            "embedded": pictures.embedded,
            "judged": PRESERVED in run.columns,
            "detectors": asked,
            "families": _families(asked),
            "kinds": KINDS,
            "people": labelled,
            "answers": ANSWERS,
            "disagreements": [(one, disputed(run, one.record, pictures)) for one in doubted],
        }
        return _page(content)


def _svg_source(svg: bytes) -> str:
    return f"data:image/svg+xml;base64,{base64.b64encode(svg).decode('ascii')}"


def _page(content: Mapping[str, Any]) -> str:
    """Fill the template; style and script go in by hash, so that nothing else on the page can run."""
    env = _environment()
    style = Markup(env.get_template("style.css").render(content))
    script = Markup(env.get_template("script.js").render())
    hashes = {"style_hash": content_hash(style), "script_hash": content_hash(script)}
    return env.get_template("report.html").render(content, style=style, script=script, **hashes)


def _environment() -> jinja2.Environment:
    env = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    words = ("number", "plain", "plural", "interval", "signed", "counted", "successes", "percent", "end", "way", "tip")
    env.filters.update({name: getattr(wording, name) for name in words}, shade=shade)
    return env


def _families(asked: Detectors | None) -> list[str]:
    """Return the families of the textures that have a lattice to be found."""
    groups = asked.groups if asked else []
    return list(dict.fromkeys(group.family for group in groups if group.departure != STOCHASTIC))


def _created(run: Run) -> str:
    """Return when the run was made, from its record or its file's time."""
    known = run.info.get("created")
    file = run.root / RUN_FILE
    if known or not file.is_file():
        return str(known or "")
    return datetime.fromtimestamp(file.stat().st_mtime, UTC).strftime("%Y-%m-%d %H:%M UTC")


def _versions(versions: Mapping[str, str]) -> tuple[dict[str, str], dict[str, str]]:
    """Return the versions that matter most, and the others."""
    main = {name: versions[name] for name in _KEY_VERSIONS if name in versions}
    return main, {name: version for name, version in versions.items() if name not in main}


def _unfinished(cells: Sequence[CellRecord]) -> list[CellRecord]:
    """Return the cells without an output: failures first, then refusals, then what has not run."""
    last = ("refused", "missing")
    rest = [record for record in cells if record.status != "ok"]
    return sorted(rest, key=lambda record: last.index(record.status) + 1 if record.status in last else 0)


def _broken_scores(cells: Sequence[CellRecord]) -> list[tuple[CellRecord, str, str]]:
    """Return the metrics that failed on a cell: the cell, the metric, why."""
    found = {
        (i, name.partition(".")[0], why): record
        for i, record in enumerate(cells)
        for name, why in record.reasons.items()
        if why.startswith("failed:")
    }
    return [(record, metric, why) for (_, metric, why), record in found.items()]
