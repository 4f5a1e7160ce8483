"""Claims that every texture model must keep: its lattice, its mean, its departures, its streams."""

from __future__ import annotations

import dataclasses
import math
import subprocess
import sys
import typing
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from nrbench import plugins
from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.model import Model
from nrbench.errors import BadInput
from nrbench.imaging.door import Image
from nrbench.lattice.geometry import Lattice, Points
from nrbench.texture import Texture

MODELS = [
    plugin.cls for plugin in plugins.inventory("datasets") if plugin.cls is not None and issubclass(plugin.cls, Model)
]
NONE: dict[str, Any] = {"color": 0.0, "intensity": 0.0, "noise": 0.0}
FINER = [(a / k, b / k) for k in (2, 3, 5) for a in range(k) for b in range(k) if (a, b) != (0, 0)]
"""Cell coordinates of vectors that a lattice two, three or five times as fine would have."""


def _variants() -> Iterator[Any]:
    """Yield each model as it is, and once for each other word of each of its choices."""
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


def _render(model: Model, seed: int = 0, side: int = 128) -> Texture:
    return model.render((side, side), np.random.default_rng(seed))


def _truth(texture: Texture) -> tuple[Lattice, Image]:
    assert texture.lattice is not None and texture.ideal is not None
    return texture.lattice, texture.ideal


def _ideal_at(model: Model, xy: Points) -> Image:
    return model.pattern(xy[..., 0], xy[..., 1]).ideal()


def _explained(image: Image, lattice: Lattice) -> float:
    """Return the share of a pixel's variance that the mean of its 8 nearest neighbors in the folded cell explains."""
    sides = np.hypot(*lattice.matrix.T)
    pixels = np.stack(np.meshgrid(*map(np.arange, image.shape[1::-1])), -1).reshape(-1, 2)
    points = np.minimum(lattice.to_cell(pixels) % 1.0, 1 - 1e-12) * sides
    values = image.reshape(len(points), -1)
    picked = np.random.default_rng(0).permutation(len(points))[:3000]
    neighbors = cKDTree(points, boxsize=sides).query(points[picked], k=9)[1][:, 1:]
    return float(1 - ((values[neighbors].mean(1) - values[picked]) ** 2).mean() / values.var(0).mean())


@pytest.mark.parametrize("model", MODELS)
def test_folds_by_its_lattice(model: type[Model]) -> None:
    """Folded by the true lattice, a turned texture without departures is explained to more than 99.5 %."""
    made = model(rotation=17.3, **NONE)
    side = math.ceil(np.clip(14 * math.sqrt(Lattice(*made.vectors).area), 300, 900))
    texture = _render(made, side=side)
    assert _explained(texture.image, _truth(texture)[0]) > 0.995


@pytest.mark.parametrize(("model", "words"), VARIANTS)
def test_pattern_is_periodic(model: type[Model], words: dict[str, Any]) -> None:
    """The pattern is the same at points that differ by any lattice vector."""
    made = model(**words)
    points = np.random.default_rng(0).uniform(-80, 80, (1500, 2))
    here = _ideal_at(made, points)
    for steps in ((1, 0), (0, 1), (-3, 2), (7, -5)):
        assert np.abs(_ideal_at(made, points + np.array(steps) @ np.array(made.vectors)) - here).max() < 1e-5


@pytest.mark.parametrize(("model", "words"), VARIANTS)
def test_no_finer_vector(model: type[Model], words: dict[str, Any]) -> None:
    """No half, third or fifth of a lattice vector, nor sums of them, leaves the pattern even nearly the same."""
    made = model(**words)
    matrix = np.array(made.vectors)
    points = np.random.default_rng(0).random((1500, 2)) @ matrix
    here = _ideal_at(made, points)
    variance = here.var(0).mean()
    for finer in FINER:
        moved = _ideal_at(made, points + np.array(finer) @ matrix)
        assert ((moved - here) ** 2).mean() / 2 / variance > 0.08


@pytest.mark.parametrize(("model", "words"), VARIANTS)
def test_lattice_is_the_smallest(model: type[Model], words: dict[str, Any]) -> None:
    """The waves that make up the pattern generate the whole reciprocal lattice: there is no finer one of any kind."""
    steps = (np.arange(96) + 0.5) / 96
    made = model(**words)
    cell = np.stack(np.meshgrid(steps, steps), -1) @ np.array(made.vectors)
    power = (np.abs(np.fft.fft2(_ideal_at(made, cell), axes=(0, 1))) ** 2).sum(-1)
    power[0, 0] = 0
    strongest = np.argsort(-power, axis=None)[:60]
    kept = strongest[power.ravel()[strongest] > 1e-3 * power.sum()]
    order = np.fft.fftfreq(96, 1 / 96)[np.stack(np.unravel_index(kept, power.shape), -1)].astype(int)
    minors = np.outer(order[:, 0], order[:, 1]) - np.outer(order[:, 1], order[:, 0])
    assert np.gcd.reduce(minors, axis=None) == 1


