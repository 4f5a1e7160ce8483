"""Claims about bad parameters, over all models."""

from __future__ import annotations

import dataclasses
import math
import typing
from typing import Any

import numpy as np
import pytest

from nrbench import plugins
from nrbench.errors import BadInput

MODELS = [plugin for plugin in plugins.inventory("datasets") if plugin.name != "images"]
BAD: dict[type, tuple[Any, ...]] = {float: (0.0, -3.0, math.nan, math.inf, 1e9), int: (-1, 1000), str: ("nonsense",)}


def _numbers() -> list[Any]:
    """Return each parameter of each model that has a length, a number or a word as its value, with each bad one."""
    found = []
    for plugin in MODELS:
        assert plugin.cls is not None
        for field in dataclasses.fields(plugin.cls):
            free = field.name in ("rotation", "hue", "slant", "phase", "motif")
            if not free and field.name not in (
                "color",
                "intensity",
                "noise",
                "light",
                "damage",
                "missing",
                "jitter",
                "bend",
            ):
                found += [
                    pytest.param(plugin.cls, field.name, bad, id=f"{plugin.name}-{field.name}-{bad}")
                    for bad in BAD[type(field.default)]
                    if not (bad == 0.0 and field.name == "contrast")
                ]
    return found


@pytest.mark.parametrize(("model", "name", "bad"), _numbers())
def test_bad_numbers(model: Any, name: str, bad: Any) -> None:
    """A length of zero, negative, endless or no number, and a word or count that is not known, give one line."""
    with pytest.raises(BadInput) as caught:
        model(**{name: bad})
    assert "give" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("shape", [(0, 64), (64, 0), (-1, 64), (100000, 100000), (1, 10**9)])
@pytest.mark.parametrize("plugin", MODELS, ids=lambda plugin: plugin.name)
def test_bad_shapes(plugin: plugins.Plugin, shape: tuple[int, int]) -> None:
    """A picture without pixels, and one that fills the memory, are refused before anything is drawn."""
    model = plugin.cls() if plugin.cls else None
    with pytest.raises(BadInput, match=f"shape {shape[1]}x{shape[0]} px .*give at"):
        typing.cast(Any, model).render(shape, np.random.default_rng(0))


@pytest.mark.parametrize("plugin", MODELS, ids=lambda plugin: plugin.name)
def test_tiny_pictures(plugin: plugins.Plugin) -> None:
    """A picture of one pixel, and a line, are drawn."""
    for shape in ((1, 1), (1, 40), (40, 1)):
        texture = typing.cast(Any, plugin.cls)().render(shape, np.random.default_rng(0))
        assert texture.image.shape == (*shape, 3) and texture.image.dtype == np.float32
