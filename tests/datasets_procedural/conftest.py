"""The models that the tests share, and their variants."""

import dataclasses
import typing
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from nrbench import plugins
from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Texture

MODELS = [
    plugin.cls for plugin in plugins.inventory("datasets") if plugin.cls is not None and issubclass(plugin.cls, Model)
]
NONE: dict[str, Any] = {"color": 0.0, "intensity": 0.0, "noise": 0.0}


def _variants() -> Iterator[Any]:
    """Yield each model with its defaults, and once for each other word of each of its choices."""
    further: list[tuple[type[Model], dict[str, Any]]] = [(Brick, {"small_every": 6}), (Brick, {"small_every": 3})]
    for model in MODELS:
        yield pytest.param(model, {}, id=model.__name__)
        hints = typing.get_type_hints(model)
        for field in dataclasses.fields(model):
            for word in typing.get_args(hints[field.name]) if isinstance(field.default, str) else ():
                if word != field.default:
                    further.append((model, {field.name: word}))
    for model, words in further:
        yield pytest.param(model, words, id=f"{model.__name__}-{next(iter(words.values()))}")


VARIANTS = list(_variants())


def render(model: Model, seed: int = 0, side: int = 128) -> Texture:
    """Return a square draw."""
    return model.render((side, side), np.random.default_rng(seed))


def without_share(model: Model) -> Model:
    """Return the model with a made-up regular share: measuring it under jitter takes longer than many draws."""
    copy = dataclasses.replace(model)
    vars(copy)["regular_share"] = 0.5
    return copy


def truth(texture: Texture) -> tuple[Lattice, Image]:
    """Return the lattice and the ideal image of a texture that has them."""
    assert texture.lattice is not None and texture.ideal is not None
    return texture.lattice, texture.ideal
