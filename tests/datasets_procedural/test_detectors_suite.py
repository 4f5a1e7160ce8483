"""Claims about the suite that compares lattice detectors."""

from __future__ import annotations

import hashlib
import json
from collections import Counter

import numpy as np
import pytest

from nrbench import plugins
from nrbench.suites.suite import TextureRow, load_suite

SUITE = load_suite("detectors")
REGULAR = [row for row in SUITE.texture if row.dataset != "noise"]
PARAMETER = {"lighting": "light"}
MILD = {"color": 0.1, "intensity": 0.05, "noise": 0.02}


def test_families_by_departures() -> None:
    """Each family comes under each of six departures, at three levels; stack bond, a rectangular lattice, at one."""
    counts = Counter((row.family, row.departure) for row in REGULAR)
    departures = {"color", "noise", "jitter", "lighting", "rotation", "periods"}
    levels = {"brick": 3, "weave": 3, "hexagon": 3, "stack": 1}
    assert counts == {(family, name): n for family, n in levels.items() for name in departures}
    assert all(row.name == f"{row.family}-{row.departure}-{row.level:g}" for row in REGULAR)


def test_stochastic_textures() -> None:
    """Twelve rows of noise, of every spectrum, and none of them has a lattice."""
    rows = [row for row in SUITE.texture if row.dataset == "noise"]
    assert len(rows) == 12 and {row.parameters["spectrum"] for row in rows} == {
        "white",
        "pink",
        "brown",
        "blobs",
        "grass",
    }
    for row in rows:
        drawn = plugins.build("datasets", row.dataset, row.parameters).render((32, 32), np.random.default_rng(0))
        assert drawn.lattice is None and drawn.kind == "stochastic"


@pytest.mark.parametrize("row", REGULAR, ids=lambda row: row.name)
def test_one_departure_at_a_time(row: TextureRow) -> None:
    """The level is the departure's strength; everything else is as in the mildest texture."""
    name = PARAMETER.get(row.departure, row.departure)
    others = {key: value for key, value in row.parameters.items() if key in MILD and key != name}
    if row.departure == "color":
        assert others.pop("intensity") == row.level / 2  # type: ignore[operator]
    assert others == {key: value for key, value in MILD.items() if key in others}
    if row.departure != "periods":
        assert row.parameters[name] == row.level and row.sample is None
        assert not {"rotation", "light", "jitter"} & set(row.parameters) - {name}
    else:
        lattice = plugins.build("datasets", row.dataset, row.parameters).vectors
        s = min(np.hypot(*v) for v in (*lattice, np.subtract(*lattice), np.add(*lattice)))
        assert row.sample == row.size and row.sample is not None
        assert row.sample[0] == row.sample[1] == round(row.level * s)  # type: ignore[operator]


def test_rows_are_frozen() -> None:
    """The 72 rows keep their names, parameters and order, so that the cells of older runs keep their keys."""
    keys = ("name", "dataset", "family", "departure", "level", "parameters", "sample", "size", "figure", "recipe")
    rows = [row.model_dump(mode="json") for row in SUITE.texture]
    content = json.dumps([[row[key] for key in keys] for row in rows], sort_keys=True)
    assert len(rows) == 72
    assert hashlib.blake2b(content.encode(), digest_size=8).hexdigest() == "a5a99f85c671ec9a"


def test_it_costs_no_synthesis() -> None:
    """The only method hands the lattice on, and only the scores of lattices are made."""
    assert SUITE.methods == ("lattice-only",) and SUITE.metrics == ("lattice_recovery", "cost")
    assert set(SUITE.lattice).isdisjoint({"own", "given"})
