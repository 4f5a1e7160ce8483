"""Claims about the lattice that a texture states: it is the pattern's, and there is no finer one."""

import dataclasses
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from nrbench import plugins
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice, Points
from nrbench.suites.suite import load_suite

from .conftest import MODELS, NONE, VARIANTS, render, truth

SUITES = ("report2004", "spectrum", "core", "integer")


def _row_models() -> Iterator[Any]:
    """Yield the model of each row of the suites without departures, equal ones once."""
    found: dict[Model, str] = {}
    for suite in SUITES:
        for row in load_suite(suite).texture:
            if row.dataset != "noise":
                none = dict.fromkeys(("light", "damage", "missing", "jitter", "bend"), 0.0) | NONE
                made = plugins.build("datasets", row.dataset, {**row.parameters, **none})
                found.setdefault(made, f"{suite}-{row.name}")
    for made, name in found.items():
        yield pytest.param(made, id=name)


ROWS = list(_row_models())
PATTERNS = [pytest.param(each.values[0](**each.values[1]), id=each.id) for each in VARIANTS] + ROWS
"""Each model and its variants, and each row of the suites."""


def _ideal_at(model: Model, xy: Points) -> Image:
    return model.pattern(xy[..., 0], xy[..., 1]).ideal()


def _explained(image: Image, lattice: Lattice) -> float:
    """Return the share of a pixel's variance that the mean of its 3 nearest neighbors in the folded cell explains."""
    sides = np.hypot(*lattice.matrix.T)
    pixels = np.stack(np.meshgrid(*map(np.arange, image.shape[1::-1])), -1).reshape(-1, 2)
    points = np.minimum(lattice.to_cell(pixels) % 1.0, 1 - 1e-12) * sides
    values = image.reshape(len(points), -1)
    picked = np.random.default_rng(0).permutation(len(points))[:3000]
    tree = cKDTree(points, boxsize=sides, balanced_tree=False, compact_nodes=False)
    neighbors = tree.query(points[picked], k=4)[1][:, 1:]
    return float(1 - ((values[neighbors].mean(1) - values[picked]) ** 2).mean() / values.var(0).mean())


@pytest.mark.parametrize("model", MODELS)
def test_folds_by_its_lattice(model: type[Model]) -> None:
    """Folded by the true lattice, a turned texture without departures is explained to more than 99.5 %."""
    made = model(rotation=17.3, **NONE)
    side = math.ceil(np.clip(14 * math.sqrt(Lattice(*made.vectors).area), 300, 900))
    texture = render(made, side=side)
    assert _explained(texture.image, truth(texture)[0]) > 0.995


@pytest.mark.parametrize("made", PATTERNS)
def test_pattern_is_periodic(made: Model) -> None:
    """The pattern is the same at points that differ by any lattice vector."""
    points = np.random.default_rng(0).uniform(-80, 80, (1500, 2))
    here = _ideal_at(made, points)
    for steps in ((1, 0), (0, 1), (-3, 2), (7, -5)):
        assert np.abs(_ideal_at(made, points + np.array(steps) @ np.array(made.vectors)) - here).max() < 1e-5


@pytest.mark.parametrize("made", PATTERNS)
def test_lattice_is_the_smallest(made: Model) -> None:
    """The waves that make up the pattern generate the whole reciprocal lattice: there is no finer one of any kind."""
    steps = (np.arange(96) + 0.5) / 96
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
