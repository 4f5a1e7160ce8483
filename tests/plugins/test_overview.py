"""The overview of plugins, which reads those of nrbench from their source."""

from __future__ import annotations

import inspect

import pytest

from nrbench import plugins
from nrbench.plugins.overview import summaries

pytestmark = pytest.mark.parametrize("kind", plugins.FORMS)


def test_the_overview_agrees_with_the_classes(kind: str) -> None:
    """Name, version, first line and role that are read from the source are those of the imported class."""
    read = {each.name: each for each in summaries(kind) if each.distribution == "nrbench"}
    loaded = [plugin for plugin in plugins.inventory(kind) if plugin.own]
    assert loaded and set(read) == {plugin.name for plugin in loaded}
    for plugin in loaded:
        page = (inspect.getdoc(plugin.cls) or "").partition("\n")[0]
        shown = read[plugin.name]
        assert (shown.version, shown.about, shown.error) == (plugin.version, page, "")
        assert shown.reference == bool(getattr(plugin.cls, "reference", False))


def test_the_plugins_of_nrbench_keep_their_forms(kind: str) -> None:
    """The plugins of nrbench have no fault. They are not checked again when they are loaded."""
    for plugin in plugins.inventory(kind):
        assert plugins.fault(kind, plugin.cls) == "", plugin.name
