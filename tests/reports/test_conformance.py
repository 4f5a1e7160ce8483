"""Every report fulfils every clause of its form."""

from pathlib import Path

import pytest
from conformance import example_run as example_run
from conformance import violations

from nrbench import plugins


@pytest.mark.parametrize("name", [plugin.name for plugin in plugins.inventory("reports") if plugin.built_in])
def test_a_report_conforms(name: str, example_run: Path) -> None:
    """The report fails no clause; one alone is for the terminal. That plots are the same again, their tests claim."""
    slow = {"perils": ("determinism", "randomness"), "figure": ("determinism",), "html": ("randomness",)}
    others = {"changes": {"baseline": str(example_run)}, "site": {"runs": [str(example_run)]}}
    assert violations("reports", name, others.get(name, {}), slow.get(name, ()), ("terminal",)) == []
