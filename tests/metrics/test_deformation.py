"""Displacements that were planted, and whether they are found again."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates
from scipy.stats import spearmanr

from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.datasets_procedural.weave import Weave
from nrbench.imaging.convert import quantize
from nrbench.lattice.geometry import Lattice
from nrbench.metrics.deformation import Deformation
from nrbench.metrics.deformations.deformation_field import DeformationField, parts
from nrbench.plugins.forms import Metric, Observation, Texture
from nrbench.tracking.local_phase import Nodes, cell_covariance
from nrbench.tracking.tracker import MeanTile, Track, track
from nrbench.tracking.unwrapping import LABELS, unwrap

from .conftest import MODELS, Case

Cases = Callable[[str], Case]
SQUARE = Lattice((20.0, 0.0), (0.0, 20.0), (3.0, 5.0))


def seen(model: Model, output: Model | None = None, side: int = 192, again: bool = False) -> Observation:
    """Return a sample of a model and a draw of another on the same lattice."""
    texture = model.render((128, 128), np.random.default_rng(5))
    texture = replace(texture, image=quantize(texture.image))

    def draw(shape: tuple[int, int], k: int) -> Texture:
        return model.again(texture, shape, np.random.default_rng([7, k]))

    drawn = (output or model).again(texture, (side, side), np.random.default_rng(6))
    truth = replace(texture, displacement=None)
    return Observation(texture.image, quantize(drawn.image), truth, again=draw if again else None)


def followed(model: Model, seed: int = 0, side: int = 192) -> tuple[Track, DeformationField, DeformationField]:
    """Return the track of a draw, the field that was found, and the true one at the same lattice points."""
    drawn = model.render((side, side), np.random.default_rng(seed))
    assert drawn.lattice is not None and drawn.ideal is not None
    lattice = drawn.lattice.reduced()
    found = track(quantize(drawn.image), lattice, MeanTile.of(drawn.ideal, lattice))
    field = DeformationField.of(found)
    moved = np.zeros_like(field.places)
    if drawn.displacement is not None:
        planes = np.moveaxis(drawn.displacement.astype(np.float64), -1, 0)
        moved = np.stack([map_coordinates(plane, field.places.T[::-1], order=1, mode="nearest") for plane in planes], 1)
    return found, field, replace(field, places=lattice.from_cell(field.numbers) + moved)


def planted(amplitude: float, wave: float, side: int = 400) -> DeformationField:
    """Return a square lattice displaced by a sine along y that runs along x, both in px."""
    numbers = SQUARE.cell_numbers((0.0, 0.0), (float(side), float(side)))
    places = SQUARE.from_cell(numbers)
    places[:, 1] += amplitude * math.sqrt(2) * np.sin(2 * math.pi * places[:, 0] / wave)
    return DeformationField(SQUARE, numbers, places)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("bend", [0.2, 0.5])
def test_smooth_warps_are_recovered(name: str, bend: float) -> None:
    """The amplitude of a smooth warp is found within 12 %, lattice point by lattice point."""
    _, field, true = followed(replace(MODELS[name], bend=bend), seed=1)
    assert field.amplitude == pytest.approx(true.amplitude, rel=0.12)
    error = field.rest - true.rest
    assert np.sqrt((error**2).sum(1).mean()) < 0.3 * true.amplitude


@pytest.mark.parametrize("name", MODELS)
def test_without_displacement_the_tracker_errs_little(name: str) -> None:
    """On a texture whose colors alone vary, the amplitude is under 0.015 s, and every tile is found."""
    found, field, _ = followed(MODELS[name])
    assert field.amplitude < 0.015 * found.lattice.s
    assert field.folded == 0
    assert found.tracked(0.5) > 0.95


def test_displacements_beyond_half_a_cell_are_followed() -> None:
    """A warp that adds up to more than half a cell is unwrapped: true and found displacement stay together."""
    _, field, true = followed(Weave(color=0.1, noise=0.02, bend=1.0), seed=3, side=256)
    ideal = field.lattice.from_cell(field.numbers)
    moved = true.places - ideal
    assert np.abs(moved - np.median(moved, 0)).max() > 0.6 * field.lattice.s
    error = field.places - true.places
    assert np.quantile(np.hypot(*(error - np.median(error, 0)).T), 0.95) < 0.15 * field.lattice.s


def test_jittered_tiles_are_found_one_by_one() -> None:
    """Tiles that move independently are found, each by itself: 85 % of the amplitude at least."""
    _, field, true = followed(Hexagon(color=0.2, noise=0.02, jitter=0.2))
    assert 0.85 < field.amplitude / true.amplitude < 1.1
    length = field.correlation_length
    assert length is not None and length < 0.8 * field.lattice.s


def test_amplitude_grows_with_the_warp() -> None:
    """Over seeds and sizes, single images: Spearman at least 0.95."""
    sizes = [(bend, seed) for bend in (0.05, 0.1, 0.2, 0.4, 0.6) for seed in range(3)]
    found = [followed(replace(MODELS["weave"], bend=bend), seed, 160)[1].amplitude for bend, seed in sizes]
    assert spearmanr([bend for bend, _ in sizes], found)[0] >= 0.95


@pytest.mark.parametrize("amplitude", [0.5, 2.0, 6.0])
def test_amplitude_and_deviation_of_a_known_field(amplitude: float) -> None:
    """A sine of known root mean square reads so, in px, whatever affine map lies over it."""
    field = planted(amplitude, 100.0)
    turned = replace(field, places=field.places @ np.array([[1.02, 0.03], [-0.01, 0.98]]) + (5, -3))
    assert field.amplitude == pytest.approx(amplitude, rel=0.05)
    assert turned.amplitude == pytest.approx(amplitude, rel=0.07)
    assert field.deviation < field.amplitude


def test_correlation_length_of_a_known_field() -> None:
    """White displacements correlate over less than s, smoothed ones over the width of the filter."""
    field, rng = planted(0.0, 100.0, 600), np.random.default_rng(0)
    white = replace(field, places=field.places + rng.normal(size=field.places.shape))
    assert white.correlation_length == pytest.approx((1 - 1 / math.e) * SQUARE.s, rel=0.1)
    waves, phases = rng.normal(0, 1 / (3 * SQUARE.s), (200, 2)), rng.uniform(0, 2 * math.pi, (200, 2))
    smooth = np.stack([np.cos(field.places @ waves.T + phase).sum(1) for phase in phases.T], 1)
    # spectrum normal of deviation k: correlation exp(-(k r)^2 / 2), 1/e at sqrt(2) / k
    found = replace(field, places=field.places + smooth).correlation_length
    assert found == pytest.approx(math.sqrt(2) * 3 * SQUARE.s, rel=0.2)


@pytest.mark.parametrize(("amplitude", "share"), [(0.0, 0.0), (8.0, 0.0), (40.0, 0.2)])
def test_folded_cells_are_counted(amplitude: float, share: float) -> None:
    """A field whose slope stays under 1 folds nothing; a steep one turns many cells over."""
    field = planted(amplitude, 100.0)
    along = replace(field, places=field.places + (field.places - planted(0.0, 100.0).places)[:, ::-1])
    assert along.folded is not None
    assert along.folded == 0 if share == 0 else along.folded > share


@settings(max_examples=20, deadline=None)
@given(st.floats(0, 1), st.floats(0, 1), st.integers(-2, 2))
def test_unwrapping_follows_any_slope(u: float, v: float, shear: int) -> None:
    """From peaks modulo the lattice the field comes back, but for one lattice vector, in any basis."""
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
    """At a node in the middle the coefficient is the plane times a turning wave, under the Gaussian window."""
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


def test_the_window_is_the_lattices_own() -> None:
    """A cell's covariance does not depend on the basis; a square's is s^2 / 12 along both axes."""
    np.testing.assert_allclose(cell_covariance(SQUARE), np.eye(2) * 400 / 12, rtol=0.01, atol=0.1)
    skew = Lattice((20.0, 0.0), (40.0, 20.0))
    np.testing.assert_allclose(cell_covariance(skew), cell_covariance(SQUARE), rtol=0.02, atol=0.2)


def test_output_and_sample_are_compared_alike() -> None:
    """A warped output beside a sample as warped has ratios near 1, beside fresh draws too; a straight one far below."""
    warped = Weave(color=0.15, noise=0.02, bend=0.4)
    alike = Deformation().score(seen(warped, side=256, again=True))
    assert isinstance(Deformation(), Metric) and set(alike.values) == set(Deformation.columns)
    for column in ("amplitude_ratio", "amplitude_to_fresh", "length_to_fresh"):
        value = alike.values[column]
        assert value is not None and 0.7 < value < 1.4, column
    straight = Deformation().score(seen(warped, replace(warped, bend=0.0), side=256))
    ratio = straight.values["amplitude_ratio"]
    assert ratio is not None and ratio < 0.2
    assert straight.reasons["amplitude_to_fresh"] == "not measured: the texture has no fresh draws"
    assert straight.reasons["length"].startswith("not applicable")


def test_brightness_and_contrast_do_not_count() -> None:
    """Halved contrast and another brightness leave the amplitude as it is."""
    first = seen(Weave(color=0.1, noise=0.02, bend=0.4))
    dim = replace(first, output=np.asarray(0.5 * first.output + 0.2, np.float32))
    before, after = (Deformation().score(one).values["amplitude"] for one in (first, dim))
    assert before is not None
    assert after == pytest.approx(before, rel=0.03)


def test_the_lattice_alone_is_enough() -> None:
    """Without the model the mean tile of the sample serves, and the amplitude is nearly the same."""
    first = seen(Weave(color=0.15, noise=0.02, bend=0.4))
    assert first.truth is not None
    alone = replace(first, truth=None, lattice_given=first.truth.lattice)
    with_model, without = (Deformation().score(one).values["amplitude"] for one in (first, alone))
    assert with_model is not None
    assert without == pytest.approx(with_model, rel=0.1)


def test_what_cannot_be_measured_says_why(case: Cases) -> None:
    """No lattice, too small an output, and an output without the texture: None and the reason, never 0."""
    one = case("hexagon").seen(case("hexagon").fresh())
    none = Deformation().score(replace(one, truth=Texture(one.sample)))
    assert set(none.values.values()) == {None}
    assert set(none.reasons.values()) == {"not applicable: no lattice is known, or its mean tile is flat"}
    small = Deformation().score(replace(one, output=one.output[:40, :40]))
    assert small.values["amplitude"] is None and "at least 9 are needed" in small.reasons["amplitude"]
    noise = Deformation().score(replace(one, output=np.random.default_rng(0).random((192, 192, 3), np.float32)))
    assert noise.values["amplitude"] is None and "found again at only" in noise.reasons["amplitude"]
    assert noise.values["tracked"] is not None and noise.values["tracked"] < 0.5


def test_parts_are_alike_and_cover_the_image() -> None:
    """An image as large as the part is one part; a larger one is covered by several, each as large."""
    field = planted(1.0, 100.0)
    assert len(parts(field, (400, 400), (400, 400))) == 1
    some = parts(field, (400, 400), (200, 200))
    assert len(some) == 9
    assert max(np.ptp(part.places, 0).max() for part in some) <= 200