@pytest.mark.parametrize("model", MODELS)
def test_sizes_are_real_numbers(model: type[Model]) -> None:
    """At twice any length the pattern is still periodic by its lattice: no length is rounded."""
    lengths = {
        field.name: 2.0173 * getattr(model(), field.name)
        for field in dataclasses.fields(model)
        if isinstance(field.default, float) and field.default > 2
    }
    made = model(**lengths)
    points = np.random.default_rng(0).uniform(-80, 80, (1500, 2))
    moved = points + np.array((3, -2)) @ np.array(made.vectors)
    assert lengths and np.abs(_ideal_at(made, points) - _ideal_at(made, moved)).max() < 1e-5


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
    upright = _render(model(phase=(float(corner[0]), float(corner[1])), **NONE), side=side)
    turned = _render(model(phase=(0.0, 0.0), rotation=90.0, **NONE), side=side)
    assert np.abs(np.rot90(upright.image, -1) - turned.image).max() < 1e-5


@pytest.mark.parametrize("model", MODELS)
def test_rotation_turns_the_lattice(model: type[Model]) -> None:
    """The lattice of a turned texture is the lattice turned, x towards y."""
    angle = math.radians(33.3)
    turn = np.array([(math.cos(angle), math.sin(angle)), (-math.sin(angle), math.cos(angle))])
    lattice, _ = _truth(_render(model(rotation=33.3)))
    np.testing.assert_allclose(lattice.matrix, np.array(model().vectors) @ turn, atol=1e-9)


@pytest.mark.parametrize("model", MODELS)
def test_phase(model: type[Model]) -> None:
    """The phase is drawn over the whole cell unless it is given, and then the lattice starts there."""
    fixed, free = _truth(_render(model(phase=(0.25, 0.5)), side=8))[0], model()
    np.testing.assert_allclose(fixed.to_cell((0, 0)), (-0.25, -0.5), atol=1e-12)
    drawn = np.array([-_truth(_render(free, seed, 8))[0].to_cell((0, 0)) for seed in range(60)])
    assert np.all(np.abs(drawn.mean(0) - 0.5) < 0.15) and drawn.min() >= -1e-9 and drawn.max() < 1


@pytest.mark.parametrize("model", MODELS)
def test_mean_is_the_ideal(model: type[Model]) -> None:
    """The mean of 60 draws at one phase misses the ideal image by the noise of a mean, and no more."""
    made = model(color=0.3, intensity=0.2, noise=0.05, light=0.1, rotation=11.0)
    first = _render(made, side=80)
    rng = np.random.default_rng(1)
    draws = np.stack([made.again(first, (80, 80), rng).image for _ in range(40)]).astype(np.float64)
    z = (draws.mean(0) - _truth(first)[1]) / (draws.std(0, ddof=1) / math.sqrt(40))
    assert (np.abs(z) > 4).mean() < 0.006 and abs(z.mean()) < 0.6 and 0.75 < z.std() < 1.3


@pytest.mark.parametrize("departure", ["color", "intensity"])
@pytest.mark.parametrize("model", MODELS)
def test_clipping_is_rare(model: type[Model], departure: str) -> None:
    """At a strength of 0.6, under noise, less than 0.1 % of the values are clipped."""
    made = model(**{**NONE, "noise": 0.04, departure: 0.6})
    images = np.stack([_render(made, seed).image for seed in range(6)])
    assert ((images <= 0) | (images >= 1)).mean() < 0.001


@pytest.mark.parametrize("model", MODELS)
def test_regular_share(model: type[Model]) -> None:
    """The share given is the one measured over draws and phases, whatever the rotation."""
    made = model(color=0.3, intensity=0.2, noise=0.06, rotation=20.0)
    textures = [_render(made, seed, 200) for seed in range(8)]
    regular = np.mean([_truth(texture)[1].var((0, 1)).mean() for texture in textures])
    departures = np.mean([((texture.image - _truth(texture)[1]) ** 2).mean() for texture in textures])
    assert textures[0].regular_share == pytest.approx(regular / (regular + departures), abs=0.03)
    assert {texture.regular_share for texture in textures} == {made.regular_share}
    assert model(**NONE).regular_share == 1.0


@pytest.mark.parametrize("model", MODELS)
def test_kind(model: type[Model]) -> None:
    """Without departures a texture is of type 0 and its own ideal image; with any of them of type I."""
    regular = _render(model(**NONE))
    assert regular.kind == "0"
    np.testing.assert_array_equal(regular.image, _truth(regular)[1])
    assert {_render(model(**{**NONE, name: 0.1})).kind for name in NONE} == {"I"}


