"""Answers of detectors: their kinds, their counts with intervals, and the calibration of the confidence."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import FoundLattice
from nrbench.reports.csv import CsvTables
from nrbench.reports.statistics.detections import calibrate, compare_detectors, tabulate_answers
from nrbench.reports.statistics.estimates import estimate_proportion
from nrbench.reports.statistics.frames import detectors_table
from nrbench.runs.records import CellRecord, Run

from .conftest import HOSTILE, TRUTH, Make

WRONG = Lattice((9.9, 1.0), (0.0, 7.7))
DOUBLE = Lattice((17.0, 0.0), (4.25, 6.1))


def _found(lattice: Lattice, confidence: float = 0.8) -> FoundLattice:
    return FoundLattice(lattice, 0.5, confidence=confidence)


NONE = FoundLattice(None, 0.25, "no better than chance")


@pytest.fixture(scope="module")
def answered(makers: tuple[Make, Make]) -> Run:
    """Return a run of two detectors with every kind of answer, used by two methods."""
    make_cell, make_run = makers

    def cell(texture: str, source: str, detected: FoundLattice | None, **more: Any) -> CellRecord:
        detector, method = (source.partition(":")[0], "1", {}), more.pop("method", "lattice-only")
        return make_cell(texture, method, source, detector=detector, detected=detected, reference=True, **more)

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


def test_every_kind_of_answer_has_its_name(answered: Run) -> None:
    """Answers are exact, supercell, none, failed, wrong or a false lattice; right if that is true of the texture."""
    table = tabulate_answers(answered).set_index(["detector", "texture"])
    kinds = {key: (row["answer"], row["right"]) for key, row in table.iterrows()}
    assert kinds == {
        ("gncc", "brick-a"): ("exact", True),
        ("gncc", "brick-b"): ("supercell 2", False),
        ("gncc", "brick-c"): ("none", False),
        ("gncc", "noise"): ("none", True),
        (HOSTILE, "brick-a"): ("wrong", False),
        (HOSTILE, "brick-b"): ("exact", True),
        (HOSTILE, "brick-c"): ("failed", False),
        (HOSTILE, "noise"): ("false lattice", False),
    }


def test_a_detection_that_several_methods_used_counts_once(answered: Run) -> None:
    """One row a detector and draw, in the run's order."""
    table = tabulate_answers(answered)
    assert not table.duplicated(["detector", "texture", "replicate"]).any()
    assert list(table["texture"][:3]) == ["brick-a", "brick-b", "brick-c"]


def test_rates_are_those_of_the_answers(answered: Run) -> None:
    """Exact answers count over draws with a lattice, false lattices over draws without, with Wilson's interval."""
    comparison = compare_detectors(answered)
    gncc, hostile = comparison.summaries.to_dict("records")
    assert (gncc["exact"].value, gncc["exact"].n, (gncc["exact"].low, gncc["exact"].high)) == (
        pytest.approx(1 / 3),
        3,
        estimate_proportion([True, False, False]).ends,
    )
    assert (gncc["false"].value, hostile["false"].value) == (0, 1)
    assert gncc["kinds"] == {"exact": 1, "supercell": 1, "subcell": 0, "wrong": 0, "none": 1, "failed": 0}
    assert gncc["seconds"] == pytest.approx(0.375) and gncc["slowest"] == 0.5
    assert gncc["vector_error"] == pytest.approx(0, abs=1e-9)
    assert (gncc["calibration"].n, hostile["calibration"].n) == (2, 3)
    assert set(gncc["families"]) == {"bricks"}


def test_groups_are_by_family_departure_and_level(answered: Run) -> None:
    """Departures and levels come from the suite's rows; a stochastic texture is a departure of its own."""
    comparison = compare_detectors(answered)
    color, noise = ("bricks", "color"), ("noise", "stochastic")
    assert list(comparison.groups) == [color, ("bricks", "noise"), noise]
    assert (
        comparison.groups[color]["gncc"]["right"].value == 0.5 and comparison.groups[noise]["gncc"]["right"].value == 1
    )
    assert [level for _, _, level in comparison.levels] == [0.3, 0.6, 0.1]


def test_csv_tables(answered: Run, tmp_path: Path) -> None:
    """One row an answer, and one a detector and group; an empty cell stands for all textures with a lattice."""
    paths = {path.name: path for path in CsvTables().write(answered, tmp_path / "tables")}
    assert len(pd.read_csv(paths["detections.csv"])) == 8
    table = pd.read_csv(paths["detectors.csv"])
    whole = table[table["family"].isna()].set_index("detector")
    assert whole.loc["gncc", "n"] == 3 and whole.loc["gncc", "share_right"] == pytest.approx(1 / 3)
    one = (
        detectors_table(tabulate_answers(answered)).set_index(["detector", "family", "departure", "level"]).loc["gncc"]
    )
    assert one.loc[("bricks", "color", 0.6)]["right"] == 0 and one.loc[("bricks", "color", 0.3)]["right"] == 1


def test_calibration_of_known_answers() -> None:
    """One of two answers right at 0.25 and both at 0.95: distances 0.25 and 0.05, mean 0.15."""
    calibration = calibrate(np.array([0.25, 0.25, 0.95, 0.95]), np.array([True, False, True, True]))
    assert calibration.error == pytest.approx(0.15) and calibration.n == 4
    bins = calibration.bins.to_dict("records")
    assert [(one["low"], one["high"], one["right"].n, one["right"].value) for one in bins] == [
        (0.2, 0.3, 2, 0.5),
        (0.9, 1.0, 2, 1.0),
    ]


@settings(max_examples=25)
@given(st.lists(st.tuples(st.floats(0, 1), st.booleans()), min_size=1, max_size=40))
def test_calibration_bins_hold_every_answer_once(pairs: list[tuple[float, bool]]) -> None:
    """The bins hold every answer once, in order; the error lies in [0, 1]; intervals hold their share."""
    calibration = calibrate(np.array([c for c, _ in pairs]), np.array([right for _, right in pairs]))
    bins = calibration.bins.to_dict("records")
    assert sum(one["right"].n for one in bins) == calibration.n == len(pairs)
    assert sum(one["share"] for one in bins) == pytest.approx(1)
    assert calibration.error is not None and 0 <= calibration.error <= 1
    assert [one["low"] for one in bins] == sorted(one["low"] for one in bins)
    for one in bins:
        low, value, high = one["right"].low, one["right"].value, one["right"].high
        assert low is not None and value is not None and high is not None and low <= value <= high
