"""Every report fulfils every clause of its form."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from conformance import violations

from nrbench import plugins
from nrbench.authoring import conformance


@pytest.fixture(autouse=True, scope="module")
def one_run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Make the run of the clauses once."""
    made = conformance.make_example_run(tmp_path_factory.mktemp("reports") / "run")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(conformance, "make_example_run", lambda root: made)
        yield made


@pytest.mark.parametrize("name", [plugin.name for plugin in plugins.inventory("reports") if plugin.own])
def test_a_report_conforms(name: str, one_run: Path) -> None:
    """The report fails no clause; that of the terminal alone is printed, and some formats have no markup."""
    slow = ("randomness", "side effects") if name in ("perils", "html") else ()
    skipped = ("terminal", "markup") if name in ("figure", "json", "text") else ("terminal",)
    others = {"changes": {"baseline": str(one_run)}, "site": {"runs": [str(one_run)]}}
    parameters = others.get(name, {})
    assert violations("reports", name, parameters, slow, skipped) == []
