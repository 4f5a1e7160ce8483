"""Claims about departures, over all models: what each changes, by how much, and what it leaves alone."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from nrbench.datasets_procedural.carpet import Carpet
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.mat import Mat
from nrbench.datasets_procedural.modelling.departures import Elements
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.datasets_procedural.modelling.pattern import Displacement, Field, Frame, Pattern
from nrbench.datasets_procedural.modelling.random_fields import palette
from nrbench.datasets_procedural.modelling.recomposition import Draw
from nrbench.datasets_procedural.mosaic import Mosaic
from nrbench.datasets_procedural.plaid import Plaid
from nrbench.datasets_procedural.rug import Rug
from nrbench.datasets_procedural.windows import Windows
from nrbench.plugins.forms import Texture

from .conftest import MODELS, NONE, without_share

SMALL = [Carpet, Mat, Mosaic, Plaid, Rug, Windows]
"""Models whose elements are far smaller than s."""
LONG = (Mat, Plaid)
"""Those of them with elements that cross the picture, and bend with their neighbors."""
COLORS = ("color", "intensity", "noise", "light", "damage", "missing")
KINDS = {**dict.fromkeys(COLORS, "I"), "jitter": "II", "bend": "II"}


def _render(model: Model, seed: int = 0, side: int = 96) -> Texture:
    return without_share(model).render((side, side), np.random.default_rng(seed))


def _pattern(model: Model, texture: Texture) -> Pattern:
    moved = None if texture.displacement is None else texture.displacement.astype(np.float64)
    frame = Frame(texture.lattice.origin, model.rotation)
    return model.colored_pattern(*frame.grid(texture.image.shape[:2], moved=moved))


def _moves(texture: Texture) -> NDArray[np.float64]:
    return np.concatenate([rows for name, rows in texture.elements.items() if name.endswith(".displacement")])


def _folded(moved: Displacement) -> float:
    """Return the share of the pixels at which the map to the ideal picture does not keep its orientation."""
    (xy, xx), (yy, yx) = (np.gradient(moved[..., axis]) for axis in range(2))
    return float(((1 - xx) * (1 - yy) - xy * yx <= 0).mean())


def _lost(pattern: Pattern, elements: Elements) -> Field:
    """Return the greatest share that any element seen at each pixel has lost."""
    found = np.zeros(pattern.layers[0].coverage.shape)
    for layer in pattern.layers:
        census = layer.census()
        table = np.zeros(len(census.index))
        rows = {tuple(index): loss for index, loss in zip(*_named(elements, layer.name, "damage"), strict=True)}
        table[:] = [rows.get(tuple(index), 0.0) for index in census.index.tolist()]
        found = np.maximum(found, np.where(layer.coverage > 0, table[census.row], 0))
    return found


def _named(elements: Elements, name: str, part: str) -> tuple[list[list[int]], Any]:
    return elements[f"{name}.index"].astype(int).tolist(), elements[f"{name}.{part}"]


@pytest.mark.parametrize("model", MODELS)
def test_kinds(model: type[Model]) -> None:
    """Without departures a texture is its own ideal; each departure makes its type, one of either sort type III."""
    regular = _render(model(**NONE))
    ideal = regular.image
    assert regular.kind == "0"
    np.testing.assert_array_equal(ideal, regular.ideal)
    for name, kind in KINDS.items():
        texture = _render(model(**{**NONE, name: 0.5}))
        assert texture.kind == kind and np.abs(texture.image - ideal).mean() > 1e-3
        np.testing.assert_array_equal(texture.ideal, ideal)
    assert model(**{**NONE, "bend": 0.1, "light": 0.1}).kind == "III"


@pytest.mark.parametrize("model", MODELS)
def test_displacement_is_the_truth(model: type[Model]) -> None:
    """The ideal pattern, looked up where the displacement field says each pixel came from, is the picture."""
    made = model(rotation=13.0, jitter=0.2, bend=0.3, **NONE)
    texture = _render(made)
    assert texture.displacement is not None and texture.displacement.shape == (96, 96, 2)
    assert texture.displacement.dtype == np.float32
    difference = np.abs(_pattern(made, texture).ideal() - texture.image)
    assert np.quantile(difference, 0.999) < 1e-4


@pytest.mark.parametrize("model", [model for model in MODELS if model not in SMALL])
def test_jitter_moves_elements(model: type[Model]) -> None:
    """An element moves by a standard deviation of jitter x s / 4 along x and y, with mean 0; pixels follow."""
    made = model(jitter=0.4, **NONE)
    textures = [_render(made, seed, 160) for seed in range(3)]
    moves, spread = np.concatenate([_moves(texture) for texture in textures]), 0.1 * made.s
    assert np.abs(moves.mean(0)).max() < 5 * spread / np.sqrt(len(moves))
    np.testing.assert_allclose(moves.std(0), spread, rtol=max(0.12, 3 / np.sqrt(len(moves))))
    pixels = np.stack([texture.displacement for texture in textures if texture.displacement is not None])
    assert 0.35 * spread < pixels.std() < 1.25 * spread


@pytest.mark.parametrize("model", SMALL)
def test_jitter_moves_small_elements(model: type[Model]) -> None:
    """Elements too small to move that far alone do so with their neighbors: by the same deviation, with mean 0."""
    made = model(jitter=0.6, **NONE)
    textures, spread = [_render(made, seed, 40) for seed in range(60)], 0.15 * made.s
    pixels = np.stack([texture.displacement[::39, ::39] for texture in textures if texture.displacement is not None])
    assert np.abs(pixels.mean((0, 1, 2))).max() < 4 * spread / np.sqrt(60)
    assert 0.75 * spread < pixels.std() < 1.15 * spread
    if model not in LONG:
        means = np.stack([_moves(texture).mean(0) for texture in textures])
        square = np.mean([(_moves(texture) ** 2).mean() for texture in textures])
        assert np.abs(means.mean(0)).max() < 4 * spread / np.sqrt(60)
        assert np.sqrt(square) == pytest.approx(spread, rel=0.12)


@pytest.mark.parametrize("model", MODELS)
def test_jitter_seldom_folds(model: type[Model]) -> None:
    """At a jitter of 0.6 the map of the picture turns over at less than 4 % of the pixels, at 1 at less than 10 %."""
    for jitter, most in ((0.6, 0.04), (1.0, 0.1)):
        made = model(jitter=jitter, **NONE)
        around = made.colored_pattern(*Frame().grid((128, 128), made.departures.margin))
        shares = [_folded(made.departures.displacement(around, (128, 128), seed, Draw(seed))) for seed in range(8)]
        assert np.mean(shares) < most


@pytest.mark.parametrize("model", MODELS)
def test_bend_is_smooth(model: type[Model]) -> None:
    """Pixels move by a standard deviation of bend x s / 4, with mean 0, and neighbors nearly alike."""
    made = model(bend=0.4, **NONE)
    fields = np.stack([_render(made, seed, 48).displacement for seed in range(30)])
    spread = 0.1 * made.s
    assert np.abs(fields.mean((0, 1, 2))).max() < 5 * spread / np.sqrt(30)
    assert fields.std() == pytest.approx(spread, rel=0.25)
    assert np.abs(np.diff(fields, axis=1)).max() < 1.3 * spread * 4 / made.s * 2


@pytest.mark.parametrize("model", MODELS)
def test_intact_elements_stay(model: type[Model]) -> None:
    """Damage changes only pixels of damaged elements; about as many are damaged as the strengths say."""
    made = model(rotation=9.0, damage=0.3, missing=0.2, **NONE)
    textures = [_render(made, seed, 100) for seed in range(4)]
    changed = np.abs(textures[0].image - textures[0].ideal).max(-1) > 1e-5
    lost = _lost(_pattern(made, textures[0]), dict(textures[0].elements))
    assert not changed[lost == 0].any() and (changed & (lost > 0)).any()
    losses = np.concatenate([rows for one in textures for name, rows in one.elements.items() if "damage" in name])
    assert set(losses) <= {0.0, 0.5, 1.0}
    slack = 4 / np.sqrt(len(losses))
    for loss, share in ((1, 0.2), (0.5, 0.24)):
        assert (losses == loss).mean() == pytest.approx(share, abs=slack)


def test_light_is_a_slow_wave() -> None:
    """The gradient multiplies everything by one number a pixel, of mean 1 and standard deviation light / 4."""
    made = Hexagon(light=0.8, **NONE)
    draws = [_render(made, seed, 64) for seed in range(120)]
    ratios = np.stack([draw.image / draw.ideal for draw in draws if draw.ideal is not None])
    whole = ratios.max(-1) - ratios.min(-1) < 1e-4
    assert whole.mean() > 0.9
    assert ratios[whole].mean() == pytest.approx(1, abs=0.06) and ratios[..., 0].std() == pytest.approx(0.2, abs=0.03)


@pytest.mark.parametrize("model", MODELS)
def test_inks_are_shared_by_all_draws(model: type[Model]) -> None:
    """The elements of a kind have k factors, by their ink, in each draw the same ones; a copy keeps its ink."""
    made = model(inks=2, color=0.4, intensity=0.1, noise=0.0)
    sample = _render(made)
    draws = [sample, made.again(sample, (64, 64), np.random.default_rng(1)), _render(made, 2)]
    draws.append(made.recompose(sample, (64, 64), np.random.default_rng(3)))
    kinds = {name.removesuffix(".ink") for name in sample.elements if name.endswith(".ink")}
    assert kinds == {name.removesuffix(".factor") for name in sample.elements if name.endswith(".factor")}
    for kind in kinds:
        inks = palette(kind, 2, 0.4, 0.1)
        for draw in draws:
            if f"{kind}.ink" in draw.elements:
                ink = draw.elements[f"{kind}.ink"].astype(int)
                np.testing.assert_array_equal(draw.elements[f"{kind}.factor"], inks[ink])


def test_inks_have_their_shares() -> None:
    """The elements take inks independently, with shares as 3 to 2 to 1, and the regular share is that of a draw."""
    made = Hexagon(period=12.3, joint=1.5, inks=3, color=0.4, intensity=0.1, noise=0.0)
    textures = [_render(made, seed, 200) for seed in range(6)]
    ink = np.concatenate([texture.elements["tile.ink"] for texture in textures])
    np.testing.assert_allclose(np.bincount(ink.astype(int)) / len(ink), (1 / 2, 1 / 3, 1 / 6), atol=0.04)
    index = textures[0].elements["tile.index"]
    ink_of = dict(zip(map(tuple, index), textures[0].elements["tile.ink"], strict=True))
    pairs = np.array([(one, ink_of[i + 1, j]) for (i, j), one in ink_of.items() if (i + 1, j) in ink_of])
    assert abs(np.corrcoef(pairs.T)[0, 1]) < 3 / np.sqrt(len(pairs))
    regular = np.mean([one.ideal.var((0, 1)).mean() for one in textures if one.ideal is not None])
    departed = np.mean([((one.image - one.ideal) ** 2).mean() for one in textures if one.ideal is not None])
    assert made.regular_share == pytest.approx(regular / (regular + departed), abs=0.03)


STRENGTHS = [{"damage": 0.4, "missing": 0.1}, {"light": 0.8}, {"bend": 0.6}, {"jitter": 0.5}]
DEPARTED = [Hexagon(period=14.3, joint=2.5, phase=(0.1, 0.2), **{**NONE, "color": 0.1}, **some) for some in STRENGTHS]


@pytest.mark.parametrize(
    ("made", "draws", "error"),
    [
        *((made, 50, 0.08) for made in DEPARTED),
        *((model(phase=(0.0, 0.0), jitter=0.5, **NONE), 16, 0.05) for model in MODELS),
    ],
)
def test_regular_share_counts_every_departure(made: Model, draws: int, error: float) -> None:
    """The share is the variance of the mean over draws, as a part of the mean variance of a draw."""
    side = 160 if draws == 50 else int(np.clip(3 * np.abs(made.vectors).max(), 96, 192))
    images = np.stack([_render(made, seed, side).image for seed in range(100, 100 + draws)]).astype(np.float64)
    within = images.var(0, ddof=1).mean()
    regular = images.mean(0).var((0, 1)).mean() - within / draws
    assert made.regular_share == pytest.approx(regular / (regular + within), abs=error)
