"""Every dataset fulfils every clause of its form."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conformance import violations

from nrbench import plugins
from nrbench.imaging.files import write_image

MODELS = [plugin.name for plugin in plugins.inventory("datasets") if plugin.own and plugin.name != "images"]


@pytest.mark.parametrize("name", MODELS)
def test_a_model_conforms(name: str) -> None:
    """The model fails no clause; `noise` has no elements that could be copied."""
    assert violations("datasets", name, {}, (), ("recomposition",) if name == "noise" else ()) == []


def test_pictures_conform(tmp_path: Path) -> None:
    """A picture fails no clause; it has no model that could copy elements."""
    write_image(tmp_path / "one.png", np.random.default_rng(0).random((240, 260, 3), np.float32))
    assert violations("datasets", "images", {"path": str(tmp_path / "one.png")}, (), ("recomposition",)) == []
