"""Claims that every texture model must keep: its lattice, its mean, its departures, its streams."""

from __future__ import annotations

import dataclasses
import hashlib
import math
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.model import Model
from nrbench.datasets_procedural.weave import Weave
from nrbench.errors import BadInput
from nrbench.imaging.door import Image
from nrbench.lattice.geometry import Lattice
from nrbench.texture import Texture

MODELS = [Brick, Weave, Hexagon]
NONE: dict[str, Any] = {"color": 0.0, "intensity": 0.0, "noise": 0.0}
FINER = {
    "t1/2": ((1, 0), (0, 2), 2),
    "t2/2": ((2, 0), (0, 1), 2),
    "(t1+t2)/2": ((1, 1), (0, 2), 2),
    "t1/3": ((1, 0), (0, 3), 3),
    "t2/3": ((3, 0), (0, 1), 3),
    "(t1+t2)/3": ((1, 1), (0, 3), 3),
    "(t1-t2)/3": ((1, -1), (0, 3), 3),
    "t1/5": ((1, 0), (0, 5), 5),
    "t2/5": ((5, 0), (0, 1), 5),
    "(2t1+t2)/5": ((2, 1), (5, 0), 5),
}
"""Lattices of which the true one is a sublattice: two integer vectors, over a divisor."""


def _render(model: Model, seed: int = 0, side: int = 128) -> Texture:
    return model.render((side, side), np.random.default_rng(seed))


def _truth(texture: Texture) -> tuple[Lattice, Image]:
    assert texture.lattice is not None and texture.ideal is not None
    return texture.lattice, texture.ideal


def _explained(image: Image, lattice: Lattice) -> float:
    """Return the share of variance that its 8 nearest neighbors in the folded cell explain of a pixel.

    Of a lattice that is too fine, they come from all its cells: one neighbor alone may always be of the right one.
    """
    points = lattice.to_cell(np.stack(np.meshgrid(*map(np.arange, image.shape[1::-1])), -1)) % 1.0
    points = np.where(points >= 1, 0, points).reshape(-1, 2)
    values = image.reshape(len(points), -1)
    picked = np.random.default_rng(0).permutation(len(points))[:3000]
    neighbors = cKDTree(points, boxsize=np.ones(2)).query(points[picked], k=9)[1]
    squares = ((values[neighbors] - values[picked][:, np.newaxis]) ** 2).mean()
    return float(1 - squares * 9 / 8 / 2 / values.var(0).mean())


@pytest.mark.parametrize("rotation", [0.0, 17.3])
@pytest.mark.parametrize("model", MODELS)
def test_folds_by_its_lattice(model: type[Model], rotation: float) -> None:
    """Folded by the true lattice, a texture without departures is explained to more than 99.5 %."""
    texture = _render(model(rotation=rotation, **NONE), side=400)
    assert _explained(texture.image, _truth(texture)[0]) > 0.995


@pytest.mark.parametrize("finer", FINER)
@pytest.mark.parametrize("model", MODELS)
def test_lattice_is_the_smallest(model: type[Model], finer: str) -> None:
    """No finer lattice explains the ideal image."""
    lattice, ideal = _truth(_render(model(rotation=17.3, **NONE), side=400))
    first, second, divisor = FINER[finer]
    vectors = np.array([first, second]) @ lattice.matrix / divisor
    candidate = Lattice(tuple(vectors[0]), tuple(vectors[1]), lattice.origin)
    assert candidate.area == pytest.approx(lattice.area / divisor)
    assert _explained(ideal, candidate) < 0.9


@settings(max_examples=60, deadline=None)
@given(data=st.data(), model=st.sampled_from(MODELS))
def test_pattern_is_periodic(data: st.DataObject, model: type[Model]) -> None:
    """At any sizes, the pattern is the same at points that differ by a lattice vector."""
    sizes: dict[Any, Any] = {
        Brick: {"width": (8.0, 60.0), "height": (8.0, 60.0), "joint": (1.0, 6.0)},
        Weave: {"warp": (8.0, 60.0), "weft": (8.0, 60.0), "gap": (1.0, 6.0)},
        Hexagon: {"period": (8.0, 60.0), "joint": (1.0, 6.0)},
    }[model]
    parameters: dict[str, Any] = {name: data.draw(st.floats(*bounds)) for name, bounds in sizes.items()}
    made = model(**parameters)
    steps = np.array([data.draw(st.tuples(st.integers(-9, 9), st.integers(-9, 9)))])
    points = np.random.default_rng(0).uniform(-80, 80, (500, 2))
    moved = points + steps @ np.array(made.vectors)
    here, there = (_ideal_at(made, xy) for xy in (points, moved))
    assert np.abs(here - there).max() < 1e-5


