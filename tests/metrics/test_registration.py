"""Pictures as they are seen, the lattice of a sample, and the lattice followed through an output."""

from dataclasses import replace

import numpy as np
import pytest
import skimage.color
from cases import Case, case, scored
from scipy.ndimage import gaussian_filter

from nrbench.datasets_procedural.weave import Weave
from nrbench.imaging.convert import quantize
from nrbench.lattice.geometry import Lattice
from nrbench.lattice.relation import lattice_error
from nrbench.metrics.judgment.examination import examine
from nrbench.metrics.judgment.known_lattice import canonical_lattice, find_known_lattice, split_supercell
from nrbench.metrics.perception.limits import JND
from nrbench.metrics.perception.visible import measure_detail, measure_looks, perceive, perceive_sample, smooth_plane
from nrbench.metrics.quality import Quality
from nrbench.plugins.forms import Texture

SUPERCELLS = (
    [[2, 0], [0, 1]],
    [[1, 0], [0, 2]],
    [[2, 0], [0, 2]],
    [[3, 0], [0, 1]],
    [[4, 0], [1, 1]],
    [[1, 1], [-1, 1]],
)
BASES = ([[1, 1], [0, 1]], [[0, -1], [1, 3]])


def combine(lattice: Lattice, numbers: list[list[int]]) -> Lattice:
    """Return the lattice of integer combinations of the vectors, from another of its points."""
    matrix = lattice.matrix
    return Lattice.from_basis(np.array(numbers) @ matrix, tuple(lattice.origin + 2 * matrix[0] - matrix[1]))


@pytest.mark.parametrize("shape", [(40, 61), (9, 8)])
@pytest.mark.parametrize("mode", ["reflect", "nearest"])
def test_a_blur_is_that_of_scipy(shape: tuple[int, int], mode: str) -> None:
    """A plane, even one narrower than the Gaussian, is blurred as by scipy.ndimage."""
    plane = np.random.default_rng(0).random(shape, np.float32)
    expected = gaussian_filter(plane, 4.0, mode=mode, truncate=3)
    np.testing.assert_allclose(smooth_plane(plane, 4.0, mode == "reflect"), expected, rtol=1e-6)


@pytest.mark.parametrize("channels", [1, 3])
def test_large_areas_are_seen_in_cielab(channels: int) -> None:
    """A flat image has the CIELAB values of its color, gray ones have no chroma."""
    color = np.array((0.8, 0.4, 0.2)[:channels], np.float32)
    seen = perceive(np.broadcast_to(color, (24, 32, channels)).astype(np.float32))
    expected = skimage.color.rgb2lab(np.broadcast_to(color, 3))
    assert seen.shape == (24, 32, 4)
    np.testing.assert_allclose(seen, np.broadcast_to([*expected, expected[0]], seen.shape), atol=1e-3)
    assert channels == 3 or abs(seen[..., 1:3]).max() < 0.01


def test_fine_colors_are_not_seen() -> None:
    """A checkerboard of red and green pixels has less than a JND of chroma left, one of dark and bright is seen."""
    board = np.indices((32, 32)).sum(0) % 2 == 0
    colored = np.where(board[..., np.newaxis], (0.6, 0.4, 0.5), (0.4, 0.52, 0.5)).astype(np.float32)
    seen = perceive(colored)[8:-8, 8:-8]
    assert skimage.color.rgb2lab(colored)[..., 1].std() > 10 and seen[..., 1].std() < JND
    gray = np.where(board, 0.7, 0.4).astype(np.float32)[..., np.newaxis]
    assert perceive(gray)[8:-8, 8:-8, 3].std() > 10


def test_features_of_a_picture_follow_its_light_and_its_contrast() -> None:
    """Brighter pictures have a higher mean, and bands of half the amplitude are lower by 20 ln 2."""
    noise = np.random.default_rng(0).normal(0, 80, (96, 96)).astype(np.float32)
    lab = np.stack([50 + noise, 0 * noise, 0 * noise, 50 + noise], -1)
    half = np.stack([60 + noise / 2, 0 * noise, 0 * noise, 60 + noise / 2], -1)
    change = (measure_looks(half) - measure_looks(lab)).mean((0, 1))
    assert change[0] == pytest.approx(10, abs=0.3)
    assert change[4:7] == pytest.approx([-20 * np.log(2)] * 3, abs=0.5)


@pytest.mark.parametrize("numbers", SUPERCELLS)
def test_the_primitive_lattice_is_found_in_a_supercell(own: Case, numbers: list[list[int]]) -> None:
    """A rectangle of running bond, and cells of two to four tiles, give the lattice of one tile."""
    found = split_supercell(perceive_sample(own.texture.image), combine(own.lattice, numbers))
    assert found.area == pytest.approx(own.lattice.area, rel=1e-6)
    assert lattice_error(found, own.lattice, (192, 192)).relation == "exact"


def test_a_primitive_lattice_is_left(own: Case) -> None:
    """The lattice of one tile is not divided."""
    lattice = canonical_lattice(own.lattice)
    assert split_supercell(perceive_sample(own.texture.image), lattice) == lattice


def test_rough_bricks_of_two_tones_are_not_split() -> None:
    """Two bricks in turn of different tones, under strong grain, are one cell, whatever parts of it look alike."""
    y, x = np.indices((96, 96))
    tone = np.where((x % 16 < 3) | (y % 16 < 3), 0.4, np.where(x % 32 < 16, 0.4, 0.6))
    for seed in (1, 3):
        grain = gaussian_filter(np.random.default_rng(seed).standard_normal((96, 96)), 3)
        wall = (tone + 0.15 * grain / grain.std()).clip(0, 1).astype(np.float32)[..., np.newaxis].repeat(3, 2)
        assert split_supercell(
            perceive_sample(quantize(wall)), Lattice((32.0, 0.0), (0.0, 16.0))
        ).area == pytest.approx(512)


