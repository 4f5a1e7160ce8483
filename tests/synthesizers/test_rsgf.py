"""Claims about rsgf: what is continued, which patches it chooses, where they lie, and what is refused."""

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from synthesis_cases import FRACTIONAL, UPRIGHT, noise, places, synthesize, waves

from nrbench import plugins, texture
from nrbench.imaging.convert import Image, quantize, to_bytes
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Observation, Refused, Task
from nrbench.synthesizers.gap_filling.blocks import Places
from nrbench.synthesizers.rsgf import REMEMBERED, GapFiller, PlaceSampler, Rsgf, best_places
from nrbench.synthesizers.sample_reading.patches import PLACE_STEP


def test_the_papers_detector_stretches_the_weave() -> None:
    """On a weave of 12.3 x 13.9 px, the paper's vectors of whole pixels drift by over 2 %, the default's do not."""
    sample = texture("weave", (128, 128), 0, color=0.14)
    drift = {}
    for name, method in (("paper", Rsgf(**Rsgf.presets["paper"])), ("default", Rsgf())):
        task = Task(quantize(sample.image), (224, 224), None, np.random.default_rng(0))
        observation = Observation(task.sample, quantize(method.synthesize(task).image), truth=sample)
        drift[name] = plugins.build("metrics", "regularity").score(observation).values["drift"]
    assert drift["paper"] > 2 and drift["default"] < 0.5


def test_a_sample_of_less_than_two_periods_works_or_is_refused() -> None:
    """Small blocks work on a sample of 1.5 periods; blocks without an equal patch in it are refused."""
    sample, lattice = noise(60, 60), Lattice((40.3, 0), (3.1, 38.6))
    assert synthesize(Rsgf(block=8, border=2), sample, (90, 90), lattice).image.shape == (90, 90, 3)
    with pytest.raises(Refused, match="choose a smaller block"):
        synthesize(Rsgf(block=24, border=6), sample, (90, 90), lattice)


PAPER = Rsgf(seam="blend", subpixel=False, tolerance=3.0, candidate_fraction=0.0, prefer_unused=False)
SMALL = replace(PAPER, block=8, border=2, tolerance=None)


def fill(sample: Image, shape: tuple[int, int], lattice: Lattice, tolerance: float = 1.5, seed: int = 1) -> Places:
    """Fill an output with sub-pixel patches of 8 px, and return their places."""
    method = replace(SMALL, subpixel=True, tolerance=tolerance)
    filler = GapFiller(method, Task(sample, shape, lattice, np.random.default_rng(seed)), lattice)
    filler.place_blocks()
    filler.fill_gaps()
    return filler.placer.places


def test_a_fractional_lattice_does_not_drift() -> None:
    """Over 800 px placed patches stay within half a pixel of the real-valued lattice, gaps within the paper's 3 px."""
    made = synthesize(PAPER, noise(128, 128), (800, 800), FRACTIONAL)
    found = places(made, 40)
    rows, columns = np.indices(found.shape[:2])
    output = np.stack([columns, rows], -1) * 40
    placed = (rows + columns) % 2 == 0
    misplaced = np.abs(FRACTIONAL.wrap(found - output)).max(-1)
    assert misplaced[placed].max() <= 0.5 + 1e-9
    assert 0.1 * FRACTIONAL.s < misplaced[~placed].max() <= 3 + 1e-9


@pytest.mark.parametrize("shape", [(400, 48), (48, 400)])
@pytest.mark.parametrize("tolerance", [0.0, 0.3, 1.5])
def test_sub_pixel_places_are_those_of_the_lattice(tolerance: float, shape: tuple[int, int]) -> None:
    """Over 400 px placed patches lie on the real-valued lattice, and patches of gaps within any tolerance of it."""
    found = fill(noise(60, 60), shape, FRACTIONAL, tolerance)
    rows, columns = np.indices(found.shape[:2])
    misplaced = np.abs(FRACTIONAL.wrap(found - 8 * np.stack([columns, rows], -1))).max(-1)
    placed = (rows + columns) % 2 == 0
    assert misplaced[placed].max() <= PLACE_STEP
    assert misplaced[~placed].max() <= tolerance + PLACE_STEP
    assert tolerance == 0 or misplaced[~placed].max() > 2 * PLACE_STEP


def test_at_whole_pixels_it_is_continued_less_well() -> None:
    """The paper's rounding of places costs more than 10 dB."""
    truth = waves((256, 256), FRACTIONAL)
    made = synthesize(PAPER, quantize(truth[:128, :128]), (256, 256), FRACTIONAL)
    assert 30 < -10 * np.log10(((made.image - truth) ** 2).mean()) < 40


def first_places(method: Rsgf, sample: Image, lattice: Lattice | None, count: int) -> NDArray[np.float64]:
    """Draw the place of the first block of 8 px many times: ``(count, 2)``."""
    filler = GapFiller(method, Task(sample, (8, 8), lattice, np.random.default_rng(0)), lattice)
    drawn = np.empty((count, 2))
    for k in range(count):
        filler.place_blocks()
        drawn[k] = filler.placer.places[0, 0]
    return drawn


