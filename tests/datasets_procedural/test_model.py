"""Claims that every texture model must keep: its elements, its fresh draws, its streams."""

from __future__ import annotations

import dataclasses
import inspect
import math
import subprocess
import sys
import typing
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from nrbench import plugins
from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.errors import BadInput
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Texture

from .conftest import MODELS, NONE, VARIANTS, render, truth, without_share


@pytest.mark.parametrize(("model", "words"), VARIANTS)
def test_elements_share_pixels_fairly(model: type[Model], words: dict[str, Any]) -> None:
    """Layers cover between none and all of a pixel, and each element is dark enough to vary by half unclipped."""
    made = model(**words)
    pattern = made.pattern(*np.random.default_rng(0).uniform(-80, 80, (2, 4000)))
    covered = np.sum([layer.coverage for layer in pattern.layers], 0)
    assert covered.min() >= -1e-9 and covered.max() <= 1 + 1e-9
    assert all((layer.coverage >= -1e-9).all() for layer in pattern.layers)
    assert all(np.quantile(layer.paint(), 0.99) < 0.66 for layer in pattern.layers)


@pytest.mark.parametrize("model", MODELS)
def test_rotation_turns_the_picture(model: type[Model]) -> None:
    """Turned by 90 degrees, the ideal image is the upright one turned about the origin, clockwise."""
    side = 96
    corner = Lattice(*model(**NONE).vectors).to_cell((0.0, side - 1.0))
    upright = render(model(phase=(float(corner[0]), float(corner[1])), **NONE), side=side)
    turned = render(model(phase=(0.0, 0.0), rotation=90.0, **NONE), side=side)
    assert np.abs(np.rot90(upright.image, -1) - turned.image).max() < 1e-5


@pytest.mark.parametrize("model", MODELS)
def test_phase(model: type[Model]) -> None:
    """The phase is drawn over the whole cell unless it is given, and then the lattice starts there."""
    fixed, free = truth(render(model(phase=(0.25, 0.5)), side=8))[0], model()
    np.testing.assert_allclose(fixed.to_cell((0, 0)), (-0.25, -0.5), atol=1e-12)
    drawn = np.array([-truth(render(free, seed, 8))[0].to_cell((0, 0)) for seed in range(60)])
    assert np.all(np.abs(drawn.mean(0) - 0.5) < 0.15) and drawn.min() >= -1e-9 and drawn.max() < 1


@pytest.mark.parametrize("model", MODELS)
def test_again(model: type[Model]) -> None:
    """Another draw keeps lattice, origin and ideal image, at any shape, and nothing of the departures."""
    made = model(rotation=5.0)
    texture = render(made, side=160)
    other = made.again(texture, (200, 160), np.random.default_rng(9))
    assert other.lattice == texture.lattice and other.image.shape == (200, 160, 3)
    np.testing.assert_array_equal(truth(other)[1][:160], truth(texture)[1])
    residuals = [(one.image[:160] - truth(texture)[1]).ravel() for one in (texture, other)]
    assert abs(np.corrcoef(residuals)[0, 1]) < 0.25
    windows = np.lib.stride_tricks.sliding_window_view(texture.image[..., 0], (16, 16))[::4, ::4]
    assert not any((other.image[16:32, 16:32, 0] == window).all() for row in windows for window in row)


def test_again_needs_a_lattice() -> None:
    """A texture without a lattice is refused: no model here rendered it."""
    with pytest.raises(BadInput, match="pass one that this model rendered"):
        Brick().again(Texture(np.zeros((8, 8, 3), np.float32)), (8, 8), np.random.default_rng(0))


@pytest.mark.parametrize("model", MODELS)
def test_larger_render_continues_the_smaller(model: type[Model]) -> None:
    """One stream at two shapes gives one texture, departures included: the smaller is the larger's corner."""
    made = without_share(model(rotation=12.0, light=0.3, damage=0.2, missing=0.1, jitter=0.3, bend=0.3))
    small, large = (made.render(shape, np.random.default_rng(4)) for shape in ((50, 70), (120, 90)))
    np.testing.assert_array_equal(small.image, large.image[:50, :70])
    assert small.displacement is not None and large.displacement is not None
    np.testing.assert_array_equal(small.displacement, large.displacement[:50, :70])
    assert small.lattice == large.lattice


def test_equal_seeds_equal_bytes() -> None:
    """Another process renders the same bytes from the same seed; another seed renders others."""
    program = inspect.getsource(_hashes) + "print(_hashes(3))"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    first, other = _hashes(3), _hashes(4)
    assert run.stdout.strip() == str(first) and len(first) == len(MODELS) + 1
    assert not set(first.values()) & set(other.values())


