"""Deformation fields of known displacements, the scores of warped outputs, and G and A of known departures."""

import math
from dataclasses import replace

import numpy as np
import pytest
from cases import Case, case

from nrbench.datasets_procedural.modelling.model import Model
from nrbench.datasets_procedural.weave import Weave
from nrbench.imaging.convert import quantize
from nrbench.lattice.geometry import Lattice
from nrbench.metrics.deformation import DeformationAmplitude
from nrbench.metrics.geometry_appearance import GeometryAppearance
from nrbench.metrics.registration.node_field import NodeField
from nrbench.plugins.forms import Metric, Observation, Texture

SQUARE = Lattice((20.0, 0.0), (0.0, 20.0), (3.0, 5.0))


def make_observation(model: Model, output: Model | None = None, side: int = 192, again: bool = False) -> Observation:
    """Return a sample of a model and a draw of another on the same lattice."""
    own = Case.of(model, 5)
    drawn = (output or model).again(own.texture, (side, side), np.random.default_rng(6))
    truth = replace(own.texture, displacement=None)
    return Observation(truth.image, quantize(drawn.image), truth, again=own.again if again else None)


def planted(amplitude: float, wave: float, side: int = 400) -> NodeField:
    """Return a square lattice displaced by a sine along y that runs along x, both in px."""
    nodes = 2 * side // 20
    places = np.moveaxis(np.indices((nodes, nodes)), 0, -1) / 2 @ SQUARE.matrix
    moved = np.zeros_like(places)
    moved[..., 1] = amplitude * math.sqrt(2) * np.sin(2 * math.pi * places[..., 0] / wave)
    return NodeField(SQUARE.matrix / 2, SQUARE.s, places, moved, np.ones((nodes, nodes), np.bool_))


@pytest.mark.parametrize("amplitude", [0.5, 2.0, 6.0])
def test_amplitude_and_deviation_of_a_known_field(amplitude: float) -> None:
    """The amplitude of a sine is its root mean square in px, also under an affine map."""
    field = planted(amplitude, 100.0)
    turned = replace(field, moved=field.moved + field.places @ np.array([[0.02, 0.03], [-0.01, -0.02]]) + (5, -3))
    assert field.amplitude == pytest.approx(amplitude, rel=0.05)
    assert turned.amplitude == pytest.approx(amplitude, rel=0.07)
    assert field.deviation < field.amplitude


def test_correlation_length_of_a_known_field() -> None:
    """White displacements correlate over less than s, smooth ones over the width of their spectrum."""
    field, rng = planted(0.0, 100.0, 600), np.random.default_rng(0)
    white = replace(field, moved=rng.normal(size=field.places.shape))
    assert white.correlation_length == pytest.approx((1 - 1 / math.e) * SQUARE.s / 2, rel=0.1)
    waves, phases = rng.normal(0, 1 / (3 * SQUARE.s), (200, 2)), rng.uniform(0, 2 * math.pi, (200, 2))
    smooth = np.stack([np.cos(field.places @ waves.T + phase).sum(-1) for phase in phases.T], -1)
    # spectrum normal of deviation k: correlation exp(-(k r)^2 / 2), 1/e at sqrt(2) / k
    found = replace(field, moved=smooth).correlation_length
    assert found == pytest.approx(math.sqrt(2) * 3 * SQUARE.s, rel=0.2)


@pytest.mark.parametrize(("amplitude", "share"), [(0.0, 0.0), (8.0, 0.0), (40.0, 0.2)])
def test_folded_cells_are_counted(amplitude: float, share: float) -> None:
    """A field with slopes under 1 folds nothing; a steep one folds many cells."""
    field = planted(amplitude, 100.0)
    along = replace(field, moved=field.moved + field.moved[..., ::-1])
    assert along.folded == 0 if share == 0 else along.folded > share


def test_output_and_sample_are_compared_alike() -> None:
    """An output as warped as its sample has ratios near 1, also to fresh draws; a straight one far below 1."""
    warped = Weave(color=0.15, noise=0.02, bend=0.4)
    alike = DeformationAmplitude().score(make_observation(warped, side=256, again=True))
    assert isinstance(DeformationAmplitude(), Metric) and set(alike.values) == set(DeformationAmplitude.columns)
    for column in ("amplitude_ratio", "amplitude_to_fresh", "length_to_fresh"):
        value = alike.values[column]
        assert value is not None and 0.7 < value < 1.4, column
    straight = DeformationAmplitude().score(make_observation(warped, replace(warped, bend=0.0), side=256))
    ratio = straight.values["amplitude_ratio"]
    assert ratio is not None and ratio < 0.2
    assert straight.reasons["amplitude_to_fresh"] == "not measured: the texture has no fresh draws"
    assert straight.reasons["length"].startswith("not applicable")