@pytest.mark.parametrize(("lattice", "subpixel"), [(Lattice((11, 2), (-3, 13)), False), (FRACTIONAL, True)])
def test_the_random_choice_is_uniform_over_the_candidates(lattice: Lattice, subpixel: bool) -> None:
    """Each patch equal by the lattice and inside the sample with its borders is drawn equally often."""
    found = first_places(replace(SMALL, subpixel=subpixel), noise(60, 60, 1), lattice, 3000)
    drawn, counts = np.unique(found, axis=0, return_counts=True)
    inside = lattice.points((60, 60))
    inside = inside[((inside >= 2) & (inside <= 50)).all(1)]
    assert len(drawn) == len(inside) > 4
    np.testing.assert_allclose(drawn, inside[np.lexsort(inside.T[::-1])], atol=PLACE_STEP * subpixel)
    assert stats.chisquare(counts).pvalue > 1e-3


def test_in_stochastic_mode_every_place_is_drawn_equally_often() -> None:
    """As if v1 = (1, 0), v2 = (0, 1): a lattice that is given has no effect and is not reported."""
    method, sample = replace(SMALL, search="stochastic", candidate_fraction=None), noise(24, 24, 1)
    for seed in range(5):
        given, none = (synthesize(method, sample, (24, 24), one, seed) for one in (Lattice((11, 2), (-3, 13)), None))
        assert given.lattice is None and not given.note
        np.testing.assert_array_equal(given.image, none.image)
    at = first_places(method, sample, None, 4000).astype(int)
    counts = np.bincount((at[:, 1] - 2) * 13 + at[:, 0] - 2)
    assert len(counts) == 13**2
    assert stats.chisquare(counts).pvalue > 1e-3


def naive_border(sample: Image, found: NDArray[np.int64], row: int, column: int) -> NDArray[np.float64]:
    """Return the full border of a gap of 8 px: each pixel from the nearest neighbor's continued patch, or NaN."""
    pixels = np.full((8, 8, sample.shape[2]), np.nan)
    rows, columns = found.shape[:2]
    for y, x in itertools.product(range(8), range(8)):
        near = [(x, 0, -1), (y, -1, 0), (7 - x, 0, 1), (7 - y, 1, 0)]
        near = [(d, i, j) for d, i, j in near if 0 <= row + i < rows and 0 <= column + j < columns]
        distance, i, j = min(near, key=lambda one: (one[0], one[1] != 0))
        if distance < 2:
            sx, sy = found[row + i, column + j]
            pixels[y, x] = to_bytes(sample)[sy + y - 8 * i, sx + x - 8 * j]
    return pixels


def naive_ratings(patches: NDArray[np.float64], border: NDArray[np.float64], match: str) -> NDArray[np.float64]:
    """Rate patches ``(n, 8, 8, C)`` by equation 10 (negated), or equations 3 and 6, where the border is."""
    known = ~np.isnan(border[..., 0])
    f, g = patches[:, known], border[known]
    if match == "color":
        return -((f - g) ** 2).sum((1, 2))
    f, g = f - f.mean(1, keepdims=True), g - g.mean(0)
    weights = np.sqrt((f**2).sum(1) * (g**2).sum(0))
    return np.asarray((f * g).sum((1, 2)) / weights.sum(1))


@pytest.mark.parametrize("match", ["ncc", "color"])
@pytest.mark.parametrize(
    ("search", "tolerance"), [("lattice", 1.0), ("lattice", 3.0), ("lattice", math.inf), ("everywhere", None)]
)
def test_gaps_take_the_best_of_the_patches_allowed(match: Any, search: Any, tolerance: float | None) -> None:
    """By brute force over a border composed naively of wedges, no allowed patch matches a gap better."""
    sample, lattice = noise(40, 44), Lattice((9.3, 1.2), (-2.1, 10.4))
    fraction = 0.0 if search == "lattice" else None
    method = replace(SMALL, match=match, search=search, tolerance=tolerance, candidate_fraction=fraction)
    found = places(synthesize(method, sample, (24, 32), lattice), 8)
    steps = np.array(list(itertools.product(range(-9, 10), repeat=2))) @ lattice.matrix
    every = np.array([(x, y) for y in range(33) for x in range(37)])
    patches = np.array([to_bytes(sample)[y : y + 8, x : x + 8].astype(float) for x, y in every])
    for row, column in [(i, j) for i, j in np.ndindex(3, 4) if (i + j) % 2]:
        away = (every - (8 * column, 8 * row))[:, np.newaxis] - steps
        allowed = search == "everywhere" or (np.abs(away) <= (tolerance or 0) + 1e-9).all(-1).any(-1)
        ratings = np.where(allowed, naive_ratings(patches, naive_border(sample, found, row, column), match), -np.inf)
        x, y = found[row, column].tolist()
        assert ratings[37 * y + x] == pytest.approx(ratings.max(), abs=1e-9)