def _ideal_at(model: Model, xy: np.ndarray[Any, np.dtype[np.float64]]) -> Image:
    pattern = model.pattern(xy[:, 0], xy[:, 1])
    return np.asarray(pattern.bare() + sum(layer.paint() for layer in pattern.layers))


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
    fixed = _truth(_render(model(phase=(0.25, 0.5))))[0]
    np.testing.assert_allclose(fixed.to_cell((0, 0)), (-0.25, -0.5), atol=1e-12)
    drawn = [-_truth(_render(model(), seed, 8))[0].to_cell((0, 0)) for seed in range(200)]
    assert np.all(np.abs(np.mean(drawn, 0) - 0.5) < 0.08) and np.min(drawn) >= 0 and np.max(drawn) < 1


@pytest.mark.parametrize("model", MODELS)
def test_mean_is_the_ideal(model: type[Model]) -> None:
    """The mean of 60 draws at one phase misses the ideal image by the noise of a mean, and no more."""
    made = model(color=0.3, intensity=0.2, noise=0.06, rotation=11.0)
    first = _render(made, side=64)
    rng = np.random.default_rng(1)
    draws = np.stack([made.again(first, (64, 64), rng).image for _ in range(60)]).astype(np.float64)
    z = (draws.mean(0) - _truth(first)[1]) / (draws.std(0, ddof=1) / math.sqrt(60))
    assert np.abs(z).max() < 6.5 and abs(z.mean()) < 0.3 and 0.8 < z.std() < 1.25


@pytest.mark.parametrize("departure", ["color", "intensity"])
@pytest.mark.parametrize("model", MODELS)
def test_clipping_is_rare(model: type[Model], departure: str) -> None:
    """At a strength of 0.6, under noise, less than 0.1 % of the values are clipped."""
    made = model(**{**NONE, "noise": 0.04, departure: 0.6})
    images = np.stack([_render(made, seed).image for seed in range(10)])
    assert ((images <= 0) | (images >= 1)).mean() < 0.001


@pytest.mark.parametrize("model", MODELS)
def test_regular_share(model: type[Model]) -> None:
    """The share given is the one measured over draws and phases, whatever the rotation."""
    made = model(color=0.3, intensity=0.2, noise=0.06, rotation=20.0)
    textures = [_render(made, seed, 200) for seed in range(12)]
    regular = np.mean([_truth(texture)[1].var((0, 1)).mean() for texture in textures])
    departures = np.mean([((texture.image - _truth(texture)[1]) ** 2).mean() for texture in textures])
    assert textures[0].regular_share == pytest.approx(regular / (regular + departures), abs=0.02)
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
    texture = _render(made, side=64)
    other = made.again(texture, (96, 64), np.random.default_rng(9))
    assert other.lattice == texture.lattice and other.image.shape == (96, 64, 3)
    np.testing.assert_array_equal(_truth(other)[1][:64], _truth(texture)[1])
    residuals = [(one.image[:64] - _truth(texture)[1]).ravel() for one in (texture, other)]
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


@pytest.mark.parametrize("model", MODELS)
def test_equal_seeds_equal_bytes(model: type[Model]) -> None:
    """Another process renders the same bytes from the same seed; another seed renders others."""
    program = (
        f"import hashlib, numpy\nfrom {model.__module__} import {model.__name__} as M\n"
        "image = M(rotation=7.0).render((40, 60), numpy.random.default_rng(3)).image\n"
        "print(hashlib.sha256(image.tobytes()).hexdigest())"
    )
    there = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.strip()
    here = [model(rotation=7.0).render((40, 60), np.random.default_rng(seed)).image for seed in (3, 4)]
    assert hashlib.sha256(here[0].tobytes()).hexdigest() == there
    assert np.abs(here[0] - here[1]).mean() > 0.01


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