def test_brightness_and_contrast_do_not_count() -> None:
    """Halved contrast and another brightness hardly change the amplitude."""
    first = make_observation(Weave(color=0.1, noise=0.02, bend=0.4))
    dim = replace(first, output=np.asarray(0.5 * first.output + 0.2, np.float32))
    before, after = (DeformationAmplitude().score(one).values["amplitude"] for one in (first, dim))
    assert before is not None
    assert after == pytest.approx(before, rel=0.03)


def test_the_lattice_alone_is_enough() -> None:
    """Without the model, even without a lattice, the amplitude is nearly the same; a lattice given does not count."""
    first = make_observation(Weave(color=0.15, noise=0.02, bend=0.4))
    assert first.truth is not None and first.truth.lattice is not None
    lattice = first.truth.lattice
    alone = replace(first, truth=Texture(first.sample, lattice))
    nothing = replace(first, truth=None)
    other = replace(nothing, lattice_given=Lattice((17.0, 0.0), (0.0, 19.0)))
    amplitudes = [DeformationAmplitude().score(one).values["amplitude"] for one in (first, alone, nothing, other)]
    assert amplitudes[0] is not None
    assert amplitudes[1:3] == pytest.approx([amplitudes[0]] * 2, rel=0.1)
    assert amplitudes[3] == amplitudes[2]


def test_missing_scores_have_reasons() -> None:
    """Without contrast, enough tiles or the texture in the output the scores are None, with a reason."""
    one = case("hexagon").observe(case("hexagon").fresh())
    plain = np.full_like(one.sample, 0.5)
    flat = DeformationAmplitude().score(replace(one, sample=plain, truth=Texture(plain, SQUARE), again=None))
    assert set(flat.reasons.values()) == {"not applicable: the mean tile is flat"}
    small = DeformationAmplitude().score(replace(one, output=one.output[:40, :40]))
    assert small.values["amplitude"] is None and "found in only 0%" in small.reasons["amplitude"]
    noise = DeformationAmplitude().score(
        replace(one, output=np.random.default_rng(0).random((192, 192, 3), np.float32))
    )
    assert noise.values["amplitude"] is None and "found in only" in noise.reasons["amplitude"]
    assert noise.values["tracked"] is not None and noise.values["tracked"] < 0.5


def test_parts_are_alike_and_cover_the_image() -> None:
    """An image of the size of a part is one part; larger images are covered by several parts of that size."""
    field = planted(1.0, 100.0)
    assert len(field.parts(field.extent)) == 1
    some = field.parts((200, 200))
    assert len(some) == 9
    assert max(np.ptp(part.places[part.known], 0).max() for part in some) <= 200


PLAIN = Weave(color=0.0, intensity=0.0, noise=0.0)


def test_a_perfect_texture_has_neither() -> None:
    """Identical tiles on a regular lattice have a G under 0.01 s and an A under the error of resampling."""
    values = GeometryAppearance().score(make_observation(PLAIN)).values
    assert isinstance(GeometryAppearance(), Metric) and set(values) == set(GeometryAppearance.columns)
    assert values["g"] < 0.01 and values["a"] < 0.02


def test_appearance_measures_noise() -> None:
    """A is the standard deviation of grain, less what bilinear resampling removes, and G stays small."""
    values = GeometryAppearance().score(make_observation(replace(PLAIN, noise=0.08))).values
    assert 0.05 < values["a"] < 0.08
    assert values["g"] < 0.02


def test_each_score_responds_to_its_own_departure() -> None:
    """Color changes A and hardly G; a warp changes G and hardly A."""
    g, a = [], []
    for departure in ({}, {"color": 0.2}, {"color": 0.4}, {"bend": 0.2}, {"bend": 0.4}):
        values = GeometryAppearance().score(make_observation(Weave(noise=0.02, **{"color": 0.1, **departure}))).values
        g.append(values["g"])
        a.append(values["a"])
    assert a[0] < a[1] < a[2] and a[2] > 2 * a[0]
    assert g[0] < g[3] < g[4] and g[4] > 5 * g[0]
    assert max(g[1:3]) < 0.03 and max(a[3:]) < 1.3 * a[0]


def test_one_tile_repeated_lacks_appearance() -> None:
    """The A ratio of one tile repeated is far below 1, that of a fresh draw near 1."""
    one = case("hexagon")
    drawn = one.again((192, 192), 0)
    assert drawn is not None and drawn.ideal is not None
    fresh, paper = (GeometryAppearance().score(one.observe(image)).values for image in (drawn.image, drawn.ideal))
    assert fresh["a_ratio"] == pytest.approx(1, abs=0.25)
    assert paper["a_ratio"] is not None and paper["a_ratio"] < 0.3
