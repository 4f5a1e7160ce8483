"""The lattice axis: detectors and manual lattices as sources, and the results of detectors in the tables."""

from pathlib import Path

import pytest

from nrbench import run
from nrbench.errors import BadInput
from nrbench.running.runner import Options, find_metrics
from nrbench.runs.records import Run
from nrbench.suites.plan import LatticeSource, make_plan
from nrbench.suites.suite import Suite, load_suite, validated_suite

BRICK = {"name": "brick", "dataset": "brick", "parameters": {"color": 0.1}}
METHODS = ("lattice-only", "rsgf:block=24,border=6,finder=gncc", "tiling")
NOISE = {"name": "noise", "dataset": "noise", "parameters": {"spectrum": "pink"}}


def suite(*lattice: str, methods: tuple[str, ...] = ("lattice-only",), **more: object) -> Suite:
    """Return a suite of a brick wall and a noise."""
    axes = {"methods": methods, "lattice": lattice, "sample": "96x96", "size": "96x96"}
    content = {"name": "axis", "texture": [BRICK, NOISE], "metrics": ["lattice_recovery", "cost"], **axes, **more}
    return validated_suite(content, "axis")


@pytest.fixture(scope="module")
def gncc_run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Return a run with the detector gncc, of a method that needs a lattice and two methods that do not."""
    return run(suite("gncc", methods=METHODS), out=tmp_path_factory.mktemp("gncc"), options=Options(jobs=0))


def test_a_manual_lattice_is_a_source_of_its_own() -> None:
    """The numbers of the lattice are the name of the source; the method gets it, and it is part of the key."""
    cells = {cell.lattice_source: cell for cell, _ in make_plan(suite("27.3,0,13.65,12.2", "30,0,0,20", "own")).cells}
    given = cells["27.3,0,13.65,12.2"].lattice_given
    assert given is not None and (given.t1, given.t2) == ((27.3, 0.0), (13.65, 12.2))
    assert cells["own"].lattice_given is None
    assert len({cell.key for cell in cells.values()}) == 3


def test_a_manual_origin_reaches_the_method() -> None:
    """Six numbers are another source than four: the method gets the origin, and it is part of name and key."""
    cells = [cell for cell, _ in make_plan(suite("30,0,0,20", "30,0,0,20,7,3.5")).cells if cell.texture == "brick"]
    assert [cell.lattice_source for cell in cells] == ["30,0,0,20", "30,0,0,20,7,3.5"]
    assert [cell.lattice_given.origin for cell in cells if cell.lattice_given] == [(0.0, 0.0), (7.0, 3.5)]
    assert cells[0].key != cells[1].key


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("3,0,6", "four numbers"),
        ("3,0,6,0", "parallel"),
        ("none", "use one of: given, own, x1,y1,x2,y2"),
        ("gnc", "is not known; use one of"),
    ],
)
def test_bad_sources(text: str, message: str) -> None:
    """A text that is no keyword, lattice or detector is refused; the message lists the valid forms."""
    with pytest.raises(BadInput, match=message):
        LatticeSource.parse(text)


def test_a_detector_with_parameters_is_no_manual_lattice() -> None:
    """Commas after a colon separate parameters."""
    source = LatticeSource.parse("gncc:alpha=1.3,overlap=0.8")
    assert source.lattice is None and source.detector is not None and source.detector[2]["overlap"] == 0.8


def test_the_result_of_a_detector_is_in_the_record(gncc_run: Run) -> None:
    """The record has a lattice with confidence and seconds, or the reason why there is none."""
    records = {(record.texture, record.cell.method): record.cell.detected for record in gncc_run.cells}
    found, none = records["brick", "lattice-only"], records["noise", "lattice-only"]
    assert found is not None and found.lattice is not None and found.confidence is not None and found.seconds > 0
    assert none is not None and none.lattice is None and "chance" in none.reason and none.seconds > 0
    assert records["noise", "tiling"] == none


def test_without_a_lattice_only_methods_that_need_one_are_refused(gncc_run: Run) -> None:
    """If the detector finds no lattice, methods that need one are refused; the other methods run without."""
    status = {(record.texture, record.cell.method): record.status for record in gncc_run.cells}
    assert status == {
        ("brick", "lattice-only"): "ok",
        ("brick", "rsgf"): "ok",
        ("noise", "lattice-only"): "ok",
        ("noise", "rsgf"): "ok",
        ("brick", "tiling"): "ok",
        ("noise", "tiling"): "refused",
    }


def test_the_detection_is_in_the_tables(gncc_run: Run) -> None:
    """The table says whether a lattice was found and is exact, its confidence and seconds; other metrics are absent."""
    table = gncc_run.table().set_index(["texture", "method"])
    assert {name.partition(".")[0] for name in gncc_run.columns} == {"lattice_recovery", "cost"}
    brick, noise = table.loc[("brick", "lattice-only")], table.loc[("noise", "lattice-only")]
    assert brick["lattice_recovery.found"] and brick["lattice_recovery.exact"]
    assert 0 < brick["lattice_recovery.confidence"] <= 1 and brick["lattice_recovery.vector_error"] < 0.5
    assert noise["lattice_recovery.found"] is False
    assert brick["cost.detection_seconds"] > 0 and noise["cost.detection_seconds"] > 0


def test_metrics_are_the_suites_choice(tmp_path: Path) -> None:
    """A suite can name its metrics; for an unknown one the error names the nearest, and nothing is written."""
    assert find_metrics(["cost", "cost"]) == ["cost"]
    assert {"regularity", "cost"} <= set(find_metrics([]))
    with pytest.raises(BadInput, match="did you mean 'cost'"):
        run(suite("own", metrics=["costs"]), out=tmp_path / "r", options=Options(jobs=0))
    assert not (tmp_path / "r").exists()


def test_metrics_and_departures_are_in_the_hash() -> None:
    """Both change the hash of a suite; unused, they do not."""
    core = load_suite("core")
    limited = core.with_changes(metrics=["cost"])
    rows = [row.model_dump(mode="json") for row in core.texture]
    departures = core.with_changes(texture=[{**rows[0], "departure": "color", "level": 0.0}, *rows[1:]])
    assert len({core.hash, limited.hash, departures.hash}) == 3
    assert limited.with_changes(metrics=[]).hash == core.hash
