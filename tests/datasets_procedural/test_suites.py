"""Claims about the suites that come with the models."""

from __future__ import annotations

import itertools
import re
from collections import Counter

import numpy as np
import pytest

from nrbench import plugins
from nrbench.datasets_procedural.model import Model
from nrbench.suite import TextureRow, load_suite

SHARES = {"mild": (0.9, 1.0), "middle": (0.6, 0.9), "strong": (0.3, 0.6)}
SUITES = ["core", "default"]
ROWS = [pytest.param(row, id=f"{name}-{row.name}") for name in SUITES for row in load_suite(name).texture]


def _model(row: TextureRow) -> Model:
    model = plugins.build("datasets", row.dataset, row.parameters)
    assert isinstance(model, Model)
    return model


@pytest.mark.parametrize(("name", "count"), [("core", 18), ("default", 9)])
def test_families_by_shares(name: str, count: int) -> None:
    """Each family comes at each regular share; in core once axis-aligned and once rotated."""
    rows = load_suite(name).texture
    cells = Counter((row.family, row.name.split("-")[1]) for row in rows)
    assert set(cells) == set(itertools.product(("brick", "weave", "hexagon"), SHARES)) and len(rows) == count
    assert set(cells.values()) == {count // 9}
    rotated = sum("rotation" in row.parameters for row in rows)
    assert rotated == (9 if name == "core" else 4)


@pytest.mark.parametrize("row", ROWS)
def test_share_is_what_the_row_says(row: TextureRow) -> None:
    """The regular share lies in the range that the name tells, and is the one in the description."""
    share = _model(row).regular_share
    low, high = SHARES[row.name.split("-")[1]]
    assert low <= share < high
    said = re.search(r"regular share (0\.\d\d)", row.description)
    assert said and float(said[1]) == pytest.approx(share, abs=0.0051)


@pytest.mark.parametrize("row", ROWS)
def test_periods_are_not_lucky(row: TextureRow) -> None:
    """4 to 7 periods fit a side of the sample; none is whole, or commensurate with the sample or a block of 40 px."""
    lattice = _model(row).render((32, 32), np.random.default_rng(0)).lattice
    assert lattice is not None
    reduced = lattice.reduced()
    assert 4 <= 128 / reduced.s <= 7
    corners = np.array([(1, 0), (0, 1), (1, 1), (1, -1), (2, 1), (1, 2), (2, -1), (1, -2)]) @ reduced.matrix
    for whole in (1, 40, 128):
        aligned = [v for v in corners if np.abs(v).min() < 1e-9]
        turns = np.array([np.abs(v).max() for v in aligned])
        counts = turns if whole == 1 else whole / turns
        assert (np.abs(counts - np.rint(counts)) > 0.05).all()
    assert bool(aligned) != ("rotation" in row.parameters)


@pytest.mark.parametrize("row", ROWS)
def test_departures_are_visible_and_unclipped(row: TextureRow) -> None:
    """Even mild rows vary in color and grain, the phase is random, and less than 0.15 % of the values are clipped."""
    model = _model(row)
    assert model.color >= 0.1 and 0.02 <= model.noise <= 0.15 and model.phase is None
    images = np.stack([model.render((128, 128), np.random.default_rng(seed)).image for seed in range(4)])
    assert ((images <= 0) | (images >= 1)).mean() < 0.0015
