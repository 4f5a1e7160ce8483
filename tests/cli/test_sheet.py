"""All methods on one photograph, tileable outputs, and the files that synth announces."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from bent_pictures import tilted
from commands import answer_json, call, refusal

import nrbench
from nrbench import plugins
from nrbench.api import photo_sheet
from nrbench.api.photo_sheet import describe_row, photo_suite, prepare_photo, rate_outputs
from nrbench.imaging.mean_tile import explained_share
from nrbench.running.runner import Step
from nrbench.runs.records import CellRecord

NAMED = photo_sheet.NamedDetector


class _Blind:
    """A detector that finds nothing."""

    def detect(self, image: Any) -> Any:
        """Find nothing."""
        raise nrbench.NoLatticeFound("nothing is seen")


@pytest.fixture
def wall() -> nrbench.Texture:
    """Write ``wall.png`` into the current folder."""
    wall = nrbench.texture("brick", shape=(96, 96), seed=0, color=0.2, width=32, height=16)
    nrbench.write_image(Path("wall.png"), wall.image)
    return wall


def test_a_sheet_shows_each_method_and_tells_why_one_is_missing(
    wall: nrbench.Texture, capsys: pytest.CaptureFixture[str]
) -> None:
    """The sheet holds the sample and the outputs; a method without one is printed with the reason."""
    chosen = "-m scatter -m rsgf:block=90 --lattice 32,0,16,16 --size 64x64 --jobs 0"
    assert call(f"sheet wall.png -o sheet.png {chosen}") == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[0].startswith("scatter  quality ")
    assert printed[1].startswith("rsgf:block=90  refused: the sample is 96x96 px")
    sheet = nrbench.read_image(Path("sheet.png"))
    assert sheet.shape[1] > 2 * 96
    spots = np.argwhere((np.abs(sheet - [1, 1, 1]).max(-1) > 0.05).any(0)).ravel()
    assert np.ptp(spots) > 96 + 64, "two pictures side by side"
    lattice, options = nrbench.Lattice((32, 0), (16, 16)), nrbench.Options(jobs=0)
    table = nrbench.sheet(wall, "own.png", methods="scatter", size=(64, 64), lattice=lattice, options=options)
    assert table["method"].tolist() == ["scatter"] and f"quality {table['quality'][0]:.2f}" in printed[0]
    np.testing.assert_array_equal(nrbench.read_image(Path("own.png"))[-60:], sheet[-60:])


def _record(method: str, **perils: float | str) -> CellRecord:
    """Return a cell with a quality: perils that are left out are 1, and those with a reason are None."""
    known = {"regularity": 1.0, "integrity": 1.0, "randomness": 1.0, "appearance": 1.0, **perils}
    reasons = {f"quality.{name}": value for name, value in known.items() if isinstance(value, str)}
    scores = [value for value in known.values() if not isinstance(value, str)]
    values: dict[str, float | bool | None] = {
        f"quality.{name}": None if isinstance(value, str) else value for name, value in known.items()
    }
    told = all(reason.startswith("not applicable") for reason in reasons.values())
    values |= {"quality.score": min(scores), "quality.complete": told or min(scores) == 0}
    fields = {"method": method, "status": "ok", "seconds": 1.0, "message": "", "values": values, "reasons": reasons}
    return SimpleNamespace(**fields)


def _ranks(*records: CellRecord) -> dict[str, str]:
    return {row["method"]: row["rank"] for _, row in rate_outputs(records)}


UNKNOWN, ABSENT = "too few cells", "not applicable: joined elements look whole"


def test_measured_qualities_have_ranks() -> None:
    """Qualities at least 0.1 apart have an order; others are tied, and equal ones stand in alphabetical order."""
    records = [_record("d", regularity=0.2), _record("c", appearance=0.702), _record("b", regularity=0.698)]
    assert list(_ranks(*records, _record("a")).items()) == [("a", "1"), ("b", "2-3"), ("c", "2-3"), ("d", "4")]
    tied = rate_outputs(records)[0][1]
    assert tied["tied"] == ["c"] and tied["why"] == "less than 0.10 apart"
    chain = [_record(f"{value:.2f}", randomness=value) for value in (0.95, 0.86, 0.80, 0.70)]
    assert _ranks(*chain) == {"0.95": "1-2", "0.86": "1-3", "0.80": "2-3", "0.70": "4"}


def test_equal_upper_bounds_are_tied_with_the_reason() -> None:
    """Outputs of which one peril cannot be told are compared by the others; 0 stands below them."""
    bounds = [_record(name, integrity=UNKNOWN) for name in "ab"]
    rated = rate_outputs([_record("d", regularity=0.0, integrity=UNKNOWN), *bounds])
    assert [row["rank"] for _, row in rated] == ["1-2", "1-2", "3"]
    assert [row["why"] for _, row in rated] == ["integrity cannot be told"] * 2 + [""]
    text = describe_row(rated[0][1])
    assert text == "a\nquality at most 1.00, rank 1-2, 1.0 s\ntied: integrity cannot be told"
    assert _ranks(*bounds, _record("c", integrity=UNKNOWN, randomness=0.4))["c"] == "3"


def test_an_upper_bound_is_above_no_measured_quality() -> None:
    """An upper bound is below a higher measured quality, and tied with a lower one and with bounds of another kind."""
    records = [_record("bound", integrity=UNKNOWN, randomness=0.6), _record("low", regularity=0.3), _record("high")]
    assert _ranks(*records) == {"high": "1", "bound": "2-3", "low": "2-3"}
    assert rate_outputs(records)[2][1]["why"] == "integrity cannot be told"
    assert _ranks(records[0], _record("other", randomness=UNKNOWN)) == {"bound": "1-2", "other": "1-2"}


def test_no_peril_is_no_upper_bound() -> None:
    """A peril that does not exist on the photograph leaves the quality measured, and is named."""
    row = rate_outputs([_record("a", integrity=ABSENT)])[0][1]
    assert not row["upper_bound"] and row["not_measured"] == [] and row["no_peril"] == ["integrity"]
    assert describe_row(row) == "a\nquality 1.00, rank 1, 1.0 s\nno peril: integrity"


def test_an_output_without_a_quality_has_no_rank() -> None:
    """It stands below the others, with the reason."""
    record = _record("a")
    vars(record).update(values={"quality.score": None}, reasons={"quality.score": "undecided: too few cells"})
    (_, first), (_, last) = rate_outputs([record, _record("b", regularity=0.0)])
    assert (first["method"], first["rank"], last["rank"]) == ("b", "1", "")
    assert describe_row(last) == "a\nquality not measured, 1.0 s\nundecided: too few cells"


def test_the_sheet_prints_json(wall: nrbench.Texture, capsys: pytest.CaptureFixture[str]) -> None:
    """With --json the rows are printed, with rank, ties and reason."""
    (row,) = answer_json(
        capsys, "sheet wall.png -o sheet.png -m scatter --lattice 32,0,16,16 --size 64x64 --jobs 0 --json"
    )
    assert row["method"] == "scatter" and {"rank", "tied", "why", "no_peril", "upper_bound"} <= row.keys()


def test_a_sheet_grows_and_survives_an_interrupt(wall: nrbench.Texture, capsys: pytest.CaptureFixture[str]) -> None:
    """The first output is on the sheet before the second method has ended, and one line names the file."""
    seen = []

    def stop(step: Step) -> None:
        seen.append(nrbench.read_image(Path("own.png")).shape)
        if step.done == 2:
            raise KeyboardInterrupt

    options = nrbench.Options(jobs=0)
    given = nrbench.Lattice((32, 0), (16, 16))
    with pytest.raises(KeyboardInterrupt):
        names = ["scatter", "rsgf", "quilting"]
        nrbench.sheet(wall, "own.png", methods=names, lattice=given, progress=stop, options=options)
    assert seen[0][1] < seen[1][1] and nrbench.read_image(Path("own.png")).shape == seen[1]
    assert capsys.readouterr().err.count("own.png") == 1


def test_a_finished_sheet_is_that_of_all_methods(wall: nrbench.Texture, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the last method refuses the sample, the sheet no longer says that it waits for one."""
    counts = []
    draw = photo_sheet.draw_sheet
    monkeypatch.setattr(photo_sheet, "draw_sheet", lambda *args: counts.append(args[1:]) or draw(*args))
    names = ["scatter", "quilting:block=3000"]
    nrbench.sheet(wall, "own.png", methods=names, size=(64, 64), options=nrbench.Options(jobs=0))
    assert counts[-1] == (2, 2)


