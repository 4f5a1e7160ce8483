"""Claims about straightened samples, deformed outputs, and the free-form displacement between them."""

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from bent_pictures import TILT, bent
from hypothesis import given
from hypothesis import strategies as st

import nrbench
from nrbench import plugins
from nrbench.calling.bent_samples import SampleSurvey, find_bend, synthesize_in_geometry
from nrbench.calling.method_calls import check_source
from nrbench.calling.tileable import synthesize_tileable
from nrbench.displacement.bent_detection import find_bent_lattice
from nrbench.displacement.deformation_field import (
    LEAST_GAIN,
    Deformation,
    map_points,
    pixel_places,
)
from nrbench.displacement.following import find_knots
from nrbench.displacement.free_form import FreeForm, approximate, basis, refine
from nrbench.displacement.growth import Knots
from nrbench.displacement.random_field import WaveSpectrum, neighbor_field, output_field
from nrbench.imaging.convert import quantize
from nrbench.imaging.mean_tile import explained_share, fold, interpolate
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import FoundLattice, Geometry, Task, Texture, find_lattice
from nrbench.plugins.registry import NamedDetector
from nrbench.synthesizers.tiling import Tiling


@dataclass(frozen=True)
class BendingTiling(Tiling):
    """The baseline, straightened and bent."""

    geometry: Geometry = "bent"


def deformation(texture: Texture) -> Deformation:
    """Return the deformation of a texture of known lattice, whether it is bent or not."""
    knots = find_knots(texture.image, texture.lattice)
    return Deformation(texture.image, knots)


def synthetic(amplitude: float = 3.0, wave: float = 90.0, side: float = 220.0) -> Deformation:
    """Return the deformation of a sample whose displacements are waves of one length and known amplitude."""
    knots = Knots.regular(Lattice((9.0, 0.0), (0.0, 9.0)), (int(side), int(side)))
    places, rng = knots.places, np.random.default_rng(7)
    moved = np.zeros_like(places)
    for axis in (0, 1):
        for angle, phase in 2 * math.pi * rng.random((64, 2)):
            direction = np.array([math.cos(angle), math.sin(angle)])
            moved[..., axis] += np.cos(2 * math.pi / wave * places @ direction + phase)
    moved *= amplitude / math.sqrt(32)
    found = replace(
        knots, parts=(2.0, 2.0), places=places + moved, slopes=2 * knots.slopes, correlation=np.ones(places.shape[:2])
    )
    return Deformation(np.zeros((int(side), int(side), 1), np.float32), found)


@pytest.mark.parametrize("bend, worst", [(0.25, 0.25), (0.5, 0.6)])
def test_the_displacement_of_a_model_is_recovered(bend: float, worst: float) -> None:
    """On bricks displaced by 1.6 and 3.2 px (rms), the map errs by less than 0.25 and 0.6 px."""
    texture = bent(bend=bend)
    grid = np.stack(np.meshgrid(np.arange(12.0, 180), np.arange(12.0, 180)), -1)
    places = deformation(texture).locate(grid)
    error = (places - grid - interpolate(texture.displacement, places)).reshape(-1, 2)
    # The affine part of the displacements belongs to the mean lattice.
    design = np.column_stack([grid.reshape(-1, 2), np.ones(len(error))])
    error = error - design @ np.linalg.lstsq(design, error, rcond=None)[0]
    assert np.sqrt((error**2).sum(-1).mean()) < worst


def test_the_straight_sample_is_as_periodic_as_the_ideal() -> None:
    """Straightening bricks without other departures leaves less than a tenth of the variance unexplained."""
    texture = bent(color=0.0, intensity=0.0, noise=0.0)
    found = deformation(texture)
    assert explained_share(texture.image, found.lattice) < 0.3
    assert explained_share(*found.straighten()) > 0.9


def is_straightened(texture: Texture) -> bool:
    """Return whether a sample of known lattice is straightened."""
    return find_bend(texture.image, texture.lattice, given=True)[0] is not None


@pytest.mark.parametrize("model", ["brick", "weave", "hexagon"])
def test_only_samples_that_are_bent_are_straightened(model: str) -> None:
    """Strong colors, noise, and elements that are displaced one by one are no bend; a bend of 0.3 is one."""
    assert not is_straightened(bent(model, bend=0.0, color=0.6, noise=0.1, seed=5))
    assert not is_straightened(bent(model, bend=0.0, jitter=0.3, seed=5))
    assert is_straightened(bent(model, bend=0.3, seed=5))


