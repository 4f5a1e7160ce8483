from collections.abc import Mapping
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import spearmanr, wasserstein_distance

from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.metrics.appearance import (
    Appearance,
    border_excess,
    color_histograms,
    color_scale,
    histogram_distance,
    histograms,
)
from nrbench.metrics.seam_detection.seam_lines import find_worst_lines
from nrbench.plugins.forms import Observation, Texture

from .conftest import MODELS, Case, case, scored

appearance = partial(scored, Appearance)


@cache
def fresh_values(name: str, k: int, side: int = 192) -> Mapping[str, Any]:
    """Return the scores of a fresh draw."""
    return appearance(case(name).observe(case(name).fresh(side, k))).values


def value(case: Case, image: Image, column: str) -> float:
    """Return one column."""
    found = appearance(case.observe(image)).values[column]
    assert found is not None
    return float(found)


@pytest.mark.parametrize("name", MODELS)
def test_a_fresh_draw_looks_like_one(name: str) -> None:
    """Fresh draws have ratios of about 1 and small distances."""
    values = [fresh_values(name, k) for k in range(3)]
    for column in ("sharpness", "sharpness_worst", "seam"):
        assert np.mean([one[column] for one in values]) == pytest.approx(1, abs=0.25)
    assert max(one["color"] for one in values) < 0.03
    assert max(one["spectrum"] for one in values) < 1


@pytest.mark.parametrize(
    ("kind", "column", "sizes", "sign", "side"),
    [
        ("color-mean", "color", (0.05, 0.1, 0.2, 0.4), 1, 96),
        ("blurred-band", "sharpness_worst", (0.1, 0.25, 0.5, 1.0), -1, 192),
        ("seam", "seam", (0.05, 0.1, 0.2, 0.4), 1, 128),
    ],
)
@pytest.mark.parametrize("name", MODELS)
def test_each_score_follows_its_defect(
    name: str, kind: str, column: str, sizes: tuple[float, ...], sign: int, side: int
) -> None:
    """Over single images the rank correlation of defect size and score is at least 0.95."""
    pairs = [(size, seed) for size in sizes for seed in range(2)]
    found = [value(case(name), case(name).planted(kind, size, seed, side)[0], column) for size, seed in pairs]
    assert sign * spearmanr([size for size, _ in pairs], found).statistic >= 0.95


@pytest.mark.parametrize(
    ("kind", "size", "columns"),
    [
        ("color-mean", 0.2, ("sharpness_worst", "seam")),
        ("blurred-band", 0.3, ("seam",)),
        ("seam", 0.1, ("sharpness_worst", "gradient")),
        ("two-tone", 0.3, ("sharpness_worst", "gradient")),
    ],
)
def test_scores_ignore_other_defects(kind: str, size: float, columns: tuple[str, ...]) -> None:
    """A defect of one kind leaves the scores for other defects within the range of fresh draws."""
    image, _ = case("hexagon").planted(kind, size)
    own = appearance(case("hexagon").observe(image)).values
    fresh = [fresh_values("hexagon", k) for k in range(4)]
    for column in columns:
        usual = [float(one[column]) for one in fresh]
        assert abs(own[column] - np.mean(usual)) < max(6 * np.std(usual), 0.15 * np.mean(usual)), column


def test_the_phase_of_the_output_does_not_matter() -> None:
    """Cropping the output elsewhere changes no score by more than fresh draws scatter."""
    wide = case("hexagon").fresh(210)
    one, other = (
        appearance(case("hexagon").observe(wide[y : y + 200, x : x + 200])).values for x, y in ((0, 0), (7, 4))
    )
    for column in ("sharpness", "sharpness_worst", "seam"):
        assert one[column] == pytest.approx(other[column], abs=0.2)
    assert one["color"] == pytest.approx(other["color"], abs=0.005)


def test_the_seam_is_drawn_where_it_is() -> None:
    """The worst line of an image with one step lies on the step, and the picture marks it."""
    image = np.array(case("weave").fresh())
    image[:, 70:] = np.clip(image[:, 70:] + 0.1, 0, 1)
    step, _ = find_worst_lines(quantize(image), case("weave").lattice)
    assert [x for x, _ in step.ends] == pytest.approx([69.5, 69.5], abs=1.5)
    marked = appearance(case("weave").observe(quantize(image))).pictures["seam"]
    assert set(np.flatnonzero((marked != quantize(image)).any((0, 2)))) <= {68, 69, 70, 71}


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


