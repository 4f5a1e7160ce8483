"""How far the ranking depends on choices."""

from pathlib import Path

import numpy as np
import pytest

from nrbench.errors import BadInput
from nrbench.reports.robustness import RankingRobustness
from nrbench.runs.records import Run

from .conftest import PERILS, Make, cell_maker, run_maker


def _run(root: Path, shift: float = 0.0) -> Run:
    """Return a run of seven textures: a lucky first on one of them, an even second, and a third that is far behind."""
    make: Make = cell_maker(root)
    cells = []
    for i in range(7):
        first = dict.fromkeys(PERILS, 0.5 - shift) | ({"integrity": 1.0} if i else dict.fromkeys(PERILS, 1.0))
        cells.append(make(f"t{i}", "lucky", perils=first))
        cells.append(make(f"t{i}", "even", perils=0.52))
        cells.append(make(f"t{i}", "last", status="refused") if i == 3 else make(f"t{i}", "last", perils=0.2))
    return run_maker(root)(cells)


def test_a_texture_that_decides_is_found(tmp_path: Path) -> None:
    """The first place rests on one texture, and the median does not see it; the last place is settled."""
    table = RankingRobustness().table(_run(tmp_path / "run")).set_index("ranking")
    assert list(table.loc["as in the tables"]) == [1.0, 1, 2, 3]
    assert list(table.loc["without t0", ["lucky (own)", "even (own)"]]) == [2, 1]
    assert list(table.loc["median over textures", ["lucky (own)", "even (own)"]]) == [2, 1]
    assert table.loc["without t0", "tau"] == pytest.approx(1 / 3)
    assert (table["last (own)"] == 3).all() and len(table) == 6 + 7
    assert np.isfinite(table["tau"]).all()


def test_the_page_says_what_is_settled(tmp_path: Path) -> None:
    """The files name the settled places; a run with one method says that there is no ranking."""
    paths = RankingRobustness().write(_run(tmp_path / "run"), tmp_path)
    text = next(path for path in paths if path.suffix == ".md").read_text("utf-8")
    assert "Settled places: last (own) (3)." in text and "lucky (own) (1 to 2)" in text
    alone = run_maker(tmp_path)([cell_maker(tmp_path)("a", perils=0.5)])
    texts = [path.read_text("utf-8") for path in RankingRobustness().write(alone, tmp_path)]
    assert texts == ["ranking,tau\n", "Fewer than two methods are ranked.\n"]


def test_another_seed_is_a_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another run is ranked over the same methods; one that lacks a method is refused by name."""
    other, short = _run(tmp_path / "other", 0.4), _run(tmp_path / "short")
    vars(short)["cells"] = [record for record in short.cells if record.method != "even"]
    monkeypatch.setattr("nrbench.reports.robustness.Run", lambda root: other if root.name == "other" else short)
    table = RankingRobustness(runs=(Path("other"),)).table(_run(tmp_path / "run")).set_index("ranking")
    assert list(table.loc["run other", ["lucky (own)", "even (own)", "last (own)"]]) == [2, 1, 3]
    with pytest.raises(BadInput, match="no method even"):
        RankingRobustness(runs=(Path("short"),)).table(_run(tmp_path / "run"))
