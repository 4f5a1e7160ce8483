"""Every report fulfils every clause of its form."""

from __future__ import annotations

from pathlib import Path

import pytest
from conformance import example_run as example_run
from conformance import violations

from nrbench import plugins


@pytest.mark.parametrize("name", [plugin.name for plugin in plugins.inventory("reports") if plugin.built_in])
def test_a_report_conforms(name: str, example_run: Path) -> None:
    """The report fails no clause; that of the terminal alone is printed, and some formats have no markup."""
    slow = ("randomness", "side effects") if name in ("perils", "html") else ()
    skipped = ("terminal", "markup") if name in ("figure", "json", "text") else ("terminal",)
    others = {"changes": {"baseline": str(example_run)}, "site": {"runs": [str(example_run)]}}
    parameters = others.get(name, {})
    assert violations("reports", name, parameters, slow, skipped) == []