def test_stripes_that_slide_along_themselves_are_not_straightened() -> None:
    """Where nothing ties the lattice down along a line, places err, but straightening explains no more."""
    texture = bent("corduroy", bend=0.0, color=0.6, seed=3, side=144)
    assert deformation(texture).gain < LEAST_GAIN and not is_straightened(texture)


def test_a_flat_or_small_sample_is_not_straightened() -> None:
    """A flat sample, and one with too few tiles, are left alone."""
    flat, lattice = np.full((64, 64, 3), 0.5, np.float32), Lattice((8, 0), (0, 8))
    assert find_bend(flat, lattice, given=True)[0] is None
    small, bricks = bent(side=64).image, Lattice((27.3, 0), (13.65, 12.2))
    assert find_bend(small, bricks, given=True)[0] is None


def test_what_does_not_count_bends_nothing() -> None:
    """Bricks that are moved where a mask leaves them out make no bend, and no knot of a bent wall lies there."""
    for bend in (0.0, 0.4):
        texture = bent("brick", bend=bend, seed=5)
        known = np.ones(texture.image.shape[:2], bool)
        known[30:80, 30:90] = False
        image = texture.image.copy()
        image[30:80, 30:90] = np.roll(image, (5, 9), (0, 1))[30:80, 30:90]
        found, _ = find_bend(image, texture.lattice, True, known)
        assert (found is not None) == (bend > 0)
        if found is not None:
            x, y = np.rint(found.places).astype(int).T
            assert known[y.clip(0, len(known) - 1), x.clip(0, known.shape[1] - 1)].all()


@pytest.mark.parametrize("model", ["brick", "hexagon"])
def test_strongly_bent_samples_are_straightened(model: str) -> None:
    """At bend 1 the straightened sample is as periodic as its colors allow, however far the places have moved."""
    texture = bent(model, bend=1.0, color=0.2, seed=42, side=160)
    found, note = find_bend(texture.image, texture.lattice, given=True)
    assert found is not None and found.gain > 8 and note.startswith("bent by 0.")
    assert explained_share(*found.straighten()) > 0.7


def test_a_given_lattice_that_cannot_be_followed_is_found_in_a_part() -> None:
    """The sample is straightened to the given lattice; another given one is not replaced."""
    texture = bent("hexagon", bend=1.0, seed=3, side=160, rotation=33.0)
    found, _ = find_bend(texture.image, texture.lattice, given=True)
    assert found is not None and found.lattice.is_equivalent(texture.lattice, 2)
    other = Lattice.from_basis(1.3 * texture.lattice.matrix)
    found, note = find_bend(texture.image, other, given=True)
    assert found is None and "cannot tell" in note


def test_a_bent_lattice_is_found_where_the_detector_finds_none() -> None:
    """Without a lattice, that of a bent sample is found, and a method gets it."""
    texture = bent("weave", bend=1.0, color=0.3, seed=42, side=160)
    followed = find_bent_lattice(texture.image)
    assert followed.deformation.lattice.is_equivalent(texture.lattice, 1.5)


def seen_on(name: str, kind: str) -> Texture:
    """Return 224 px of a model in perspective, on a cylinder, or through a lens."""
    drawn = nrbench.texture(name, (384, 384), seed=5)
    places = pixel_places(224, 224)
    x, y = np.moveaxis(places - 111.5, -1, 0)
    if kind == "perspective":
        places = map_points(TILT, places)
    elif kind == "cylinder":
        places = np.stack([150 * np.arcsin(x / 150), y], -1) + 180
    else:
        places = (places - 111.5) * (1 + 0.15 * (x**2 + y**2)[..., np.newaxis] / 111.5**2) + 180
    return Texture(quantize(interpolate(drawn.image, places)), drawn.lattice)