def test_distances_are_those_of_wasserstein() -> None:
    """The distance of histograms is that of their values, and proportional to a shift of all colors."""
    rng = np.random.default_rng(0)
    one, other = rng.beta(2, 3, 4000).astype(np.float32), rng.beta(3, 2, 4000).astype(np.float32)
    found = histogram_distance(histograms(one[:, np.newaxis]), histograms(other[:, np.newaxis]))
    assert found == pytest.approx(wasserstein_distance(one, other), abs=1e-3)
    image = rng.random((64, 64, 3), np.float32) * 0.5
    moves = [histogram_distance(color_histograms(image), color_histograms(image + np.float32(d))) for d in (0.1, 0.2)]
    assert moves[1] == pytest.approx(2 * moves[0], rel=1e-3)
    gray = image[..., :1]
    moved = histogram_distance(color_histograms(gray), color_histograms(gray + np.float32(0.1)))
    assert moved * color_scale(1) == pytest.approx(0.1, rel=1e-3)


def test_photographs_are_compared_with_the_sample() -> None:
    """Without fresh draws the sample is the reference, and its distance to itself is 0."""
    score = appearance(case("brick").observe(case("brick").texture.image, model=False))
    assert score.records["reference"] == "sample"
    assert score.values["color"] == 0 and score.values["seam"] == pytest.approx(1)


def test_a_texture_without_lattice_is_scored() -> None:
    """Appearance needs no lattice."""
    observation = case("brick").observe(case("brick").fresh(), model=False)
    assert appearance(replace(observation, truth=None)).values["seam"] is not None


def test_small_outputs_leave_the_seam_open() -> None:
    """The seam of an output of 12 px is undecided."""
    score = appearance(case("brick").observe(case("brick").fresh()[:12, :12], model=False))
    assert score.reasons["seam"].startswith("undecided")


def wrapping(seed: int = 0) -> Image:
    """Return a periodic image."""
    spectrum = np.fft.fft2(np.random.default_rng(seed).random((48, 64)))
    fy, fx = np.meshgrid(np.fft.fftfreq(48), np.fft.fftfreq(64), indexing="ij")
    smooth = np.fft.ifft2(spectrum * np.exp(-200 * (fx**2 + fy**2))).real
    low, high = smooth.min(), smooth.max()
    return ((smooth - low) / (high - low)).astype(np.float32)[..., np.newaxis]


def test_a_periodic_tile_has_no_visible_border() -> None:
    """The border of a periodic tile has an excess of about 1 at most, wherever it is cut; that of half a tile more."""
    tile = wrapping()
    assert max(border_excess(np.roll(tile, shift, (0, 1))) for shift in range(0, 40, 9)) < 1.3
    assert border_excess(tile[:, :31]) > 3


@pytest.mark.parametrize(
    ("extras", "size"),
    [
        ({"tile": wrapping()}, 48 * 64),
        ({"tile": wrapping()[..., 0]}, 48 * 64),
        ({"tileable": np.array(1)}, 192 * 192 * 3),
    ],
)
def test_claimed_tiles_are_measured(extras: Mapping[str, NDArray[Any]], size: int) -> None:
    """The border and size of a tile in the extras, or of an output that claims to be tileable, are measured."""
    observation = replace(case("brick").observe(case("brick").fresh()), extras=extras)
    values = appearance(observation).values
    assert values["tileable"] is not None and values["tileable"] > 0
    assert values["tile_bytes"] == pytest.approx(size / observation.sample.size)


@pytest.mark.parametrize(
    ("extras", "why"),
    [
        ({}, "does not claim"),
        ({"tileable": np.array(0)}, "does not claim"),
        ({"tile": np.zeros((2, 9))}, "no image of at least"),
        ({"tile": np.zeros(9)}, "no image of at least"),
    ],
)
def test_no_claim_is_no_score(extras: Mapping[str, NDArray[Any]], why: str) -> None:
    """Without a usable tile or a claim both columns are None, with the reason."""
    score = appearance(replace(case("brick").observe(case("brick").fresh(64)), extras=extras))
    assert why in score.reasons["tileable"] and why in score.reasons["tile_bytes"]


def test_basis_and_origin_of_the_truth_do_not_matter() -> None:
    """Another basis or origin changes the seam by less than fresh draws scatter, and no other score."""
    observation = case("hexagon").observe(case("hexagon").fresh())
    assert observation.truth is not None and observation.truth.lattice is not None
    a, b = np.array(observation.truth.lattice.t1), np.array(observation.truth.lattice.t2)
    other = Lattice(tuple(2 * a + b), tuple(a + b), (3.3, 7.1))
    moved = appearance(replace(observation, truth=replace(observation.truth, lattice=other))).values
    own = appearance(observation).values
    assert moved.pop("seam") == pytest.approx(own["seam"], abs=0.1)
    assert moved == {name: own[name] for name in moved}


def test_textures_that_hardly_vary_have_finite_scores() -> None:
    """A flat image has finite scores."""
    flat = np.full((64, 64, 3), 0.5, np.float32)
    values = appearance(Observation(flat, flat, Texture(flat))).values
    assert all(np.isfinite(float(one)) for one in values.values() if one is not None)
