"""Planted displacements, and how well the tracker recovers them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates
from scipy.stats import spearmanr

from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.datasets_procedural.weave import Weave
from nrbench.imaging.convert import quantize
from nrbench.lattice.geometry import Lattice
from nrbench.metrics.deformations.tracked_lattices import DeformationField
from nrbench.tracking.tracker import LABELS, MeanTile, Nodes, Track, cell_covariance, track_tiles, unwrap

MODELS: dict[str, Model] = {
    "brick": Brick(color=0.2, noise=0.03, rotation=13.0),
    "weave": Weave(color=0.2, noise=0.03),
    "hexagon": Hexagon(color=0.3, noise=0.03, period=21.3),
}


def tracked(model: Model, seed: int = 0, side: int = 192) -> tuple[Track, DeformationField, DeformationField]:
    """Return the track of a draw, the field that was recovered, and the true field at the same lattice points."""
    drawn = model.render((side, side), np.random.default_rng(seed))
    assert drawn.lattice is not None and drawn.ideal is not None
    lattice = drawn.lattice.reduced()
    found = track_tiles(quantize(drawn.image), lattice, MeanTile.of(drawn.ideal, lattice))
    field = DeformationField.of(found)
    moved = np.zeros_like(field.places)
    if drawn.displacement is not None:
        planes = np.moveaxis(drawn.displacement.astype(np.float64), -1, 0)
        moved = np.stack([map_coordinates(plane, field.places.T[::-1], order=1, mode="nearest") for plane in planes], 1)
    return found, field, replace(field, places=lattice.from_cell(field.numbers) + moved)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("bend", [0.2, 0.5])
def test_smooth_warps_are_recovered(name: str, bend: float) -> None:
    """The amplitude of a smooth warp is recovered within 12 %, and each point within 0.3 of it."""
    _, field, true = tracked(replace(MODELS[name], bend=bend), seed=1)
    assert field.amplitude == pytest.approx(true.amplitude, rel=0.12)
    error = field.rest - true.rest
    assert np.sqrt((error**2).sum(1).mean()) < 0.3 * true.amplitude


@pytest.mark.parametrize("name", MODELS)
def test_without_displacement_the_tracker_errs_little(name: str) -> None:
    """Without displacement the amplitude is under 0.015 s, nothing folds, and 95 % of the tiles are found."""
    found, field, _ = tracked(MODELS[name])
    assert field.amplitude < 0.015 * found.lattice.s
    assert field.folded == 0
    assert found.tracked_share(0.5) > 0.95


def test_displacements_beyond_half_a_cell_are_tracked() -> None:
    """A warp of more than half a cell is unwrapped: the displacements found stay close to the true ones."""
    _, field, true = tracked(Weave(color=0.1, noise=0.02, bend=1.0), seed=3, side=256)
    ideal = field.lattice.from_cell(field.numbers)
    moved = true.places - ideal
    assert np.abs(moved - np.median(moved, 0)).max() > 0.6 * field.lattice.s
    error = field.places - true.places
    assert np.quantile(np.hypot(*(error - np.median(error, 0)).T), 0.95) < 0.15 * field.lattice.s


def test_jittered_tiles_are_found_one_by_one() -> None:
    """Of tiles that move independently at least 85 % of the amplitude is recovered."""
    _, field, true = tracked(Hexagon(color=0.2, noise=0.02, jitter=0.2))
    assert 0.85 < field.amplitude / true.amplitude < 1.1
    length = field.correlation_length
    assert length is not None and length < 0.8 * field.lattice.s


def test_amplitude_grows_with_the_warp() -> None:
    """Over single images of five warps, the rank correlation of amplitude and warp is at least 0.95."""
    sizes = [(bend, seed) for bend in (0.05, 0.1, 0.2, 0.4, 0.6) for seed in range(3)]
    found = [tracked(replace(MODELS["weave"], bend=bend), seed, 160)[1].amplitude for bend, seed in sizes]
    assert spearmanr([bend for bend, _ in sizes], found)[0] >= 0.95


@settings(max_examples=20)
@given(st.floats(0, 1), st.floats(0, 1), st.integers(-2, 2))
def test_unwrapping_follows_any_slope(u: float, v: float, shear: int) -> None:
    """Unwrapping recovers a linear field from peaks modulo the lattice, up to one lattice vector, in any basis."""
    lattice = Lattice((20.0, 0.0), (7.0, 19.0)).reduced()
    y, x = np.mgrid[:9, :11]
    field = np.stack([2.5 * x + shear + 20 * u, 1.5 * y + 20 * v], -1)
    side = np.arange(LABELS) / LABELS
    steps = np.stack(np.meshgrid(side, side, indexing="ij"), -1) @ lattice.matrix
    apart = lattice.wrap(steps - field[:, :, np.newaxis, np.newaxis])
    surfaces = np.exp(-(apart**2).sum(-1) / (2 * 4.0**2)).astype(np.float32)
    error = unwrap(surfaces, lattice) - field
    np.testing.assert_allclose(error - error[4, 5], 0, atol=2.5)
    assert np.hypot(*lattice.wrap(error[4, 5])) < 2


def test_local_harmonics_are_windowed_means() -> None:
    """At a node inside the image the coefficient is the sum of window, wave and plane."""
    lattice = Lattice((14.3, 2.0), (-3.0, 17.1))
    nodes, image = Nodes.of(lattice, (90, 110), 1.5), np.random.default_rng(0).random((90, 110, 1), np.float32)
    frequency = np.array([[0.063, -0.041]])
    row, column = len(nodes.y) // 2, len(nodes.x) // 2
    y, x = np.indices((90, 110))
    away = np.stack([x - nodes.x[column], y - nodes.y[row]], -1)
    form = np.einsum("...i,ij,...j", away, np.linalg.inv(nodes.covariance), away)
    window = np.exp(-form / 2) / (2 * math.pi * math.sqrt(np.linalg.det(nodes.covariance)))
    wave = np.exp(-2j * math.pi * (x * frequency[0, 0] + y * frequency[0, 1]))
    wanted = (window * wave * image[..., 0]).sum()
    assert abs(nodes.coefficients(image, frequency)[0, 0, row, column] - wanted) < 0.02 * abs(wanted) + 0.002


def test_the_window_does_not_depend_on_the_basis() -> None:
    """A cell's covariance does not depend on the basis; that of a square is s^2 / 12 along both axes."""
    square = Lattice((20.0, 0.0), (0.0, 20.0))
    np.testing.assert_allclose(cell_covariance(square), np.eye(2) * 400 / 12, rtol=0.01, atol=0.1)
    skew = Lattice((20.0, 0.0), (40.0, 20.0))
    np.testing.assert_allclose(cell_covariance(skew), cell_covariance(square), rtol=0.02, atol=0.2)