@pytest.mark.parametrize(
    ("name", "kind"), [("weave", "perspective"), ("brick", "cylinder"), ("weave", "lens"), ("hexagon", "cylinder")]
)
def test_what_the_camera_bends_is_told_from_what_waves(name: str, kind: str) -> None:
    """A perspective, a cylinder and a lens are undone, and the output is straight; a cloth that waves stays bent."""
    texture = seen_on(name, kind)
    found, note = find_bend(texture.image, texture.lattice, given=False)
    assert found is not None and found.is_global
    assert ("in perspective" in note) is (kind == "perspective")
    task = Task(texture.image, (60, 70), None, np.random.default_rng(1))
    survey = SampleSurvey(FoundLattice(found.lattice), found, note, 0.0)
    made = synthesize_in_geometry(BendingTiling(geometry="waves"), task, survey)
    assert made.note.endswith("the output is straight")


def test_cloth_that_waves_is_not_global() -> None:
    """Its output waves, too."""
    assert not deformation(bent(bend=0.5)).is_global


def test_a_perspective_is_undone_for_an_output_that_repeats() -> None:
    """The detector finds no lattice in the sample; the output repeats the mean lattice of the plane, straight."""
    task = Task(seen_on("weave", "perspective").image, (222, 143), None, np.random.default_rng(1))
    made = synthesize_tileable(plugins.build("synthesizers", "tile-set"), task)
    assert made.lattice is not None and "in perspective" in made.note


def test_vertices_lie_about_s_apart() -> None:
    """The mesh of an elongated lattice divides its long vector, so that vertices lie about s apart along both."""
    lattice, image = Lattice((20.0, 0.0), (3.0, 61.0)), np.zeros((100, 100, 1), np.float32)
    found = Deformation(image, Knots.regular(lattice, (100, 100)))
    np.testing.assert_allclose(np.hypot(*found.mesh.matrix.T), [20.0, np.hypot(3, 61) / 3])


def test_a_drawn_field_has_the_amplitude_and_the_wave_length_of_the_sample() -> None:
    """Over draws, the amplitude is the sample's within 10 %, and most power lies within an octave of its waves."""
    found = synthetic()
    spectrum = WaveSpectrum.of(found)
    near = (spectrum.lengths > 90 / 1.5) & (spectrum.lengths < 90 * 1.5)
    assert spectrum.powers[near].sum() > 0.75 * spectrum.powers.sum()
    places = found.places
    sizes = [spectrum.draw(places, np.random.default_rng(seed)).std(0) for seed in range(12)]
    own = float(np.sqrt((found.field**2).mean()))
    assert np.sqrt(np.mean(np.square(sizes))) == pytest.approx(own, rel=0.1)


def test_a_strong_field_does_not_fold_the_output() -> None:
    """A field of displacements as large as its wave length leaves every cell at least about half of its area."""
    lattice = Lattice((8, 0), (0, 8))
    places = lattice.from_cell(np.stack(np.meshgrid(np.arange(40), np.arange(40)), -1))
    spectrum = WaveSpectrum(np.array([30.0, 33.0]), np.array([400.0, 400.0]))
    moved = spectrum.draw(places.reshape(-1, 2), np.random.default_rng(0))
    corners = places + moved.reshape(places.shape)
    along, down = np.diff(corners, axis=1)[:-1], np.diff(corners, axis=0)[:, :-1]
    areas = along[..., 0] * down[..., 1] - along[..., 1] * down[..., 0]
    assert areas.min() > 0.4 * 64
    assert np.abs(moved).max() > 1


def test_a_sample_without_displacements_gives_none() -> None:
    """A regular sample has a spectrum without power and an output field of zeros."""
    _, moved, _ = output_field(synthetic(0.0), (100, 100), "bent", np.random.default_rng(0))
    assert np.abs(moved).max() < 1e-9


def test_eight_neighbors_shrink_the_field() -> None:
    """With eight neighbors the most likely field keeps about a sixth of the amplitude."""
    found = synthetic()
    field = neighbor_field(found, (20, 20), np.random.default_rng(0))
    field = field - field.mean((0, 1))
    assert 0.05 < np.sqrt((field**2).mean()) / np.sqrt((found.field**2).mean()) < 0.35


