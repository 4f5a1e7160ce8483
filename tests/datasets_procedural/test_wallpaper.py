"""Claims about plane groups, and about wallpaper that has their symmetry."""

from __future__ import annotations

import numpy as np
import pytest

from nrbench.datasets_procedural.wallpaper import GROUPS, Group, Wallpaper, operations, random_motif
from nrbench.lattice.geometry import Lattice

ORDERS = dict(zip(GROUPS, (1, 2, 2, 2, 2, 4, 4, 4, 4, 4, 8, 8, 3, 6, 6, 6, 12), strict=True))
EVERY = {one for group in GROUPS for one in operations(group)}


def _error(group: Group, operation: tuple[int, int, int, int, float, float]) -> float:
    """Return how much an operation changes a motif: the squared error over twice the variance."""
    motif = random_motif(5, group, 2)
    u, v = np.random.default_rng(0).random((2, 800))
    a, b, c, d, e, f = operation
    return float(((motif(a * u + b * v + e, c * u + d * v + f) - motif(u, v)) ** 2).mean() / 2)


@pytest.mark.parametrize("group", GROUPS)
def test_a_group_is_a_group(group: Group) -> None:
    """Each group has its order, and keeps the metric of its lattice."""
    found = operations(group)
    assert len(found) == len(set(found)) == ORDERS[group]
    cell = Lattice(*Wallpaper(group=group).vectors).matrix.T
    for a, b, c, d, *_ in found:
        turn = cell @ np.array([(a, b), (c, d)]) @ np.linalg.inv(cell)
        np.testing.assert_allclose(turn @ turn.T, np.eye(2), atol=1e-9)


@pytest.mark.parametrize("group", GROUPS)
def test_a_motif_has_the_symmetry_of_its_group_and_no_other(group: Group) -> None:
    """Among the operations of all groups, only those of its own leave a motif unchanged; no other nearly does."""
    for operation in EVERY:
        error = _error(group, operation)
        assert error < 1e-20 if operation in operations(group) else error > 0.02


def test_motifs_are_standardized_and_unlike() -> None:
    """Each function has mean 0 and variance 1 over the cell; two of one motif, and two motifs, differ."""
    u, v = np.meshgrid(*[np.arange(32) / 32] * 2)
    first, second = (random_motif(seed, "p4g", 2)(u, v) for seed in (1, 2))
    np.testing.assert_allclose(first.mean((1, 2)), 0, atol=1e-9)
    np.testing.assert_allclose(first.var((1, 2)), 1, atol=1e-9)
    assert np.abs(first[0] - first[1]).mean() > 0.2 and np.abs(first - second).mean() > 0.2


def test_wallpaper_has_the_symmetry() -> None:
    """A sixfold wallpaper, turned by 60 degrees about its origin, is itself."""
    images = [
        Wallpaper(group="p6", phase=(0, 0), rotation=angle, color=0, intensity=0, noise=0)
        .render((64, 64), np.random.default_rng(0))
        .image
        for angle in (10.0, 70.0)
    ]
    np.testing.assert_allclose(images[0], images[1], atol=1e-5)