def test_methods_on_the_lattice_run_first(wall: nrbench.Texture) -> None:
    """All methods of a sheet that use a lattice stand before those that use none."""
    methods = photo_suite(Path("wall.png"), "96x96", "64x64").methods
    uses = [getattr(plugins.build("synthesizers", name), "uses_lattice", True) for name in methods]
    assert uses == sorted(uses, reverse=True) and len(set(uses)) == 2


def test_a_tileable_output_tells_its_strain(wall: nrbench.Texture, capsys: pytest.CaptureFixture[str]) -> None:
    """The command prints the strain and a better size; wrong methods and sizes exit with 2."""
    assert call("synth wall.png -m tiling --lattice 32,0,16,16 --tileable --size 130x96 -o out.png") == 0
    assert "closes by a strain of 1.5 %, 128x96 would need 0 %" in capsys.readouterr().err
    assert "cartoon cannot make an output that repeats without a seam; ann-pixel, auto, " in refusal(
        capsys, "synth wall.png -m cartoon --tileable --size 128x96 -o out.png"
    )
    assert "use --size 128x96" in refusal(
        capsys, "synth wall.png -m rsgf --lattice 32,0,16,16 --tileable --size 144x96 -o out.png"
    )


@pytest.mark.parametrize("judged", [True, False])
def test_the_lattice_of_a_sheet_is_the_judges_where_it_finds_none(
    wall: nrbench.Texture, monkeypatch: pytest.MonkeyPatch, judged: bool
) -> None:
    """So is one that is given. Where the judge's detector finds a lattice, the truth is not known."""
    if not judged:
        monkeypatch.setattr(photo_sheet, "NamedDetector", lambda name: _Blind() if name == "dominance" else NAMED(name))
    truths: list[Any] = []
    monkeypatch.setattr(
        "nrbench.running.runner.execute", lambda plan, *_: truths.append(plan.cells[0][0].lattice_truth)
    )
    for lattice in (wall.lattice, None):
        nrbench.sheet("wall.png", "sheet.png", methods=["scatter"], lattice=lattice, sample="96x96", size="64x64")
    assert truths[0] is not None and truths[0].is_equivalent(wall.lattice)
    assert (truths[1] is None) == judged


