"""Claims about which patches are chosen, and where they lie."""

import itertools
import math
from dataclasses import replace
from typing import Any, get_args

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from synthesis_cases import FRACTIONAL, noise, places, synthesize

from nrbench.imaging.convert import Image, quantize, to_bytes
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Task
from nrbench.synthesizers.gap_filling.canvas import Places, SeamMethod
from nrbench.synthesizers.rsgf import GapFiller, Rsgf
from nrbench.synthesizers.sampling.patches import PLACE_STEP

SEAMS = get_args(SeamMethod)
PAPER = Rsgf(seam="blend", subpixel=False, tolerance=3.0, candidate_fraction=0.0, prefer_unused=False)
SMALL = replace(PAPER, block=8, border=2, tolerance=None)


def fill(sample: Image, shape: tuple[int, int], lattice: Lattice, tolerance: float = 1.5, seed: int = 1) -> Places:
    """Fill an output with sub-pixel patches of 8 px, and return their places."""
    method = replace(SMALL, subpixel=True, tolerance=tolerance)
    filler = GapFiller(method, Task(sample, shape, lattice, np.random.default_rng(seed)), lattice)
    filler.place_blocks()
    filler.fill_gaps()
    return filler.canvas.places


@pytest.mark.parametrize("method", [Rsgf(), PAPER])
@pytest.mark.parametrize("lattice", [Lattice((20, 5), (-4, 22)), FRACTIONAL])
def test_any_basis_of_the_lattice_gives_the_same_bytes(method: Rsgf, lattice: Lattice) -> None:
    """Long, skewed generating vectors of the same lattice change nothing."""
    skewed = Lattice(lattice.t1, (3 * lattice.t1[0] + lattice.t2[0], 3 * lattice.t1[1] + lattice.t2[1]))
    sample = noise(128, 128)
    one, other = (synthesize(method, sample, (100, 100), basis) for basis in (lattice, skewed))
    np.testing.assert_array_equal(one.image, other.image)


def test_a_fractional_lattice_does_not_drift() -> None:
    """Over 800 px placed patches keep within half a pixel of the real-valued lattice, gaps within the paper's 3 px."""
    made = synthesize(PAPER, noise(128, 128), (800, 800), FRACTIONAL)
    found = places(made, 40)
    rows, columns = np.indices(found.shape[:2])
    output = np.stack([columns, rows], -1) * 40
    placed = (rows + columns) % 2 == 0
    misplaced = np.abs(FRACTIONAL.wrap(found - output)).max(-1)
    assert misplaced[placed].max() <= 0.5 + 1e-9
    assert 0.1 * FRACTIONAL.s < misplaced[~placed].max() <= 3 + 1e-9


@pytest.mark.parametrize("reach", [0.0, 0.3, 1.5])
def test_sub_pixel_places_are_those_of_the_lattice(reach: float) -> None:
    """Over 400 px placed patches lie on the real-valued lattice, gaps' within the tolerance of it, however small."""
    found = fill(noise(60, 60), (400, 400), FRACTIONAL, reach)
    rows, columns = np.indices(found.shape[:2])
    misplaced = np.abs(FRACTIONAL.wrap(found - 8 * np.stack([columns, rows], -1))).max(-1)
    placed = (rows + columns) % 2 == 0
    assert misplaced[placed].max() <= PLACE_STEP
    assert misplaced[~placed].max() <= reach + PLACE_STEP
    assert reach == 0 or misplaced[~placed].max() > 2 * PLACE_STEP


def waves(shape: tuple[int, int], lattice: Lattice) -> Image:
    """Return a smooth texture with exactly this lattice."""
    x, y = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    u, v = np.moveaxis(lattice.to_cell(np.stack([x, y], -1)), -1, 0)
    return 0.5 + 0.2 * (np.cos(2 * math.pi * u) + np.cos(2 * math.pi * v))[..., np.newaxis].astype(np.float32)


@pytest.mark.parametrize("seam", SEAMS)
def test_a_smooth_fractional_texture_is_continued_without_drift_or_blur(seam: Any) -> None:
    """A periodic texture whose lattice is of no whole pixels comes back within two gray levels, seams included."""
    truth = waves((512, 512), FRACTIONAL)
    made = synthesize(Rsgf(seam=seam), quantize(truth[:128, :128]), (512, 512), FRACTIONAL)
    assert -10 * np.log10(((made.image - truth) ** 2).mean()) > 45
    assert np.abs(made.image - truth)[-100:, -100:].max() < 2.5 / 255