def test_a_method_is_called_on_the_straight_sample_and_its_output_bent() -> None:
    """Tiling of a bent sample is regular, straightened and bent it is bent; the source map passes the check."""
    texture = bent()
    task = Task(texture.image, (200, 220), texture.lattice, np.random.default_rng(1))
    made = synthesize_in_geometry(BendingTiling(), task)
    assert made.image.shape == (200, 220, 3) and made.source is not None
    check_source(made.source, quantize(made.image), texture.image)
    found, own = (deformation(replace(texture, image=quantize(image))) for image in (made.image, texture.image))
    assert found.amplitude == pytest.approx(own.amplitude, rel=0.3)
    x, y = made.source[..., :2].astype(int).reshape(-1, 2).T
    shown = texture.image[y, x].reshape(made.image.shape)
    assert np.abs(shown - made.image).mean() < 0.06


def test_a_method_gets_the_task_itself_where_nothing_departs() -> None:
    """On a regular sample the mechanism changes no byte."""
    texture = bent(bend=0.0)
    tasks = [Task(texture.image, (90, 100), texture.lattice, np.random.default_rng(1)) for _ in range(2)]
    plain, wrapped = Tiling().synthesize(tasks[0]), synthesize_in_geometry(BendingTiling(), tasks[1])
    np.testing.assert_array_equal(plain.image, wrapped.image)


def test_a_lattice_that_the_survey_found_is_not_looked_for_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """The method gets the answer of its detector for the same sample; another sample is searched."""
    image, consensus = nrbench.texture("brick", (96, 96)).image, NamedDetector("consensus")
    answers = [consensus.detect(image)]
    monkeypatch.setattr(NamedDetector, "detect", lambda self, image: answers.pop())
    task = Task(image, (60, 70), None, np.random.default_rng(1))
    lattice = synthesize_in_geometry(plugins.build("synthesizers", "rsgf"), task).lattice
    other = replace(task, sample=image.copy(), detected=(image, consensus, FoundLattice(lattice)))
    with pytest.raises(IndexError):
        find_lattice(other, consensus)


BENDING = (
    "auto",
    "fftm-patch",
    "fftm-pixel",
    "regularized-patch",
    "representative-tile",
    "resample",
    "rsgf",
    "tile-set",
)


def test_every_method_that_uses_a_lattice_is_straightened() -> None:
    """Of nrbench's methods, all do but the baselines and external tools."""
    using = [p for p in plugins.inventory("synthesizers") if p.built_in and getattr(p.cls, "uses_lattice", True)]
    ranked = [p for p in using if not getattr(p.cls, "reference", False) and p.name not in ("command", "lattice-only")]
    assert sorted(p.name for p in ranked if hasattr(p.cls, "geometry")) == sorted(BENDING)
    assert {p.name for p in ranked} == set(BENDING)


@cache
def found_once() -> tuple[Texture, tuple[Deformation | None, str]]:
    """Return a bent texture, and what is found of it."""
    texture = bent(bend=0.4, side=160)
    return texture, find_bend(texture.image, texture.lattice, given=True)


