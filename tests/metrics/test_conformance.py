"""Every metric fulfils every clause of its form."""

from __future__ import annotations

import pytest
from conformance import violations

from nrbench import plugins

SLOW = dict.fromkeys(("quality", "integrity", "randomness", "regularity"), ("randomness", "side effects"))


@pytest.mark.parametrize("name", [plugin.name for plugin in plugins.inventory("metrics") if plugin.own])
def test_a_metric_conforms(name: str) -> None:
    """The metric fails no clause."""
    assert violations("metrics", name, {}, SLOW.get(name, ())) == []
