"""What the tables say of detectors: answers told apart, counted once, and with their intervals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Column, FoundLattice
from nrbench.reports.csv import CsvTables, detectors_table
from nrbench.reports.html import HtmlReport
from nrbench.reports.statistics.detections import answers, detectors
from nrbench.reports.statistics.statistics import wilson
from nrbench.reports.text import TextTable
from nrbench.runs.records import CellRecord, Run

from .conftest import HOSTILE, TRUTH, MakeCell, MakeRun

WRONG = Lattice((9.9, 1.0), (0.0, 7.7))
DOUBLE = Lattice((17.0, 0.0), (4.25, 6.1))
ONLY_COST = {"cost.seconds": Column("Wall time.", "s", (0.0, float("inf")), "lower")}


def _found(lattice: Lattice, confidence: float = 0.8) -> FoundLattice:
    return FoundLattice(lattice, 0.5, confidence=confidence)


NONE = FoundLattice(None, 0.25, "no better than chance")


@pytest.fixture
def asked(make_cell: MakeCell, make_run: MakeRun) -> Run:
    """Return a run of two detectors with every kind of answer, seen through two methods."""

    def cell(texture: str, source: str, detected: FoundLattice | None, **more: Any) -> CellRecord:
        asked, method = (source.partition(":")[0], "1", {}), more.pop("method", "lattice-only")
        return make_cell(texture, method, source, detector=asked, detected=detected, reference=True, **more)

    nothing = {"lattice_truth": None, "kind": "stochastic", "family": "noise"}
    failed = {"status": "timeout", "phase": "detect", "message": "took too long"}
    cells = [
        cell("brick-a", "gncc", _found(TRUTH, 0.9)),
        cell("brick-a", "gncc", _found(TRUTH, 0.9), method="rsgf"),
        cell("brick-b", "gncc", _found(DOUBLE, 0.6)),
        cell("brick-c", "gncc", NONE, status="refused", message="no lattice"),
        cell("noise", "gncc", NONE, **nothing),
        cell("brick-a", HOSTILE, _found(WRONG, 0.3)),
        cell("brick-b", HOSTILE, _found(TRUTH, 0.4)),
        cell("brick-c", HOSTILE, None, **failed),
        cell("noise", HOSTILE, _found(WRONG, 0.2), **nothing),
        make_cell("brick-a", "rsgf", "own"),
        cell("brick-d", "gncc", None, status="missing"),
        cell("photograph", "gncc", _found(WRONG), lattice_truth=None, kind=None),
    ]
    departures = {"brick-a": ("color", 0.3), "brick-b": ("color", 0.6), "brick-c": ("noise", 0.1)}
    rows = [{"name": name, "departure": what, "level": level} for name, (what, level) in departures.items()]
    suite = {"name": "tiny", "version": 1, "hash": "abc", "description": "", "content": {"texture": rows}}
    return make_run(cells, suite=suite)


def test_every_kind_of_answer_is_told_apart(asked: Run) -> None:
    """Exact, supercell, none, failed, wrong and false lattice; right where it is what the texture calls for."""
    table = answers(asked).set_index(["detector", "texture"])
    told = {key: (row["answer"], row["right"]) for key, row in table.iterrows()}
    assert told == {
        ("gncc", "brick-a"): ("exact", True),
        ("gncc", "brick-b"): ("supercell 2", False),
        ("gncc", "brick-c"): ("none", False),
        ("gncc", "noise"): ("none", True),
        (HOSTILE, "brick-a"): ("wrong", False),
        (HOSTILE, "brick-b"): ("exact", True),
        (HOSTILE, "brick-c"): ("failed", False),
        (HOSTILE, "noise"): ("false lattice", False),
    }


def test_a_detection_that_several_methods_used_counts_once(asked: Run) -> None:
    """One row a detector and draw, in the run's order."""
    table = answers(asked)
    assert not table.duplicated(["detector", "texture", "replicate"]).any()
    assert list(table["texture"][:3]) == ["brick-a", "brick-b", "brick-c"]


