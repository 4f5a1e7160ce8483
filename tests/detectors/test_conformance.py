"""Every detector fulfils every clause of its form."""

from __future__ import annotations

import pytest
from conformance import violations

from nrbench import plugins

CHEAP = {"frdft": {"reject": "none"}, "ssdn": {"surrogates": 8}, "dominance": {}}


@pytest.mark.parametrize("name", [plugin.name for plugin in plugins.inventory("detectors") if plugin.own])
def test_a_detector_conforms(name: str) -> None:
    """The detector fails no clause."""
    assert violations("detectors", name, CHEAP.get(name, {})) == []
