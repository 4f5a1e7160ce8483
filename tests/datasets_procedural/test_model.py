"""Claims that every texture model must keep, and claims about stochastic textures."""

import dataclasses
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest
from conformance import violations
from scipy import fft

from nrbench import plugins
from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.datasets_procedural.noise import Noise
from nrbench.datasets_procedural.weave import Weave
from nrbench.errors import BadInput
from nrbench.imaging.convert import gray
from nrbench.lattice.geometry import Lattice
from nrbench.pictures.files import write_image
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
    np.testing.assert_array_equal(small.displacement, large.displacement[:50, :70])
    assert small.lattice == large.lattice


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


DATASETS = [plugin for plugin in plugins.inventory("datasets") if plugin.built_in and plugin.name != "images"]
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
    assert re.search("give|choose", str(caught.value)) and "\n" not in str(caught.value)


@pytest.mark.parametrize("shape", [(0, 64), (64, 0), (-1, 64), (100000, 100000), (1, 10**9)])
@pytest.mark.parametrize("plugin", DATASETS, ids=lambda plugin: plugin.name)
def test_bad_shapes(plugin: plugins.Plugin, shape: tuple[int, int]) -> None:
    """A picture without pixels, and one that fills the memory, are refused before anything is drawn."""
    model = plugin.cls() if plugin.cls else None
    with pytest.raises(BadInput, match=f"shape {shape[1]}x{shape[0]} px .*give at"):
        model.render(shape, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("model", "parameters", "message"),
    [
        (Brick, {"color": 1.2}, "color 1.2; choose from 0 to 1"),
        (Brick, {"intensity": math.nan}, "intensity nan; choose"),
        (Brick, {"rotation": math.inf}, "rotation is inf; give degrees"),
        (Brick, {"phase": (0.0, math.nan)}, "phase .* two fractions"),
        (Brick, {"bond": "english", "small_every": 3}, "small_every"),
        *((Brick, each, "choose from") for each in ({"joint": 0.5}, {"width": 3.0}, {"width": 1e6})),
        (Hexagon, {"period": 4.0}, "period 4.0; choose from"),
        (Weave, {"warp": 3.0}, "warp 3.0; choose from"),
        (Noise, {"contrast": 0.5}, "contrast 0.5; choose from 0 to 0.3"),
    ],
)
def test_bad_parameters(model: Any, parameters: dict[str, Any], message: str) -> None:
    """What cannot be drawn, such as an element that its joints swallow, is refused with what to give."""
    with pytest.raises(BadInput, match=message):
        model(**parameters)


@pytest.mark.parametrize("name", [plugin.name for plugin in DATASETS if plugin.built_in])
def test_a_model_conforms(name: str) -> None:
    """The model fails no clause."""
    assert violations("datasets", name) == []


def test_pictures_conform(tmp_path: Path) -> None:
    """A picture fails no clause."""
    write_image(tmp_path / "one.png", np.random.default_rng(0).random((240, 260, 3), np.float32))
    assert violations("datasets", "images", {"path": str(tmp_path / "one.png")}) == []


SPECTRA = get_args(get_type_hints(Noise)["spectrum"])


def _power(noise: Noise, side: int = 256) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Return the mean power by frequency in cycles a px, (fx, fy), of eight draws."""
    draws = [gray(noise.render((side, side), np.random.default_rng(seed)).image) for seed in range(8)]
    window = np.outer(np.hanning(side), np.hanning(side))
    power = np.mean([np.abs(fft.fft2((draw - draw.mean()) * window)) ** 2 for draw in draws], 0)
    return power, np.stack(np.meshgrid(fft.fftfreq(side), fft.fftfreq(side)), -1)


@pytest.mark.parametrize("spectrum", SPECTRA)
def test_truth(spectrum: Any) -> None:
    """Noise says of itself that it is stochastic: no lattice, no regular part, one color as its ideal image."""
    texture = Noise(spectrum=spectrum).render((40, 50), np.random.default_rng(0))
    assert texture.kind == "stochastic" and texture.lattice is None and texture.lattices == ()
    assert texture.regular_share == 0.0 and texture.ideal is not None
    assert texture.ideal.shape == texture.image.shape == (40, 50, 3) and np.ptp(texture.ideal, (0, 1)).max() == 0


@pytest.mark.parametrize("spectrum", SPECTRA)
def test_statistics_agree_between_sizes(spectrum: Any) -> None:
    """Mean and contrast over draws are those stated, at any size, and hardly a value is clipped."""
    noise = Noise(spectrum=spectrum, contrast=0.12)
    for side, draws in ((48, 60), (200, 8)):
        images = np.stack([noise.render((side, side), np.random.default_rng(seed)).image for seed in range(draws)])
        ideal = noise.render((8, 8), np.random.default_rng(0)).ideal
        np.testing.assert_allclose(images.mean((0, 1, 2)), ideal[0, 0], atol=0.03)
        assert gray(images.reshape(-1, side, 3)).std() == pytest.approx(0.12 * 0.98 / 1.1, rel=0.25)
        assert ((images <= 0) | (images >= 1)).mean() < 0.002


def test_spectra() -> None:
    """Power falls as 1 / f (pink) or 1 / f^2 (brown), is level (white), or stands on a ring (blobs)."""
    for spectrum, slope in (("white", 0.0), ("pink", -1.0), ("brown", -2.0)):
        power, f = _power(Noise(spectrum=spectrum, scale=40))
        radius = np.hypot(*np.moveaxis(f, -1, 0))
        low, high = (power[(radius > r) & (radius < 1.3 * r)].mean() for r in (0.04, 0.16))
        assert np.log(high / low) / np.log(4) == pytest.approx(slope, abs=0.15)
    power, f = _power(Noise(spectrum="blobs", scale=16))
    assert np.average(np.hypot(*np.moveaxis(f, -1, 0)), weights=power) == pytest.approx(1 / 16, rel=0.15)


def test_grass_is_turned() -> None:
    """Stretched blots are four times as long as broad, and turn with the rotation."""
    for rotation, axis in ((0.0, 0), (90.0, 1)):
        power, f = _power(Noise(spectrum="grass", scale=10, rotation=rotation))
        spread = np.sqrt([np.average(f[..., k] ** 2, weights=power) for k in (0, 1)])
        assert spread[axis] > 2.5 * spread[1 - axis]