def test_any_basis_and_supercell_gives_one_verdict(own: Case) -> None:
    """Without the model, equivalent bases and supercells of the given lattice give equal scores."""
    plain = own.observe(own.planted("two-tone", 0.2, 1)[0], model=False)
    values = scored(Quality, plain).values
    for numbers in (*BASES, *SUPERCELLS[2::2]):
        other = replace(plain, truth=Texture(own.texture.image, combine(own.lattice, numbers)))
        assert scored(Quality, other).values == pytest.approx(values, abs=0.02), numbers


def test_a_lattice_that_nobody_gives_is_detected() -> None:
    """Without a truth the lattice of the sample is detected; a stochastic texture has none."""
    observation = replace(case("hexagon").observe(case("hexagon").fresh(), model=False), truth=None)
    known = find_known_lattice(observation)
    assert known.origin == "dominance" and known.lattice is not None
    assert lattice_error(known.lattice, case("hexagon").lattice, (128, 128)).relation == "exact"
    noise = Texture(observation.sample, kind="stochastic")
    assert find_known_lattice(replace(observation, truth=noise)).lattice is None


@pytest.mark.parametrize("model", [True, False])
def test_a_displaced_picture_is_followed(own: Case, model: bool) -> None:
    """The displacement of a crop from elsewhere is measured to a fifth of a pixel, modulo the lattice."""
    wide, moved = own.fresh(220), np.array([7.0, 11.0])
    pictures = [examine(own.observe(wide[y : y + 192, x : x + 192], model)).followed for x, y in ((0, 0), (7, 11))]
    vectors = pictures[0].net.vectors
    phases = [np.median(f.expected[f.in_place], 0) for f in pictures]
    rest = phases[0] - phases[1] - moved @ np.linalg.inv(vectors)
    assert np.hypot(*((rest - np.rint(rest)) @ vectors)) < 0.2
    assert all(f.in_place[f.valid].mean() > 0.98 for f in pictures)


@pytest.mark.parametrize("size", [0.1, 0.2, 0.35])
def test_a_phase_step_is_measured_in_px(own: Case, size: float) -> None:
    """The two halves of a picture differ by the planted displacement, to half a pixel."""
    image, field = own.planted("phase-step", size)
    followed = examine(own.observe(image)).followed
    column, row = np.moveaxis(np.rint(followed.centers).astype(int), -1, 0)
    inside = followed.valid & (np.minimum(row, column) >= 0) & (np.maximum(row, column) < 192)
    truth = field[row[inside], column[inside]]
    beyond = np.hypot(*truth.T) > 0
    near = followed.displacement[inside]
    start = np.median(near[~beyond] - np.rint(near[~beyond] - near[~beyond][0]), 0)
    rest = near[beyond] - start - truth[beyond] @ np.linalg.inv(followed.net.vectors)
    assert np.hypot(*np.median((rest - np.rint(rest)) @ followed.net.vectors, 0)) < 0.5


@pytest.mark.parametrize("model", [True, False])
def test_the_misfit_of_a_cell_is_that_at_its_displacement(own: Case, model: bool) -> None:
    """The misfits of single cells are those that windows of one cell have, by FFT, at the expected displacements."""
    picture = replace(examine(own.observe(own.fresh(), model)).reference.pictures[0], size=1)
    valid, costs = picture._compare_windows()
    i, j = (np.rint(picture.expected[valid] * picture.net.samples).astype(int) % picture.net.samples).T
    np.testing.assert_allclose(picture.misfit[valid], costs[range(len(costs)), i, j], rtol=1e-3, atol=1e-3)


def test_bending_leaves_all_tiles_in_place() -> None:
    """Threads that bend are followed: nearly all windows are in place, and the more they bend the more is measured."""
    bending = []
    for bend in (0.0, 0.4, 0.8):
        own = Case.of(Weave(color=0.15, noise=0.02, bend=bend), 5)
        followed = examine(own.observe(own.fresh())).followed
        assert followed.in_place[followed.valid].mean() > 0.95
        bending.append(followed.bending)
    assert bending[0] < 0.02 < 0.03 < bending[1] < bending[2]


def test_detail_has_directions_and_clusters() -> None:
    """Vertical stripes slope along x and horizontal ones along y; dots come in clusters, bright and dark ones apart."""
    rng = np.random.default_rng(0)
    stripes = 0.5 + 0.1 * np.sin(np.arange(64) * 1.2)[np.newaxis, :, np.newaxis] * np.ones((64, 1, 1))
    dots = 0.3 * (gaussian_filter(rng.standard_normal((64, 64, 1)), (1, 1, 0)) > 0.5)
    noise = 0.05 * rng.standard_normal((64, 64, 1))
    pictures = [stripes, np.swapaxes(stripes, 0, 1), 0.5 + noise, 0.3 + dots, 0.7 - dots]
    upright, level, even, bright, dark = (
        measure_detail(perceive(np.asarray(picture, np.float32))).mean((0, 1)) for picture in pictures
    )
    assert upright[0] > 20 and level[0] == pytest.approx(-upright[0], abs=0.1)
    assert abs(even[:2]).max() < 1.5 and abs(even[3]) < 1
    assert min(bright[2], dark[2]) > even[2] + 2 and bright[3] > 2 and dark[3] < -2