def test_at_whole_pixels_it_is_continued_less_well() -> None:
    """The paper's rounding of places costs more than 10 dB."""
    truth = waves((512, 512), FRACTIONAL)
    made = synthesize(PAPER, quantize(truth[:128, :128]), (512, 512), FRACTIONAL)
    assert 30 < -10 * np.log10(((made.image - truth) ** 2).mean()) < 40


def test_the_random_choice_is_uniform_over_the_candidates() -> None:
    """Each patch equal by the lattice and whole inside the sample, borders included, is drawn equally often."""
    sample, lattice = noise(60, 60, 1), Lattice((11, 2), (-3, 13))
    drawn = [tuple(places(synthesize(SMALL, sample, (8, 8), lattice, k), 8)[0, 0].tolist()) for k in range(3000)]
    room = range(2, 60 - 8 - 2 + 1)
    candidates = {(x, y) for x in room for y in room if np.abs(lattice.wrap([x, y])).max() < 1e-9}
    counts = {place: drawn.count(place) for place in set(drawn)}
    assert set(counts) == candidates
    assert stats.chisquare(list(counts.values())).pvalue > 1e-3


def test_so_it_is_at_sub_pixel_places() -> None:
    """Each real-valued place that shows a whole patch is drawn equally often."""
    sample = noise(60, 60, 1)
    drawn = [tuple(fill(sample, (8, 8), FRACTIONAL, seed=k)[0, 0].tolist()) for k in range(2000)]
    inside = FRACTIONAL.points((60, 60))
    inside = inside[((inside >= 2) & (inside <= 50)).all(1)]
    counts = [drawn.count(place) for place in set(drawn)]
    assert len(counts) == len(inside) > 4
    assert stats.chisquare(counts).pvalue > 1e-3


def test_in_stochastic_mode_every_place_is_drawn_equally_often() -> None:
    """As if v1 = (1, 0), v2 = (0, 1): a lattice that is given counts for nothing, and none is used."""
    method, sample = replace(SMALL, search="stochastic", candidate_fraction=None), noise(24, 24, 1)
    drawn = [synthesize(method, sample, (8, 8), Lattice((11, 2), (-3, 13)), k) for k in range(4000)]
    assert all(made.lattice is None and not made.note for made in drawn)
    at = np.array([places(made, 8)[0, 0] for made in drawn])
    counts = np.bincount((at[:, 1] - 2) * 13 + at[:, 0] - 2)
    assert len(counts) == 13**2
    assert stats.chisquare(counts).pvalue > 1e-3


def test_unit_vectors_are_the_stochastic_mode() -> None:
    """The lattice (1, 0), (0, 1) allows every place that the stochastic mode does."""
    sample, unit = noise(24, 24, 1), Lattice((1, 0), (0, 1))
    drawn = {tuple(places(synthesize(SMALL, sample, (8, 8), unit, k), 8)[0, 0].tolist()) for k in range(2500)}
    assert len(drawn) == 13**2


def naive_border(sample: Image, found: NDArray[np.int64], row: int, column: int) -> NDArray[np.float64]:
    """Return the full border of a gap of 8 px: each pixel from the nearest neighbour's continued patch, or NaN."""
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


def naive_rating(patch: NDArray[np.float64], border: NDArray[np.float64], match: str) -> float:
    """Rate a patch by equation 10 (negated), or equations 3 and 6, where the border is."""
    f, g = (part[~np.isnan(border[..., 0])].astype(float) for part in (patch, border))
    if match == "color":
        return -float(((f - g) ** 2).sum())
    f, g = f - f.mean(0), g - g.mean(0)
    weights = np.sqrt((f**2).sum(0) * (g**2).sum(0))
    return float((f * g).sum() / weights.sum())


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
    for row, column in [(i, j) for i, j in np.ndindex(3, 4) if (i + j) % 2]:
        border = naive_border(sample, found, row, column)
        ratings = {
            (x, y): naive_rating(to_bytes(sample)[y : y + 8, x : x + 8].astype(float), border, match)
            for x, y in itertools.product(range(37), range(33))
            if search == "everywhere" or allowed(lattice, x - 8 * column, y - 8 * row, tolerance or 0)
        }
        mine = ratings[tuple(found[row, column].tolist())]
        assert mine == pytest.approx(max(ratings.values()), abs=1e-9)


def allowed(lattice: Lattice, x: int, y: int, tolerance: float) -> bool:
    """Tell whether a vector is within the tolerance of one of the lattice."""
    steps = np.array(list(itertools.product(range(-9, 10), repeat=2))) @ lattice.matrix
    return bool((np.abs((x, y) - steps) <= tolerance + 1e-9).all(-1).any())