def test_a_bad_output_is_marked(wall: nrbench.Texture) -> None:
    """A caption says BAD and why below half of the quality."""
    rows = {row["method"]: row for _, row in rate_outputs([_record("a", integrity=0.49), _record("b", integrity=0.5)])}
    assert "BAD, worst: integrity" in describe_row(rows["a"]) and "BAD" not in describe_row(rows["b"])


def test_a_sheet_straightens_and_flattens_first(tmp_path: Path) -> None:
    """A wall in perspective is straight in the file that methods and judge get; a straight one is left alone."""
    nrbench.write_image(tmp_path / "tilted.png", tilted(192).image)
    with pytest.warns(UserWarning, match="in perspective"):
        file, lattice = prepare_photo(tmp_path / "tilted.png", None, False, tmp_path)
    assert isinstance(lattice, nrbench.Lattice) and explained_share(nrbench.read_image(file), lattice) > 0.6
    nrbench.write_image(tmp_path / "flat.png", nrbench.texture("weave", shape=(192, 192), seed=0).image)
    assert prepare_photo(tmp_path / "flat.png", None, False, tmp_path) == (tmp_path / "flat.png", None)
    assert prepare_photo(tmp_path / "flat.png", None, True, tmp_path)[0] != tmp_path / "flat.png"