@pytest.mark.parametrize("model", MODELS)
def test_again(model: type[Model]) -> None:
    """Another draw keeps lattice, origin and ideal image, at any shape, and nothing of the departures."""
    made = model(rotation=5.0)
    texture = _render(made, side=160)
    other = made.again(texture, (200, 160), np.random.default_rng(9))
    assert other.lattice == texture.lattice and other.image.shape == (200, 160, 3)
    np.testing.assert_array_equal(_truth(other)[1][:160], _truth(texture)[1])
    residuals = [(one.image[:160] - _truth(texture)[1]).ravel() for one in (texture, other)]
    assert abs(np.corrcoef(residuals)[0, 1]) < 0.25
    windows = np.lib.stride_tricks.sliding_window_view(texture.image[..., 0], (16, 16))[::4, ::4]
    assert not any((other.image[16:32, 16:32, 0] == window).all() for row in windows for window in row)


def test_again_needs_a_lattice() -> None:
    """A texture without a lattice is refused: no model here rendered it."""
    with pytest.raises(BadInput, match="pass one that this model rendered"):
        Brick().again(Texture(np.zeros((8, 8, 3), np.float32)), (8, 8), np.random.default_rng(0))


@pytest.mark.parametrize("model", MODELS)
def test_larger_render_continues_the_smaller(model: type[Model]) -> None:
    """One stream at two shapes gives one texture: the smaller is the larger's corner, to the byte."""
    made = model(rotation=12.0)
    small, large = (made.render(shape, np.random.default_rng(4)) for shape in ((50, 70), (120, 90)))
    np.testing.assert_array_equal(small.image, large.image[:50, :70])
    assert small.lattice == large.lattice


def test_equal_seeds_equal_bytes() -> None:
    """Another process renders the same bytes from the same seed; another seed renders others."""
    program = (
        "import hashlib, numpy\nfrom nrbench import plugins\n"
        "for plugin in plugins.inventory('datasets'):\n"
        "    if plugin.name != 'images':\n"
        "        more = {} if plugin.name == 'noise' else dict(jitter=0.2, bend=0.2, damage=0.2, light=0.3)\n"
        "        image = plugin.cls(rotation=7.0, **more).render((40, 60), numpy.random.default_rng(SEED)).image\n"
        "        print(plugin.name, hashlib.sha256(image.tobytes()).hexdigest())"
    )
    commands = [[sys.executable, "-c", program.replace("SEED", seed)] for seed in "334"]
    runs = (subprocess.run(command, capture_output=True, text=True, check=True) for command in commands)
    first, again, other = (run.stdout.split() for run in runs)
    assert first == again and len(first) == 2 * (len(MODELS) + 1)
    assert not set(first[1::2]) & set(other[1::2])


@pytest.mark.parametrize("model", MODELS)
def test_elements_have_their_strength(model: type[Model]) -> None:
    """Element factors have mean 1, half the strength as standard deviation, and independent channels."""
    made = model(color=0.4, intensity=0.0, noise=0.0)
    elements = [_render(made, seed, 256).elements for seed in range(6)]
    factor = np.concatenate([array for one in elements for name, array in one.items() if name.endswith(".factor")])
    assert factor.mean() == pytest.approx(1, abs=0.05) and factor.std() == pytest.approx(0.2, rel=0.1)
    assert np.abs(factor - 1).max() <= 0.2 * math.sqrt(3)
    assert np.abs(np.corrcoef(factor.T) - np.eye(3)).max() < 0.2


@pytest.mark.parametrize("model", MODELS)
def test_intensity_is_common_to_the_channels(model: type[Model]) -> None:
    """Intensity multiplies all channels of an element by the same factor."""
    elements = _render(model(color=0.0, intensity=0.4, noise=0.0)).elements
    for name in (name for name in elements if name.endswith(".factor")):
        assert (elements[name] == elements[name][:, :1]).all() and elements[name].std() > 0.1


@pytest.mark.parametrize("model", MODELS)
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
def test_bad_departures(model: type[Model], parameters: dict[str, Any], message: str) -> None:
    """A strength outside [0, 1], or an angle or phase that is no number, is refused with what to give."""
    with pytest.raises(BadInput, match=message):
        model(**parameters)


@pytest.mark.parametrize("model", MODELS)
def test_page_tells_all_parameters(model: type[Model]) -> None:
    """A model's page has its own parameters and those that all models share, under one heading."""
    page = model.__doc__ or ""
    assert page.count("Parameters\n") == 1
    assert all(field.name in page for field in dataclasses.fields(model))
