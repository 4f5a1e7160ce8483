"""Appearance: color, light and detail as a whole and at the worst place, seams, and tiles that claim to be seamless."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import pytest
from cases import Case, case, scored
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.metrics.appearance import Appearance, _Maps
from nrbench.metrics.perception.visible import measure_detail, perceive
from nrbench.metrics.registration.lattice_net import LatticeNet
from nrbench.metrics.seam_detection.line_kernels import steep_line_sums
from nrbench.metrics.seam_detection.seam_lines import find_worst_lines
from nrbench.plugins.forms import Observation, Texture
from nrbench.synthesizers.cartoon import Cartoon

appearance = partial(scored, Appearance)


@cache
def unplanted(own: Case, model: bool = True, k: int = 0) -> Mapping[str, Any]:
    """Return the columns of a fresh draw."""
    return appearance(own.observe(own.fresh(k=k), model)).values


RATIOS = ("local", "local_wide", "quarters", "whole", "detail", "surface", "contrast", "light", "tones", "lack")


@pytest.mark.parametrize("model", [True, False])
def test_a_fresh_draw_looks_like_one(own: Case, model: bool) -> None:
    """Fresh draws have ratios of at most about 1, and a score near 1."""
    found = [unplanted(own, model, k) for k in range(4)]
    assert np.mean([values["score"] for values in found]) >= 0.95
    for column in RATIOS:
        assert max(values[column] or 0 for values in found) < 1.15
    assert not model or np.mean([values["seam"] for values in found]) == pytest.approx(1, abs=0.35)


def test_detail_does_not_depend_on_where_a_checkerboard_is_cut() -> None:
    """Places of the cell count alike, so one line more along x and one less along y change no mean of the detail."""
    net = LatticeNet((128, 128), np.eye(2) * 27.4, np.zeros(2))
    details = []
    for shift in (0.0, 3.0):
        y, x = np.indices(net.shape)
        field = (np.floor((x + shift) / 13.7) + np.floor((y - shift) / 13.7)) % 2
        picture = np.float32(0.2 + 0.6 * field)[..., np.newaxis]
        details.append(_Maps(perceive(picture)).measure_parts(net)["detail"])
    assert abs(details[0] - details[1]).max() < 0.6


@pytest.mark.parametrize(
    ("kind", "size", "most"),
    [("color-mean", 0.1, 0.6), ("blurred-band", 0.5, 0.2), ("missing-tile", 1.0, 1.0)],
)
def test_planted_faults_are_seen(own: Case, kind: str, size: float, most: float) -> None:
    """A tint, a blurred band and a covered tile are farther from the references than the draw is."""
    before, after = unplanted(own), appearance(own.observe(own.planted(kind, size, 1)[0])).values
    assert after["score"] <= most
    columns = ("local", "local_wide", "quarters", "whole")
    assert max(after[name] for name in columns) > max(before[name] for name in columns)


def test_each_part_sees_its_own_fault(own: Case) -> None:
    """Light from one side changes quarters most, and a tint of everything the whole."""
    lit = own.edited("step of light", 0.16)
    tinted = np.clip(own.fresh() + np.array((0.08, 0.0, -0.08), np.float32), 0, 1)
    sided, whole = (appearance(own.observe(quantize(image))).values for image in (lit, tinted))
    assert sided["quarters"] > 1.2 and sided["quarters"] > whole["quarters"]
    assert whole["whole"] > 1.2


@pytest.mark.parametrize("material", ["clay", "stone", "wood"])
@pytest.mark.parametrize("model", [True, False])
def test_a_cartoon_is_no_material(material: Any, model: bool) -> None:
    """Tints and grain of the right covariances lack streaks, speckles and chips; a fresh draw has them."""
    own = Case.of(Hexagon(color=0.3, noise=0.01, period=21.3, material=material), 5)
    cartoon = appearance(own.observe(quantize(Cartoon().synthesize(own.task(seed=2)).image), model)).values
    fresh = unplanted(own, model, 1)
    assert cartoon["surface"] > (1.5 if model else 1.15) and cartoon["score"] < (0.1 if model else 0.7)
    assert fresh["surface"] < 1 and fresh["detail"] < 1


def gray_picture(image: Image) -> Image:
    """Return the mean of the channels, in each of them."""
    return np.repeat(image.mean(-1, keepdims=True), 3, 2)


@pytest.mark.parametrize("edit", [lambda image: image[..., ::-1], lambda image: image[..., [2, 0, 1]], gray_picture])
def test_other_colors_of_the_same_mean_are_a_contrast(own: Case, edit: Any) -> None:
    """Channels that are swapped, rotated or gray about the mean color have other variances and correlations."""
    mean = own.fresh().mean((0, 1))
    edited = quantize(np.clip(mean + edit(own.fresh() - mean), 0, 1))
    before, after = unplanted(own), appearance(own.observe(edited)).values
    assert before["contrast"] < 1 and after["contrast"] > 1.3


@pytest.mark.parametrize(
    ("column", "edit"),
    [
        ("light", lambda image, ramp: image + 0.24 * ramp),
        ("light", lambda image, ramp: image * (1 - 0.45 * (ramp**2 + ramp.transpose(1, 0, 2) ** 2) * 2)),
        ("tones", lambda image, ramp: np.round(image * 4) / 4),
    ],
    ids=["ramp", "corners", "five tones"],
)
def test_uneven_light_and_few_tones_are_seen(own: Case, column: str, edit: Any) -> None:
    """A ramp of 60 levels and dark corners change the light, and five tones leave plateaus."""
    ramp = np.linspace(-0.5, 0.5, 192, dtype=np.float32)[np.newaxis, :, np.newaxis] * np.ones((192, 1, 1), np.float32)
    edited = quantize(np.clip(edit(own.fresh(), ramp), 0, 1).astype(np.float32))
    before, after = unplanted(own), appearance(own.observe(edited)).values
    assert before[column] < 0.9 and after[column] > 1.15 and after["score"] < 0.65


def test_the_segment_forgives_what_the_sample_shows_and_nothing_else(own: Case) -> None:
    """A tint of the sample is forgiven to an output that has it, up to that of the sample, and no other tint is."""
    tint = np.array((0.08, 0.0, -0.08), np.float32)
    sample = quantize(np.clip(own.texture.image + tint, 0, 1))
    seen = []
    for shift in (0 * tint, tint / 2, tint, -tint, 2 * tint):
        output = quantize(np.clip(own.fresh() + shift, 0, 1))
        seen.append(appearance(replace(own.observe(output), sample=sample)).values["score"])
    assert min(seen[:3]) > 0.85 and max(seen[3:]) < 0.2


def test_a_blurred_hole_lacks_detail(own: Case) -> None:
    """A blurred part of two cells is seen by sample and lattice alone."""
    holed, side = np.array(own.fresh()), int(2 * np.linalg.norm(own.lattice.matrix, axis=1).max())
    before = unplanted(own, False)
    holed[60 : 60 + side, 60 : 60 + side] = gaussian_filter(own.fresh(), (6, 6, 0))[60 : 60 + side, 60 : 60 + side]
    after = appearance(own.observe(quantize(holed), model=False)).values
    assert before["lack"] < 1.15 and after["lack"] > 1.5 and after["score"] == 0


def _wall(inks: NDArray[Any], phase: int = 0) -> Image:
    """Paint a wall of bricks of 16 x 8 whole pixels, one number of an ink for each brick."""
    palette = np.array([(0.95, 0.75, 0.2), (0.85, 0.3, 0.25), (0.2, 0.42, 0.7)], np.float32)
    rows = [np.roll(np.repeat(palette[row], 16, 0), 8 * (k % 2), 0) for k, row in enumerate(inks)]
    wall = np.repeat(np.array(rows), 8, 0)
    for k in range(len(inks)):
        wall[8 * k] = 0.9
        wall[8 * k : 8 * k + 8, 8 * (k % 2) :: 16] = 0.9
    return quantize(np.roll(wall, phase, (0, 1)))


def test_pixel_art_looks_the_same_at_odd_and_at_even_pixels() -> None:
    """The kind of detail of elements that lie on whole pixels does not depend on where they lie."""
    wall = _wall(np.random.default_rng(0).integers(0, 3, (16, 8)))
    even, odd = (measure_detail(perceive(np.roll(wall, k, (0, 1)))).mean((0, 1)) for k in (0, 1))
    assert np.abs(even - odd).max() < 0.4


def test_equal_neighbors_lack_nothing() -> None:
    """Equal elements side by side, as prints have them by chance, lack no detail; a blurred hole there does."""
    rng = np.random.default_rng(1)
    lattice = Lattice((16.0, 0.0), (8.0, 8.0))
    inks = rng.integers(0, 3, (32, 16))
    inks[8:14, 4:7] = 0
    output = _wall(inks)
    sample = Texture(_wall(rng.integers(0, 3, (16, 8))), lattice, (lattice,))
    hole = output.copy()
    hole[100:140, 100:150] = gaussian_filter(output, (4, 4, 0))[100:140, 100:150]
    whole, holed = (appearance(Observation(sample.image, image, sample)).values["lack"] for image in (output, hole))
    assert whole < 1 < 1.3 < holed


def test_stronger_blur_is_farther(own: Case) -> None:
    """The distance of the whole grows with the blur, from .6 to 4 px."""
    found = [appearance(own.observe(own.edited("blur, px", sigma))).values for sigma in (0.6, 1.2, 2.4, 4.0)]
    assert np.all(np.diff([values["whole"] for values in found]) > 0)
    assert found[-1]["score"] == 0


def test_the_seam_is_drawn_where_it_is() -> None:
    """The worst line of an image with one step lies on the step, and the picture marks it."""
    image = np.array(case("weave").fresh())
    image[:, 70:] = np.clip(image[:, 70:] + 0.1, 0, 1)
    step, _ = find_worst_lines(quantize(image), case("weave").lattice)
    assert [x for x, _ in step.ends] == pytest.approx([69.5, 69.5], abs=1.5)
    score = appearance(case("weave").observe(quantize(image)))
    assert score.values["seam"] > 1.5 and score.values["seam_step"] == pytest.approx(0.1, abs=0.04)
    marked = score.pictures["seam"]
    assert set(np.flatnonzero((marked != quantize(image)).any((0, 2)))) <= {68, 69, 70, 71}


@pytest.mark.parametrize("shape", [(12, 16), (300, 40)])
def test_line_sums_are_those_of_strips(shape: tuple[int, int]) -> None:
    """Sums along lines, of every second lean of 512, have the bytes of those that join all strips level by level."""
    image = np.random.default_rng(0).random(shape, np.float32)
    size = 1 << (max(shape) - 1).bit_length()
    lines = np.pad(image, ((0, size - shape[0]), (size, 3 * size - shape[1])))[:, np.newaxis]
    while len(lines) > 1:
        leans = np.arange(2 * lines.shape[1])
        lower = [np.roll(lines[1::2, lean // 2], -((lean + 1) // 2), -1) for lean in leans]
        lines = lines[::2, leans // 2] + np.stack(lower, 1)
    np.testing.assert_array_equal(steep_line_sums(image), lines[0, :: max(size // 256, 1), : 2 * size])


@pytest.mark.parametrize("angle", [10.0, 60.0, 100.0, 160.0])
def test_seams_are_found_in_any_direction(angle: float) -> None:
    """A step across a line in any direction is found on that line."""
    y, x = np.indices((128, 160)).astype(float)
    normal = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
    beyond = (x - 80) * normal[0] + (y - 64) * normal[1] > 0
    noise = np.random.default_rng(0).normal(0.5, 0.05, (128, 160))
    image = np.clip(noise + 0.1 * beyond, 0, 1).astype(np.float32)[..., np.newaxis]
    step, _ = find_worst_lines(image, None)
    for end in step.ends:
        assert abs((np.array(end) - (80, 64)) @ normal) < 6


def test_a_texture_without_lattice_is_scored() -> None:
    """Appearance needs no lattice, and the sample is like itself."""
    noise = np.random.default_rng(0).random((128, 128, 1), np.float32)
    score = appearance(Observation(noise, noise, Texture(noise, kind="stochastic")))
    assert score.values["score"] == 1 and score.values["seam"] == pytest.approx(1)
    assert score.records["reference"] == "sample"


def test_small_outputs_leave_the_seam_open() -> None:
    """The seam of an output of 12 px is undecided."""
    score = appearance(case("brick").observe(case("brick").fresh()[:12, :12], model=False))
    assert score.reasons["seam"].startswith("undecided")


WRAPPING = gaussian_filter(np.random.default_rng(0).random((48, 64, 1), np.float32), (3, 3, 0), mode="wrap")
"""A periodic image."""


@pytest.mark.parametrize(
    ("extras", "size"),
    [({"tile": WRAPPING}, 3072), ({"tile": WRAPPING[..., 0]}, 3072), ({"tileable": np.array(1)}, 192 * 192 * 3)],
)
def test_claimed_tiles_are_measured(extras: Mapping[str, NDArray[Any]], size: int) -> None:
    """The border and size of a tile in the extras, or of an output that claims to be tileable, are measured."""
    observation = replace(case("brick").observe(case("brick").fresh()), extras=extras)
    values = appearance(observation).values
    assert values["tileable"] is not None and values["tileable"] > 0
    assert values["tile_bytes"] == pytest.approx(size / observation.sample.size)


@pytest.mark.parametrize("extras", [{}, {"tileable": np.array(0)}, {"tile": np.zeros((2, 9))}, {"tile": np.zeros(9)}])
def test_no_claim_is_no_score(extras: Mapping[str, NDArray[Any]]) -> None:
    """Without a usable tile or a claim both columns are None, with the reason."""
    why = "no image of at least" if "tile" in extras else "does not claim"
    score = appearance(replace(case("brick").observe(case("brick").fresh(), model=False), extras=extras))
    assert why in score.reasons["tileable"] and why in score.reasons["tile_bytes"]


def test_basis_and_origin_of_the_truth_do_not_matter() -> None:
    """Another basis and origin of the lattice change no ratio by more than a twentieth."""
    observation = case("hexagon").observe(case("hexagon").fresh())
    a, b = case("hexagon").lattice.matrix
    other = Lattice.from_basis([2 * a + b, a + b], case("hexagon").lattice.origin + 3 * a - b)
    moved = appearance(replace(observation, truth=replace(case("hexagon").texture, lattice=other))).values
    own = unplanted(case("hexagon"))
    for column in ("score", *RATIOS):
        assert moved[column] == pytest.approx(own[column], abs=0.05), column


def test_textures_that_hardly_vary_have_finite_scores() -> None:
    """A flat image has finite scores."""
    flat = np.full((64, 64, 3), 0.5, np.float32)
    values = appearance(Observation(flat, flat, Texture(flat))).values
    assert all(np.isfinite(float(value)) for value in values.values() if value is not None)
