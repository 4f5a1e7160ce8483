"""Claims about recompositions: draws each element of which copies an element of a sample."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.jigsaw import Jigsaw
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.datasets_procedural.modelling.pattern import Frame, Layer
from nrbench.datasets_procedural.overlap import Overlap
from nrbench.datasets_procedural.pavement import Pavement
from nrbench.datasets_procedural.squares import Squares
from nrbench.errors import BadInput
from nrbench.plugins.forms import Texture

from .conftest import NONE, VARIANTS, render, truth, without_share

ALL: dict[str, Any] = {"color": 0.4, "damage": 0.2, "missing": 0.05, "light": 0.4, "jitter": 0.3, "bend": 0.4}


def _recompose(model: Model, sample: Texture, seed: int = 1, side: int = 160) -> Texture:
    return model.recompose(sample, (side, side), np.random.default_rng(seed))


def _rows(texture: Texture, name: str) -> set[bytes]:
    return {row.tobytes() for row in texture.elements[name]}


@pytest.mark.parametrize(("model", "words"), VARIANTS)
def test_every_element_has_the_factors_of_an_element_of_the_sample(model: type[Model], words: dict[str, Any]) -> None:
    """The factors and the loss of each element are those of one visible element; the rest is as in a fresh draw."""
    made = without_share(model(**words, **ALL, rotation=13.0))
    sample = render(made, side=112)
    output, fresh = _recompose(made, sample), made.again(sample, (160, 160), np.random.default_rng(5))
    assert output.lattice == fresh.lattice and output.kind == fresh.kind
    np.testing.assert_array_equal(truth(output)[1], truth(fresh)[1])
    for name in (name for name in output.elements if name.endswith(".factor")):
        assert _rows(output, name) <= _rows(sample, name)
        loss = name.replace(".factor", ".damage")
        pairs = [np.column_stack([each.elements[name], each.elements[loss]]) for each in (output, sample)]
        assert {row.tobytes() for row in pairs[0]} <= {row.tobytes() for row in pairs[1]}


@pytest.mark.parametrize(
    "model",
    [
        Brick(width=32, height=16, joint=3, phase=(0.0, 0.0)),
        Brick(width=32, height=16, joint=3, bond="english", phase=(0.0, 0.0)),
        Brick(width=32, height=16, joint=3, bond="flemish", phase=(0.25, 0.5), damage=0.4, missing=0.1),
        Squares(period=24, phase=(0.0, 0.0)),
        Pavement(width=10, joint=2, style="herringbone", phase=(0.0, 0.0), damage=0.4),
    ],
)
def test_pixels_are_copies(model: Model) -> None:
    """On a lattice of whole vectors every pixel of a whole element, with grain and holes, is a pixel of the sample."""
    sample = render(model)
    output = _recompose(model, sample)
    pattern = model.colored_pattern(*Frame(sample.lattice.origin).grid((160, 160)))
    covered, copied = pattern.coverage(), 0
    for layer in pattern.layers:
        alone = (layer.coverage > 0) & (covered == layer.coverage)
        source = {row.tobytes(): index for index, row in zip(*_parts(sample, layer.name), strict=True)}
        for index, row in zip(*_parts(output, layer.name), strict=True):
            here, there = (_pixels(layer, alone, each) for each in (index, source[row.tobytes()]))
            step = there[0] - here[0] if len(here) and len(there) else None
            if step is not None and np.array_equal(here + step, there) and there.max() < 128:
                np.testing.assert_array_equal(output.image[tuple(here.T)], sample.image[tuple(there.T)])
                copied += 1
    assert copied > 20


def _pixels(layer: Layer, alone: NDArray[np.bool_], index: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the (y, x) of the pixels that an element shares with no other."""
    mine = [part == number for part, number in zip(layer.index, index, strict=True)]
    return np.argwhere(np.logical_and.reduce([alone, *mine]))


def _parts(texture: Texture, name: str) -> tuple[Any, Any]:
    return texture.elements[f"{name}.index"].astype(int), texture.elements[f"{name}.factor"]


def test_one_whole_element_is_copied_everywhere() -> None:
    """Where the sample holds one whole tile, all tiles are copies of that one."""
    model = Hexagon(period=30, joint=3, phase=(0.31, 0.85), **{**NONE, "color": 0.5})
    sample = render(model, side=45)
    whole = _whole(_recompose(model, sample, side=140))
    assert len(sample.elements["tile.index"]) > 4 and len(whole) > 10
    assert len({row.tobytes() for row in whole}) == 1


def _whole(texture: Texture) -> Any:
    """Return the factors of the tiles whose centers lie 20 px or more inside the picture."""
    center = texture.lattice.from_cell(texture.elements["tile.index"])
    inside = ((center > 20) & (center < np.array(texture.image.shape[1::-1]) - 20)).all(1)
    return texture.elements["tile.factor"][inside]


def test_the_choice_is_uniform() -> None:
    """Each whole tile of the sample is copied about equally often."""
    model = Hexagon(period=20, joint=2, phase=(0.5, 0.5), **{**NONE, "color": 0.5})
    sample = render(model, side=80)
    counts = np.unique(_whole(_recompose(model, sample, side=800)), axis=0, return_counts=True)[1]
    assert 6 <= len(counts) <= 20
    expected = counts.sum() / len(counts)
    assert ((counts - expected) ** 2).sum() / expected < 3 * len(counts)


def test_jitter_is_copied_and_bend_is_not() -> None:
    """An element keeps its independent displacement; light and bend differ from those of the sample."""
    jitter = without_share(Hexagon(jitter=0.3, **NONE))
    sample = render(jitter)
    assert _rows(_recompose(jitter, sample), "tile.displacement") <= _rows(sample, "tile.displacement")
    for strength in ("bend", "light"):
        model = without_share(Hexagon(**{**NONE, strength: 0.8}))
        sample = render(model)
        pictures = [_recompose(model, sample, seed).image[:128, :128] for seed in (1, 2)]
        assert min(np.abs(a - b).mean() for a, b in [pictures, (pictures[0], sample.image)]) > 0.01


def test_each_lattice_of_two_counts_for_itself() -> None:
    """Of two overlapping lattices, the elements of each are copied along their own, more often than once a cell."""
    model = Overlap(**{**NONE, "color": 0.4})
    sample = render(model, side=160)
    output = _recompose(model, sample, side=200)
    index, factor = _parts(output, "square")
    lost = {tuple(place): row.tobytes() for place, row in zip(index.tolist(), factor, strict=True)}
    period = [(a, lost[(a[0] + 5, a[1])]) for a in lost if (a[0] + 5, a[1]) in lost]
    assert period and any(lost[place] != beyond for place, beyond in period)


def test_a_sample_smaller_than_a_cell() -> None:
    """Where the sample has no equal place, any element of the same kind is copied."""
    model = Jigsaw(width=90, height=80, color=0.4)
    sample = render(model, side=100)
    assert _rows(_recompose(model, sample, side=200), "piece.factor") <= _rows(sample, "piece.factor")


def test_a_texture_of_another_origin_is_refused() -> None:
    """A photograph has no draw whose elements could be copied."""
    with pytest.raises(BadInput, match="was not drawn by a model"):
        _recompose(Brick(), Texture(np.zeros((8, 8, 3), np.float32)))