@pytest.mark.parametrize("name", BENDING)
def test_a_method_is_straightened_by_default(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The note says so where the sample is bent; ``geometry=as-is`` gives the method's own bytes."""
    default, plain = (plugins.build("synthesizers", name, given) for given in ({}, {"geometry": "as-is"}))
    texture, bend = found_once()
    monkeypatch.setattr("nrbench.calling.bent_samples.find_bend", lambda *_: bend)
    tasks = [Task(texture.image, (60, 70), texture.lattice, np.random.default_rng(1)) for _ in range(3)]
    made, own = synthesize_in_geometry(default, tasks[0]), synthesize_in_geometry(plain, tasks[1])
    expected = plain.synthesize(tasks[2])
    assert "the sample was straightened" in made.note and "straightened" in made.extras
    assert made.image.shape == own.image.shape == (60, 70, 3)
    np.testing.assert_array_equal(own.image, expected.image)
    assert np.abs(made.image - own.image).max() > 0.1 and own.note == expected.note


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_the_output_keeps_the_phase_of_the_sample(seed: int) -> None:
    """Methods that continue their sample's phase continue that of the bent sample, to 2 px of 18 on average."""
    texture = bent(bend=0.3, seed=seed)
    assert texture.lattice is not None and texture.ideal is not None
    lattice = texture.lattice.reduced()
    task = Task(texture.image, (230, 240), lattice, np.random.default_rng(2))
    made = synthesize_in_geometry(BendingTiling(), task)
    tiles = []
    for image in (texture.image, made.image):
        found = deformation(replace(texture, image=quantize(image)))
        # The straight image in the basis of the texture, each pixel at its place on the plane.
        basis = np.rint(lattice.matrix @ np.linalg.inv(found.lattice.matrix)) @ found.lattice.matrix
        (straight, _), (x, y) = found.straighten(), found.corner
        tiles.append(fold(straight, Lattice.from_basis(basis, (-x, -y)), grid=(18, 18)).values)
    differences = [np.square(tiles[0] - np.roll(tiles[1], at, (0, 1))).sum() for at in np.ndindex(18, 18)]
    v, u = divmod(int(np.argmin(differences)), 18)
    assert np.hypot(*lattice.wrap(lattice.from_cell((u / 18, v / 18)) - lattice.origin)) < 2


def scattered(seed: int = 0, spread: float = 1.0) -> Points:
    """Return the points of a square lattice of 18 px, moved a little."""
    grid = np.stack(np.meshgrid(np.arange(12), np.arange(11)), -1).reshape(-1, 2) * 18.0
    return np.asarray(grid + np.random.default_rng(seed).normal(0, spread, grid.shape))


def smooth(points: Points) -> Points:
    """Return a displacement in waves of 90 px."""
    x, y = points[..., 0], points[..., 1]
    return np.stack([3 * np.sin(2 * math.pi * x / 90) * np.cos(y / 20), 3 * np.cos(y / 14)], -1)


def test_the_points_are_moved_exactly() -> None:
    """The displacement at each given point is the given one, however wild, as long as no two points are too near."""
    points = scattered()
    moves = np.random.default_rng(1).normal(0, 5, points.shape)
    np.testing.assert_allclose(FreeForm.fit(points, moves, 12.0).at(points), moves, atol=1e-9)


def test_a_smooth_field_is_reproduced_between_the_points() -> None:
    """Between points five to a wave the error is under 5 % of the field (rms), and larger where the fit runs once."""
    points = scattered()
    fitted = FreeForm.fit(points, smooth(points), 12.0)
    between = np.random.default_rng(2).uniform(18, 180, (4000, 2))
    error = fitted.at(between) - smooth(between)
    assert np.sqrt((error**2).mean()) < 0.05 * np.sqrt((smooth(between) ** 2).mean())
    once = FreeForm.fit(points, smooth(points), 12.0, repeats=1).at(between) - smooth(between)
    assert np.sqrt((once**2).mean()) > 1.3 * np.sqrt((error**2).mean())


@given(st.lists(st.floats(-0.1, 0.1), min_size=4, max_size=4), st.floats(-5, 5))
def test_affine_displacements_are_reproduced(slopes: list[float], shift: float) -> None:
    """An affine displacement comes back between the points to 0.15 px where it reaches up to 40 px."""
    points, matrix = scattered(), np.reshape(slopes, (2, 2))
    fitted = FreeForm.fit(points, points @ matrix + shift, 12.0)
    between = np.random.default_rng(3).uniform(18, 180, (500, 2))
    assert np.abs(fitted.at(between) - (between @ matrix + shift)).max() < 0.15


def test_refining_does_not_change_the_spline() -> None:
    """Control points of half the spacing give the same displacement everywhere."""
    controls = np.random.default_rng(0).normal(size=(7, 9, 2))
    coarse, fine = FreeForm(controls, np.zeros(2), 10.0), FreeForm(refine(controls), np.zeros(2), 5.0)
    points = np.random.default_rng(1).uniform(0, 40, (200, 2))
    np.testing.assert_allclose(fine.at(points), coarse.at(points), atol=1e-12)


def test_a_single_point_gets_the_control_points_of_least_norm() -> None:
    """Algorithm BA on one point is the pseudo-inverse of its 16 weights."""
    at, value = np.array([[13.0, 17.0]]), np.array([[2.0, -1.0]])
    controls = approximate(at, value, 10.0, (6, 6))
    across, down = basis(at / 10 - np.floor(at / 10))[0]
    weights = np.zeros((6, 6))
    weights[1:5, 1:5] = np.outer(down, across)
    expected = np.linalg.pinv(weights.reshape(1, -1)) @ value
    np.testing.assert_allclose(controls.reshape(-1, 2), expected, atol=1e-12)