def test_deformed_gaps_meet_on_a_bent_sample() -> None:
    """On a smooth bent sample that is taken as it is, deformed gaps halve the largest step across a seam."""
    y, x = np.indices((128, 128)).astype(float)
    moved = np.stack([x + 2 * np.sin(2 * math.pi * y / 90), y + 2 * np.sin(2 * math.pi * x / 90)], -1)
    across, down = np.moveaxis(np.cos(2 * math.pi * UPRIGHT.to_cell(moved)), -1, 0)
    sample = quantize((0.5 + 0.2 * (across + down))[..., np.newaxis].astype(np.float32))
    steps = []
    for deform in (0.0, 3.0):
        made = synthesize(Rsgf(deform=deform), sample, (200, 200), UPRIGHT)
        steps.append(np.abs(np.diff(made.image[..., 0], 2, axis=0)).max())
    assert steps[1] < steps[0] / 2


def test_patches_that_do_not_overlap_are_used_in_turn() -> None:
    """Of nine separate places none is drawn again before all have been drawn, in a random order."""
    places, orders = 10 * np.array([*np.ndindex(3, 3)]), set()
    for seed in range(5):
        sampler = PlaceSampler(np.random.default_rng(seed), 10, prefer_unused=True)
        rounds = [[tuple(sampler.draw(places)) for _ in places] for _ in range(REMEMBERED // 9)]
        assert all(len(set(drawn)) == 9 for drawn in rounds)
        orders |= {tuple(drawn) for drawn in rounds}
    assert len(orders) > 30


def test_the_first_draw_is_uniform_and_all_are_without_preference() -> None:
    """Each place is drawn equally often: in first draws, and in all draws without preference."""
    places = 4 * np.array([*np.ndindex(3, 3)])
    first = [PlaceSampler(np.random.default_rng(k), 10, prefer_unused=True).draw(places) for k in range(1800)]
    sampler = PlaceSampler(np.random.default_rng(0), 10, prefer_unused=False)
    later = [sampler.draw(places) for _ in range(1800)]
    for drawn in (first, later):
        counts = np.unique(np.array(drawn), axis=0, return_counts=True)[1]
        assert len(counts) == 9
        assert stats.chisquare(counts).pvalue > 1e-3


def test_a_place_is_shown_by_patches_that_overlap_it_in_part() -> None:
    """A patch counts 1 for its own place, a quarter for a place half a patch aside both ways, 0 for a separate one."""
    sampler = PlaceSampler(np.random.default_rng(0), 10, prefer_unused=True)
    sampler.draw(np.array([[20, 20]]))
    np.testing.assert_allclose(sampler.overlap_counts(np.array([[20, 20], [25, 15], [30, 20]])), [1, 0.25, 0])


def test_what_was_laid_long_ago_counts_no_more() -> None:
    """After as many patches elsewhere as are remembered a place counts as unused."""
    sampler = PlaceSampler(np.random.default_rng(0), 10, prefer_unused=True)
    sampler.draw(np.array([[0, 0]]))
    for _ in range(REMEMBERED):
        sampler.draw(np.array([[50, 50]]))
    assert sampler.overlap_counts(np.array([[0, 0]])) == 0


def test_of_each_place_the_best_candidate_and_of_places_the_best_share() -> None:
    """Of four places rated 4 > 3 > 2 = 2, the best fraction is taken with all ties, one candidate per place."""
    lattice = Lattice((10.4, 0), (0, 9.7))
    at = np.array([3.2, 4.1])
    near = np.rint(at + np.array([(0, 0), (1, 0), (0, 1), (1, 1)]) @ lattice.matrix).astype(np.int64)
    candidates = np.concatenate([near, near + np.array([2, 1]), near - np.array([1, 3])])
    ratings = np.array([1.0, 0, 2, 2, 4, -1, 0, 0, 0, 3, 0, 0])
    best = {share: best_places(candidates, ratings, lattice, at, share) for share in (0.0, 0.5, 0.75, 1.0)}
    first, second = tuple(near[0] + [2, 1]), tuple(near[1] - [1, 3])
    assert {tuple(place) for place in best[0.0]} == {first}
    assert {tuple(place) for place in best[0.5]} == {first, second}
    every = {first, second, tuple(near[2]), tuple(near[3])}
    assert {tuple(place) for place in best[0.75]} == {tuple(place) for place in best[1.0]} == every


def test_blocks_follow_a_small_sample() -> None:
    """An icon of 48 px gets the largest blocks that fit, and the note says so; given sizes are kept, or refused."""
    icon = quantize(waves((48, 48), FRACTIONAL))
    made = synthesize(Rsgf(), icon, (90, 90), FRACTIONAL)
    assert made.image.shape == (90, 90, 3) and "the sample allows no larger ones" in made.note
    sample = quantize(waves((128, 128), FRACTIONAL))
    made, given = (synthesize(one, sample, (90, 90), FRACTIONAL) for one in (Rsgf(), Rsgf(block=40, border=10)))
    np.testing.assert_array_equal(made.image, given.image)
    with pytest.raises(Refused):
        synthesize(Rsgf(block=40), icon, (90, 90), FRACTIONAL)
