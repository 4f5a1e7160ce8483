"""Claims about patch-based sampling."""

from typing import Any

import numpy as np
import pytest
from synthesis_cases import noise, synthesize

from nrbench.errors import BadInput
from nrbench.imaging.convert import Image, to_bytes
from nrbench.plugins.forms import Refused
from nrbench.synthesizers import patch_based
from nrbench.synthesizers.patch_based import PatchBased, Search
from nrbench.synthesizers.patch_laying.raster_canvas import RasterCanvas, Spot

SEARCHES: list[Search] = ["exhaustive", "kdtree"]


def rms_ratios(
    method: PatchBased, sample: Image, shape: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> list[tuple[float, float, float]]:
    """Return, for each patch but the first, its distance, the least of all places, and d_max, by naive loops."""
    size, zone, found = method.patch, method.zone, []
    rows, columns = sample.shape[0] - size + 1, sample.shape[1] - size + 1
    original = RasterCanvas.join_by_feathering

    def join(canvas: RasterCanvas, spot: Spot, place: tuple[int, int]) -> None:
        y, x = np.indices((size, size))
        known = (spot.left & (x < zone)) | (spot.top & (y < zone))
        if known.any():
            old = canvas.image[canvas.window(spot)][known].astype(float)
            every = {
                (x, y): np.sqrt(((canvas.sample[y : y + size, x : x + size][known] - old) ** 2).mean())
                for y in range(rows)
                for x in range(columns)
            }
            found.append((every[place], min(every.values()), method.epsilon * np.sqrt((old**2).mean())))
        original(canvas, spot, place)

    monkeypatch.setattr(RasterCanvas, "join_by_feathering", join)
    synthesize(method, sample, shape)
    return found


@pytest.mark.parametrize("search", SEARCHES)
@pytest.mark.parametrize("epsilon", [0.0, 0.3, 0.5])
def test_a_patch_fits_or_is_the_best(search: Search, epsilon: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each patch is within d_max. If none is, an exhaustive search takes the best one; there is always a patch."""
    monkeypatch.setattr(patch_based, "NEIGHBORS", 15)
    monkeypatch.setattr(patch_based, "SEARCH_ERROR", 0.0)
    method = PatchBased(9, 3, epsilon, search)
    found = rms_ratios(method, noise(24, 27, seed=2), (45, 45), monkeypatch)
    assert len(found) == 48
    for distance, least, limit in found:
        assert distance <= max(limit, least) + 1e-9 or search == "kdtree"
    if epsilon == 0.5:
        assert any(distance > least + 1e-9 for distance, least, _ in found)
    if search == "kdtree":
        # The tree finds patches that are much better than the mean one, even where none fits.
        assert np.mean([distance / least for distance, least, limit in found if least > limit] or [1]) < 1.15


def test_a_tree_that_finds_all_patches_misses_none_that_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    """If the tree returns all patches, each drawn patch is within d_max, or the best of all if none is."""
    monkeypatch.setattr(patch_based, "NEIGHBORS", 16 * 19)
    method = PatchBased(9, 3, 0.5, "kdtree")
    found = rms_ratios(method, noise(24, 27, seed=2), (45, 45), monkeypatch)
    assert all(distance <= max(limit, least) + 1e-9 for distance, least, limit in found)
    assert any(least > limit for _, least, limit in found) and any(distance > least for distance, least, _ in found)


@pytest.mark.parametrize(
    ("base", "change"),
    [
        ({}, {"patch": 16}),
        ({}, {"zone": 5}),
        ({}, {"epsilon": 1.0}),
        ({}, {"search": "kdtree"}),
    ],
)
def test_every_parameter_changes_something(base: dict[str, Any], change: dict[str, Any]) -> None:
    """Every parameter has an effect on noise."""
    first, other = (synthesize(PatchBased(**given), noise(40, 40), (90, 90)).image for given in (base, base | change))
    assert (first != other).any()


def test_all_patches_that_fit_are_drawn_alike() -> None:
    """Where every patch fits, the second one comes from anywhere."""
    sample = noise(10, 10, 1) * np.float32(0.1) + np.float32(0.5)
    method = PatchBased(8, 2, epsilon=1.0)
    made = [synthesize(method, sample, (8, 14), seed=k).source for k in range(120)]
    assert len({tuple(source[4, 10, :2]) for source in made if source is not None}) == 9


@pytest.mark.parametrize("search", SEARCHES)
@pytest.mark.parametrize("channels", [1, 3])
def test_a_periodic_sample_is_continued_exactly(search: Search, channels: int) -> None:
    """With patches of a period and epsilon 0, the output of a periodic sample has this period, to the last bit."""
    tile = noise(11, 11, channels, seed=3)
    image = synthesize(PatchBased(11, 3, 0.0, search), np.tile(tile, (3, 4, 1)), (60, 71)).image
    np.testing.assert_array_equal(image[11:], image[:-11])
    np.testing.assert_array_equal(image[:, 11:], image[:, :-11])


@pytest.mark.parametrize("search", SEARCHES)
@pytest.mark.parametrize("shape", [(64, 90), (1, 200), (9, 5)])
@pytest.mark.parametrize("channels", [1, 3])
def test_pixels_of_weight_1_are_copies(search: Search, shape: tuple[int, int], channels: int) -> None:
    """The output has the task's shape; outside the zones it consists of the copies that the map names."""
    sample = noise(40, 50, channels)
    made = synthesize(PatchBased(16, 4, search=search), sample, shape)
    assert made.image.shape == (*shape, channels)
    assert made.source is not None
    x, y, weight = np.moveaxis(made.source, -1, 0)
    copied = weight == 1
    assert copied.mean() > 0.3
    assert weight.min() > 0.25
    np.testing.assert_array_equal(made.image[copied], sample[y[copied].astype(int), x[copied].astype(int)])


def test_feathering_blends_the_two_patches_of_a_zone() -> None:
    """Across the zone between two patches, the output is the linear mean of both, to half a gray level."""
    sample = noise(30, 30, 3, seed=4)
    made = synthesize(PatchBased(12, 4, epsilon=10.0), sample, (12, 20))
    assert made.source is not None
    first, second = (made.source[6, x, :2].astype(int) - (x, 6) for x in (2, 14))
    values = to_bytes(sample).astype(float)
    for x in range(8, 12):
        share = (x - 7) / 5
        old = values[first[1] : first[1] + 12, first[0] + x]
        new = values[second[1] : second[1] + 12, second[0] + x]
        assert np.abs(made.image[:, x] * 255 - (share * new + (1 - share) * old)).max() <= 0.5 + 1e-3


def test_a_sample_smaller_than_a_patch_is_refused_with_a_way_out() -> None:
    """The refusal says what would fit."""
    with pytest.raises(Refused, match="patch <= 30"):
        synthesize(PatchBased(patch=31), noise(30, 60), (64, 64))


def test_a_zone_too_wide_for_the_sample_is_refused_with_a_way_out() -> None:
    """If no patch of the sample holds the default zone, the refusal names the widest zone, and that one works."""
    with pytest.raises(Refused, match=r"zone of 8 px; choose zone <= 4, and leave patch out"):
        synthesize(PatchBased(), noise(9, 40), (20, 20))
    synthesize(PatchBased(zone=4), noise(9, 40), (20, 20))


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"patch": 2}, "3 px or more"),
        ({"patch": 12, "zone": 7}, "half of the patch"),
        ({"zone": -1}, "zone -1"),
        ({"epsilon": -0.1}, "epsilon -0.1; choose 0"),
        ({"epsilon": float("nan")}, "epsilon nan; choose 0"),
        ({"epsilon": 1e200}, r"epsilon 1e\+200; choose 0 .* to 1e\+06"),
    ],
)
def test_bad_parameters_are_named(parameters: dict[str, float], message: str) -> None:
    """The error says what may be given."""
    with pytest.raises(BadInput, match=message):
        PatchBased(**parameters)  # type: ignore[arg-type]
