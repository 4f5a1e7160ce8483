"""Names that strangers choose: whatever a picture is called, its cells and reports stay in the run directory."""

from __future__ import annotations

import csv
import html.parser
import io
import os
import re
import shutil
from contextlib import redirect_stderr
from pathlib import Path

import pytest
from commands import call

import nrbench
from nrbench import texture
from nrbench.pictures.files import write_image
from nrbench.pictures.truth import table_text
from nrbench.running.runner import Options
from nrbench.runs.records import Run

NAMES = (
    "<script>alert('nrmark')<",
    '"onerror="alert(1)" x=\'y\'',
    "&lt;b&gt; &amp; 100% _of_ $x$ #1 ^~",
    "\\input{nrmark}\\write18{touch nrmark}",
    "=1+nrmark",
    "@nrmark|cmd",
    "two\nlines\r\tnrmark",
    "nrmark..\\..\\nrmark",
    "%2e%2e%2fnrmark",
    "$(touch nrmark);`touch nrmark`",
    "{sample} {0} {{x}} {% raw %}",
    "right \u202enrmark\u202c to left \u0627\u0644",
    "\U0001f9f1\U0001f469\u200d\U0001f52c e\u0301",
    "-nrmark --help",
    "[link](javascript:alert(1)) | `code` **bold**",
    "n" * 150,
)


class Elements(html.parser.HTMLParser):
    """Collects what a page would run: scripts, handlers of events, and links that are scripts."""

    def __init__(self) -> None:
        super().__init__()
        self.active: list[str] = []
        self._script = False

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        """Note an element."""
        self._script = tag == "script"
        self.active += [f"{tag} {name}" for name, _ in attributes if name.startswith("on")]
        self.active += [f"{tag} {value}" for _, value in attributes if (value or "").lower().startswith("javascript:")]

    def handle_data(self, data: str) -> None:
        """Note the text of a script in which a name became code."""
        if self._script and "alert(" in data and "\\u003c" not in data:
            self.active.append(f"script {data[:60]}")
        self._script = False


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run a folder of pictures with such names, and write every report."""
    place = tmp_path_factory.mktemp("names")
    folder = place / "pictures <b>&'"
    folder.mkdir()
    lattice = dict(zip(("t1x", "t1y", "t2x", "t2y", "originx", "originy"), (16, 0, 8, 12, 3, 2), strict=True))
    for i, name in enumerate(NAMES):
        image = texture("brick", shape=(60, 64), seed=i, width=16, height=12).image
        shutil.move(write_image(place / "plain.png", image), folder / f"{name}.png")
    rows = [{"file": f"{name}.png", **lattice} for name in NAMES]
    (folder / "truth.csv").write_text(table_text(list(rows[0]), rows), "utf-8")
    (folder / "unread <i>.png").write_text("no picture")
    (folder / "empty.png").write_bytes(b"")
    (folder / "second.png").write_text("no picture either")
    before = sorted(str(path) for path in place.rglob("*"))
    here = Path.cwd()
    os.chdir(place)
    try:
        command = "command:run=false {sample} {output},label=<script>alert('nrmark')"
        with redirect_stderr(io.StringIO()):
            nrbench.run(
                folder,
                methods=["tiling", command],
                lattice=["given"],
                sample="40x44",
                size="60x64",
                metrics=["quality", "regularity", "cost"],
                out=place / "run",
                options=Options(jobs=0),
            )
        assert call("report", str(place / "run")) == 0
        assert call("label", str(place / "run")) == 0
        assert call("status", str(place / "run")) == 0
    finally:
        os.chdir(here)
    after = [str(path) for path in place.rglob("*") if not path.is_relative_to(place / "run")]
    assert sorted(after) == before
    return place / "run"


def test_every_picture_has_its_rows(run: Path) -> None:
    """Each picture has a cell for each method, and each cell a folder that is named by its hash."""
    cells = Run(run).cells
    assert len(cells) == 2 * (len(NAMES) + 3)
    assert len({cell.texture for cell in cells}) == len(NAMES) + 3
    assert not any("\u202e" in cell.texture for cell in cells)
    assert [cell.status for cell in cells].count("ok") == len(NAMES)
    assert {path.name for path in (run / "cells").iterdir()} == {cell.key for cell in cells}


def test_pages_run_nothing(run: Path) -> None:
    """No name becomes an element, a handler or a script of a page."""
    pages = [path for path in run.rglob("*.htm*") if path.is_file()]
    assert len(pages) >= 2
    for page in pages:
        text = page.read_text("utf-8")
        found = Elements()
        found.feed(text)
        assert found.active == [] and "<script>alert" not in text and "<i>.png" not in text, page.name


def test_tables_hold_names_as_text(run: Path) -> None:
    """CSV has no formula, Markdown no link or tag, LaTeX no command and no SVG an element of a name."""
    for path in run.rglob("*.csv"):
        with path.open(newline="", encoding="utf-8") as lines:
            fields = [field for row in csv.reader(lines) for field in row]
        assert not [field for field in fields if field.startswith(("=", "@")) or field.startswith("-nr")], path.name
    for path in run.rglob("*.md"):
        text = path.read_text("utf-8")
        assert not re.search(r"(?<!\\)\]\(", text) and "<script>" not in text and "**bold**" not in text
    for path in run.rglob("*.tex"):
        text = path.read_text("utf-8")
        assert "\\input{nrmark" not in text and "\\write18" not in text and "$x$" not in text
    for path in run.rglob("*.svg"):
        assert "<script" not in path.read_text("utf-8")