def test_what_is_not_known_is_left_out(asked: Run) -> None:
    """Methods' own lattices, draws not run yet, and photographs without a given lattice are in no row."""
    assert not {"brick-d", "photograph"} & set(answers(asked)["texture"])
    assert set(answers(asked)["detector"]) == {"gncc", HOSTILE}


def test_rates_are_those_of_the_answers(asked: Run) -> None:
    """Exact over draws that have a lattice, false lattices over those that have none, each with Wilson's interval."""
    found = detectors(asked)
    assert found is not None
    gncc, hostile = found.trusts
    assert (gncc.exact.value, gncc.exact.n, (gncc.exact.low, gncc.exact.high)) == (
        pytest.approx(1 / 3),
        3,
        wilson(1, 3),
    )
    assert (gncc.false.value, hostile.false.value) == (0, 1)
    assert gncc.kinds == {"exact": 1, "supercell": 1, "subcell": 0, "wrong": 0, "none": 1, "failed": 0}
    assert gncc.seconds == pytest.approx(0.375) and gncc.slowest == 0.5
    assert gncc.vector_error == pytest.approx(0, abs=1e-9)
    assert (gncc.calibration.n, hostile.calibration.n) == (2, 3)
    assert set(gncc.families) == {"bricks"}


def test_groups_are_by_family_departure_and_level(asked: Run) -> None:
    """Departures and levels come from the suite's rows; a stochastic texture is a departure of its own."""
    found = detectors(asked)
    assert found is not None
    assert [(one.family, one.departure) for one in found.groups] == [
        ("bricks", "color"),
        ("bricks", "noise"),
        ("noise", "stochastic"),
    ]
    assert found.groups[0].places["gncc"].value == 0.5 and found.groups[2].places["gncc"].value == 1
    assert [one.level for one in found.levels] == [0.3, 0.6, 0.1]


def test_a_run_without_detectors_has_none(every_ending: Run) -> None:
    """Nothing is said of detectors, in any format."""
    assert detectors(every_ending) is None and answers(every_ending).empty
    assert 'id="detectors"' not in HtmlReport().render(every_ending, every_ending.root)
    assert "calibration" not in TextTable().render(every_ending)


def test_csv_tables(asked: Run, tmp_path: Path) -> None:
    """One row an answer, and one a detector and group; an empty cell stands for all that have a lattice."""
    paths = {path.name: path for path in CsvTables().write(asked, tmp_path / "tables")}
    assert len(pd.read_csv(paths["detections.csv"])) == 8
    table = pd.read_csv(paths["detectors.csv"])
    whole = table[table["family"].isna()].set_index("detector")
    assert whole.loc["gncc", "n"] == 3 and whole.loc["gncc", "share_right"] == pytest.approx(1 / 3)
    one = detectors_table(answers(asked)).set_index(["detector", "family", "departure", "level"]).loc["gncc"]
    assert one.loc[("bricks", "color", 0.6)]["right"] == 0 and one.loc[("bricks", "color", 0.3)]["right"] == 1


def test_the_page_has_a_section(asked: Run) -> None:
    """A table, the groups, a diagram for each detector, escaped names."""
    page = HtmlReport().render(asked, asked.root)
    assert 'id="detectors"' in page and 'href="#detectors"' in page
    assert page.count('class="reliability"') == 2 and "1 of 3" in page
    assert 'onerror="alert(1)"' not in page and 'id="comparison"' in page


def test_without_a_verdict_there_is_no_comparison(asked: Run) -> None:
    """Where the suite's metrics judge no regularity, page and terminal show the detectors alone."""
    vars(asked)["columns"] = ONLY_COST
    page, text = HtmlReport().render(asked, asked.root), TextTable().render(asked)
    assert 'id="comparison"' not in page and 'href="#summary"' not in page and 'class="outputs"' not in page
    assert 'id="detectors"' in page and 'id="gallery"' in page
    assert "regularity.score" not in text and "33 % (1/3)" in text