def _hashes(seed):  # type: ignore[no-untyped-def]
    """Return the hash of a draw of each model; another process runs this text."""
    import hashlib

    import numpy

    from nrbench import plugins

    hashes = {}
    for plugin in plugins.inventory("datasets"):
        if plugin.name != "images":
            more = {} if plugin.name == "noise" else {"jitter": 0.2, "bend": 0.2, "damage": 0.2, "light": 0.3}
            model = plugin.cls(rotation=7.0, **more)
            vars(model)["regular_share"] = 0.5  # measuring it would take longer than all draws
            image = model.render((40, 60), numpy.random.default_rng(seed)).image
            hashes[plugin.name] = hashlib.sha256(image.tobytes()).hexdigest()
    return hashes


@pytest.mark.parametrize("model", MODELS)
def test_elements_have_their_strength(model: type[Model]) -> None:
    """Element factors have mean 1, half the strength as standard deviation, and independent channels."""
    made = model(color=0.4, intensity=0.0, noise=0.0)
    elements = [render(made, seed, 256).elements for seed in range(6)]
    factor = np.concatenate([array for one in elements for name, array in one.items() if name.endswith(".factor")])
    assert factor.mean() == pytest.approx(1, abs=0.05) and factor.std() == pytest.approx(0.2, rel=0.1)
    assert np.abs(factor - 1).max() <= 0.2 * math.sqrt(3)
    assert np.abs(np.corrcoef(factor.T) - np.eye(3)).max() < 0.2


@pytest.mark.parametrize("model", MODELS)
def test_intensity_is_common_to_the_channels(model: type[Model]) -> None:
    """Intensity multiplies all channels of an element by the same factor."""
    elements = render(model(color=0.0, intensity=0.4, noise=0.0)).elements
    for name in (name for name in elements if name.endswith(".factor")):
        assert (elements[name] == elements[name][:, :1]).all() and elements[name].std() > 0.1


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"color": 1.2}, "color is 1.2; give a strength from 0 to 1"),
        ({"noise": -0.1}, "noise is -0.1; give a strength"),
        ({"intensity": math.nan}, "intensity is nan; give a strength"),
        ({"rotation": math.inf}, "rotation is inf; give degrees"),
        ({"phase": (0.0, math.nan)}, "phase .* two fractions"),
    ],
)
def test_bad_departures(parameters: dict[str, Any], message: str) -> None:
    """A strength outside [0, 1], or an angle or phase that is no number, is refused with what to give."""
    with pytest.raises(BadInput, match=message):
        Brick(**parameters)


@pytest.mark.parametrize("model", MODELS)
def test_page_tells_all_parameters(model: type[Model]) -> None:
    """A model's page has its own parameters and those that all models share, under one heading."""
    page = model.__doc__ or ""
    assert page.count("Parameters\n") == 1
    assert all(field.name in page for field in dataclasses.fields(model))


DATASETS = [plugin for plugin in plugins.inventory("datasets") if plugin.name != "images"]
BAD: dict[type, tuple[Any, ...]] = {float: (0.0, -3.0, math.nan, math.inf, 1e9), int: (-1, 1000), str: ("nonsense",)}


FREE = {"rotation", "hue", "slant", "phase", "motif"} | {field.name for field in dataclasses.fields(Model)}


def _numbers() -> Iterator[Any]:
    """Yield each parameter of each model that has a length, a number or a word as its value, with each bad one."""
    for plugin in DATASETS:
        assert plugin.cls is not None
        for field in dataclasses.fields(plugin.cls):
            for bad in BAD[type(field.default)] if field.name not in FREE else ():
                if (bad, field.name) != (0.0, "contrast"):
                    yield pytest.param(plugin.cls, field.name, bad, id=f"{plugin.name}-{field.name}-{bad}")


@pytest.mark.parametrize(("model", "name", "bad"), list(_numbers()))
def test_bad_numbers(model: Any, name: str, bad: Any) -> None:
    """A length of zero, negative, endless or no number, and a word or count that is not known, give one line."""
    with pytest.raises(BadInput) as caught:
        model(**{name: bad})
    assert "give" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("shape", [(0, 64), (64, 0), (-1, 64), (100000, 100000), (1, 10**9)])
@pytest.mark.parametrize("plugin", DATASETS, ids=lambda plugin: plugin.name)
def test_bad_shapes(plugin: plugins.Plugin, shape: tuple[int, int]) -> None:
    """A picture without pixels, and one that fills the memory, are refused before anything is drawn."""
    model = plugin.cls() if plugin.cls else None
    with pytest.raises(BadInput, match=f"shape {shape[1]}x{shape[0]} px .*give at"):
        typing.cast(Any, model).render(shape, np.random.default_rng(0))


@pytest.mark.parametrize("plugin", DATASETS, ids=lambda plugin: plugin.name)
def test_tiny_pictures(plugin: plugins.Plugin) -> None:
    """A picture of one pixel, and a line, are drawn."""
    for shape in ((1, 1), (1, 40), (40, 1)):
        texture = typing.cast(Any, plugin.cls)().render(shape, np.random.default_rng(0))
        assert texture.image.shape == (*shape, 3) and texture.image.dtype == np.float32
