"""Claims about image quilting."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthesis_cases import noise, places, synthesize

from nrbench.errors import BadInput
from nrbench.imaging.convert import Image
from nrbench.plugins.forms import Refused
from nrbench.synthesizers.patch_laying.raster_canvas import RasterCanvas, Spot
from nrbench.synthesizers.quilting import Quilting


def periodic(period: tuple[int, int], shape: tuple[int, int], channels: int = 3, seed: int = 0) -> Image:
    """Return a tile of noise of (rows, columns), repeated."""
    tile = noise(*period, channels, seed)
    return np.tile(tile, (shape[0] // period[0] + 1, shape[1] // period[1] + 1, 1))[: shape[0], : shape[1]]


@settings(max_examples=15)
@given(st.integers(6, 14), st.integers(0, 100), st.sampled_from([1, 3]))
def test_a_periodic_sample_is_continued_exactly(period: int, seed: int, channels: int) -> None:
    """With blocks of a period, the output of a sample with an integer period has this period, to the last bit."""
    sample = periodic((period, period), (3 * period, 4 * period), channels, seed)
    image = synthesize(Quilting(block=period), sample, (70, 61), seed=seed).image
    np.testing.assert_array_equal(image[period:], image[:-period])
    np.testing.assert_array_equal(image[:, period:], image[:, :-period])
    shifts = [np.roll(sample[:period, :period], (y, x), (0, 1)) for y in range(period) for x in range(period)]
    assert any(np.array_equal(image[:period, :period], shift) for shift in shifts)


@pytest.mark.parametrize("shape", [(64, 90), (1, 200), (9, 5)])
@pytest.mark.parametrize("channels", [1, 3])
def test_every_pixel_is_the_copy_that_the_map_names(shape: tuple[int, int], channels: int) -> None:
    """The output has the task's shape and consists of copies."""
    sample = noise(40, 50, channels)
    made = synthesize(Quilting(block=12), sample, shape)
    assert made.image.shape == (*shape, channels)
    assert made.source is not None
    assert (made.source[..., 2] == 1).all()
    x, y = made.source[..., :2].astype(int).reshape(-1, 2).T
    np.testing.assert_array_equal(made.image.reshape(-1, channels), sample[y, x])


@pytest.mark.parametrize("tolerance", [0.0, 0.1, 0.6])
def test_every_block_is_within_the_tolerance(tolerance: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """The overlap error of each block is at most 1 + tolerance times the least one, by naive loops over all places."""
    sample, block, overlap = noise(20, 23), 9, 3
    ratios = []

    def join(canvas: RasterCanvas, spot: Spot, place: tuple[int, int]) -> None:
        y, x = np.indices((block, block))
        known = (spot.left & (x < overlap)) | (spot.top & (y < overlap))
        old = canvas.image[canvas.window(spot)][known].astype(float)
        errors = {
            (x, y): np.sqrt(((canvas.sample[y : y + block, x : x + block][known] - old) ** 2).sum())
            for y in range(12)
            for x in range(15)
        }
        if spot.left or spot.top:
            ratios.append(errors[place] / min(errors.values()))
        original(canvas, spot, place)

    original = RasterCanvas.join_along_seam
    monkeypatch.setattr(RasterCanvas, "join_along_seam", join)
    # A sample of noise continues no block exactly beyond its edge, so the least error is seldom 0.
    with np.errstate(invalid="ignore"):
        synthesize(Quilting(block, overlap, tolerance), sample, (40, 40))
    ratios = [ratio for ratio in ratios if not np.isnan(ratio)]
    assert len(ratios) > 20
    assert max(ratios) <= 1 + tolerance + 1e-9
    assert (max(ratios) > 1) == (tolerance > 0)


def test_the_first_block_comes_from_anywhere() -> None:
    """Over many streams the first block takes all places of a small sample."""
    sample = noise(10, 10)
    first = {tuple(places(synthesize(Quilting(8, 2), sample, (8, 8), seed=k), 8)[0, 0]) for k in range(80)}
    assert len(first) == 9


@pytest.mark.filterwarnings("error")
def test_the_largest_tolerance_accepts_every_block() -> None:
    """At the end of its range the tolerance causes no overflow, and the second block comes from anywhere."""
    sample = noise(10, 10)
    made = [synthesize(Quilting(8, 2, 1e6), sample, (8, 14), seed=k).source for k in range(120)]
    assert len({tuple(source[4, 10, :2]) for source in made if source is not None}) == 9


@pytest.mark.parametrize("change", [{"block": 16}, {"overlap": 6}, {"tolerance": 0.5}])
def test_every_parameter_changes_something(change: dict[str, Any]) -> None:
    """Every parameter has an effect on noise."""
    base, other = (synthesize(Quilting(**given), noise(40, 40), (90, 90)).image for given in ({}, change))
    assert (base != other).any()


def test_an_automatic_overlap_is_a_sixth_of_the_block() -> None:
    """Leaving the overlap out equals giving a sixth."""
    sample = noise(50, 50)
    automatic, given_one = (synthesize(Quilting(24, overlap), sample, (80, 80)).image for overlap in (0, 4))
    np.testing.assert_array_equal(automatic, given_one)


def test_a_sample_smaller_than_a_block_is_refused_with_a_way_out() -> None:
    """The refusal says what would fit."""
    with pytest.raises(Refused, match="block <= 30"):
        synthesize(Quilting(block=31), noise(30, 60), (64, 64))


@pytest.mark.parametrize("block", [0, 20])
def test_an_overlap_too_wide_for_the_sample_is_refused_with_a_way_out(block: int) -> None:
    """If no block of the sample holds the overlap, the refusal names the largest overlap, and that one works."""
    with pytest.raises(Refused, match=r"overlap of 10 px; choose overlap <= 7, and leave block out"):
        synthesize(Quilting(block, overlap=10), noise(15, 40), (20, 20))
    synthesize(Quilting(overlap=7), noise(15, 40), (20, 20))


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"block": 2}, "3 px or more"),
        ({"block": -5}, "3 px or more"),
        ({"block": 12, "overlap": 7}, "half of the block"),
        ({"overlap": -1}, "half of the block"),
        ({"tolerance": -0.1}, "tolerance -0.1; choose 0"),
        ({"tolerance": float("nan")}, "tolerance nan; choose 0"),
        ({"tolerance": float("inf")}, "tolerance inf; choose 0"),
        ({"tolerance": 1e200}, r"tolerance 1e\+200; choose 0 .* to 1e\+06"),
    ],
)
def test_bad_parameters_are_named(parameters: dict[str, float], message: str) -> None:
    """The error says what may be given."""
    with pytest.raises(BadInput, match=message):
        Quilting(**parameters)  # type: ignore[arg-type]
