"""Claims about the perfectly regular textures of the 2004 report."""

from pathlib import Path

import pytest

from nrbench.api import changed, run
from nrbench.running.runner import Options
from nrbench.suites.suite import load_suite


@pytest.mark.parametrize("method", ["quilting", "patch-based"])
def test_the_regular_figures_are_preserved(method: str, tmp_path: Path) -> None:
    """On figures 3 to 7 the verdict on the default output is: preserved (Table 2 of the report)."""
    suite = changed(load_suite("report2004"), [method], ["given"], metrics=["regularity"])
    cells = run(suite, out=tmp_path / "run", textures=["figure-0[3-7]-*"], options=Options(jobs=0)).cells
    assert len(cells) == 5
    for cell in cells:
        assert cell.values["regularity.preserved"] is True, cell.texture
