import itertools
import math
from dataclasses import replace
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from nrbench.errors import BadInput
from nrbench.imaging.blocks import BlockGrid
from nrbench.imaging.canvas import Canvas, Seam
from nrbench.imaging.door import Image, quantize, to_bytes
from nrbench.imaging.patches import FINEST, Patches
from nrbench.imaging.sampling import room_for
from nrbench.lattice.detection import Detection, NoLatticeFound
from nrbench.lattice.geometry import Lattice
from nrbench.outputs import checked_synthesis
from nrbench.synthesis import Refused, Synthesis, Task
from nrbench.synthesizers.filling import Filling, Rules
from nrbench.synthesizers.rsgf import Rsgf

SEAMS = get_args(Seam)
PAPER = Rsgf(seam="blend", subpixel=False)
SMALL = replace(PAPER, block=8, border=2)
TURNED = math.radians(7)
FRACTIONAL = Lattice(
    (21.37 * math.cos(TURNED), 21.37 * math.sin(TURNED)), (-18.81 * math.sin(TURNED), 18.81 * math.cos(TURNED))
)


def noise(height: int, width: int, channels: int = 3, seed: int = 0) -> Image:
    """Return noise of 8 bits."""
    return quantize(np.random.default_rng(seed).random((height, width, channels), np.float32))


def synthesize(
    method: Rsgf, sample: Image, shape: tuple[int, int], lattice: Lattice | None, seed: int = 1
) -> Synthesis:
    """Run the method."""
    return method.synthesize(Task(sample, shape, lattice, np.random.default_rng(seed)))


def places(made: Synthesis, block: int) -> NDArray[np.int64]:
    """Read the (x, y) in the sample of every block's first pixel off the source map at the blocks' middles."""
    assert made.source is not None
    middle = made.source[block // 2 :: block, block // 2 :: block]
    assert (middle[..., 2] == 1).all()
    return middle[..., :2].astype(np.int64) - block // 2


def filled(sample: Image, shape: tuple[int, int], lattice: Lattice, reach: float = 1.5, seed: int = 1) -> Canvas:
    """Fill an output with sub-pixel patches of 8 px, as the method does, and return what tells their places."""
    canvas = Canvas(Patches(sample), BlockGrid(shape, 8, 2))
    task = Task(sample, shape, lattice, np.random.default_rng(seed))
    filling = Filling(task, lattice, canvas, Rules("color", "lattice", reach, True, 0.0))
    filling.sample_placed(room_for(12, (sample.shape[0], sample.shape[1])))
    filling.fill_gaps()
    return canvas


@pytest.mark.parametrize("match", ["ncc", "color"])
@pytest.mark.parametrize("search", ["lattice", "everywhere"])
@pytest.mark.parametrize("channels", [1, 3])
def test_a_whole_pixel_lattice_is_continued_exactly(match: Any, search: Any, channels: int) -> None:
    """On a perfectly periodic sample the output is the periodic continuation, phase included, to the bit."""
    picture = np.tile(noise(24, 30, channels), (13, 13, 1))
    method = Rsgf(match=match, search=search)
    for shape in ((256, 256), (1, 300), (300, 1), (9, 5)):
        made = synthesize(method, picture[:128, :128], shape, Lattice((30, 0), (0, 24)))
        np.testing.assert_array_equal(quantize(made.image), picture[: shape[0], : shape[1]])


@pytest.mark.parametrize("seam", SEAMS)
@pytest.mark.parametrize("subpixel", [False, True])
@pytest.mark.parametrize("deform", [0.0, 2.0])
def test_so_it_is_with_every_joint(seam: Any, subpixel: bool, deform: float) -> None:
    """Where patches continue each other no seam, no sub-pixel move and no deformation leaves a trace."""
    picture = np.tile(noise(24, 30), (6, 6, 1))
    method = Rsgf(seam=seam, subpixel=subpixel, deform=deform)
    made = synthesize(method, picture[:128, :128], (100, 130), Lattice((30, 0), (0, 24)))
    np.testing.assert_array_equal(quantize(made.image), picture[:100, :130])


@pytest.mark.parametrize("method", [Rsgf(), PAPER])
@pytest.mark.parametrize("lattice", [Lattice((20, 5), (-4, 22)), FRACTIONAL])
def test_any_basis_of_the_lattice_gives_the_same_bytes(method: Rsgf, lattice: Lattice) -> None:
    """Long, skewed generating vectors of the same lattice change nothing."""
    skewed = Lattice(lattice.t1, (3 * lattice.t1[0] + lattice.t2[0], 3 * lattice.t1[1] + lattice.t2[1]))
    sample = noise(128, 128)
    one, other = (synthesize(method, sample, (100, 100), basis) for basis in (lattice, skewed))
    np.testing.assert_array_equal(one.image, other.image)


def test_a_fractional_lattice_does_not_drift() -> None:
    """Over 800 px placed patches keep within half a pixel of the real-valued lattice, and gaps within the tolerance."""
    made = synthesize(PAPER, noise(128, 128), (800, 800), FRACTIONAL)
    found = places(made, 40)
    rows, columns = np.indices(found.shape[:2])
    output = np.stack([columns, rows], -1) * 40
    placed = (rows + columns) % 2 == 0
    tolerance = 0.1 * FRACTIONAL.s
    misplaced = np.abs(FRACTIONAL.wrap(found - output)).max(-1)
    assert misplaced[placed].max() <= 0.5 + 1e-9
    assert misplaced[~placed].max() <= tolerance + 1e-9


@pytest.mark.parametrize("reach", [0.0, 0.3, 1.5])
def test_sub_pixel_places_are_those_of_the_lattice(reach: float) -> None:
    """Over 400 px placed patches lie on the real-valued lattice, gaps' within the tolerance of it, however small."""
    canvas = filled(noise(60, 60), (400, 400), FRACTIONAL, reach)
    rows, columns = np.indices(canvas.places.shape[:2])
    misplaced = np.abs(FRACTIONAL.wrap(canvas.places - 8 * np.stack([columns, rows], -1))).max(-1)
    placed = (rows + columns) % 2 == 0
    assert misplaced[placed].max() <= FINEST
    assert misplaced[~placed].max() <= reach + FINEST
    assert reach == 0 or misplaced[~placed].max() > 2 * FINEST


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
    drawn = [tuple(filled(sample, (8, 8), FRACTIONAL, seed=k).places[0, 0].tolist()) for k in range(2000)]
    inside = FRACTIONAL.points((60, 60))
    inside = inside[((inside >= 2) & (inside <= 50)).all(1)]
    counts = [drawn.count(place) for place in set(drawn)]
    assert len(counts) == len(inside) > 4
    assert stats.chisquare(counts).pvalue > 1e-3


def test_in_stochastic_mode_every_place_is_drawn_equally_often() -> None:
    """As if v1 = (1, 0), v2 = (0, 1): a lattice that is given counts for nothing, and none is used."""
    method, sample = replace(SMALL, search="stochastic"), noise(24, 24, 1)
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
    method = replace(SMALL, match=match, search=search, tolerance=tolerance)
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


@settings(max_examples=40, deadline=None)
@given(
    st.tuples(st.integers(1, 70), st.integers(1, 70)),
    st.integers(4, 15),
    st.integers(1, 7),
    st.sampled_from([1, 3]),
    st.sampled_from(SEAMS),
    st.booleans(),
    st.sampled_from([0.0, 1.5]),
    st.integers(0, 99),
)
def test_what_the_source_map_calls_a_copy_is_one(
    shape: tuple[int, int],
    block: int,
    border: int,
    channels: int,
    seam: Any,
    subpixel: bool,
    deform: float,
    seed: int,
) -> None:
    """Whatever blocks, joints and shape: the map is true, pixels of weight 1 are the sample's, others near ones."""
    sample = noise(50, 45, channels)
    method = Rsgf(block, min(border, block // 2), seam=seam, subpixel=subpixel, deform=deform)
    made = synthesize(method, sample, shape, Lattice((9.3, 1.2), (-2.1, 10.4)), seed)
    checked_synthesis(made, sample, shape)
    assert made.image.shape == (*shape, channels)
    assert made.source is not None
    x, y, weight = np.moveaxis(made.source, -1, 0)
    copied = weight == 1
    np.testing.assert_array_equal(made.image[copied], sample[y[copied].astype(int), x[copied].astype(int)])
    assert (weight >= (1 / 3 if seam == "blend" else 1) * (1 if not (subpixel or deform) else 0.25) - 1e-6).all()
    assert ((made.image >= 0) & (made.image <= 1 + 1e-6)).all()


@pytest.mark.parametrize("seam", ["dynamic", "graphcut"])
def test_seams_leave_no_pixel_blended(seam: Any) -> None:
    """At whole pixels, cut along seams, every pixel is a copy."""
    made = synthesize(Rsgf(seam=seam, subpixel=False), noise(128, 128), (150, 170), FRACTIONAL)
    assert made.source is not None
    assert (made.source[..., 2] == 1).all()


def test_every_parameter_changes_something() -> None:
    """No parameter is without effect on a sample that varies, in brightness, too, and is not quite on the lattice."""
    varied = 0.3 * noise(128, 128) + 0.7 * np.tile(noise(24, 30), (6, 5, 1))[:128, :128]
    sample = quantize(varied * np.linspace(0.3, 1, 128, dtype=np.float32)[:, np.newaxis])
    base = synthesize(Rsgf(), sample, (128, 128), FRACTIONAL).image
    changes: list[dict[str, Any]] = [
        {"block": 36}, {"border": 8}, {"match": "ncc"}, {"search": "everywhere"}, {"search": "stochastic"},
        {"tolerance": 0.0}, {"subpixel": False}, {"seam": "blend"}, {"seam": "dynamic"}, {"deform": 1.0},
    ]  # fmt: skip
    for change in changes:
        assert (synthesize(Rsgf(**change), sample, (128, 128), FRACTIONAL).image != base).any(), change


def test_the_same_stream_gives_the_same_bytes_and_another_does_not() -> None:
    """All randomness is the task's."""
    first, second, other = (synthesize(SMALL, noise(60, 60), (50, 50), FRACTIONAL, k).image for k in (1, 1, 2))
    np.testing.assert_array_equal(first, second)
    assert (first != other).any()


def test_progress_rises_to_one() -> None:
    """Progress is told gap by gap."""
    told: list[float] = []
    task = Task(noise(60, 60), (50, 50), FRACTIONAL, np.random.default_rng(0), progress=told.append)
    SMALL.synthesize(task)
    assert told == sorted(told)
    assert told[-1] == 1


def test_without_any_lattice_it_goes_on_in_stochastic_mode_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where none is found every position is a candidate, the lattice used is none, and the note tells."""

    class FindsNone:
        def detect(self, image: Image) -> Detection:
            raise NoLatticeFound("nothing repeats")

    monkeypatch.setattr("nrbench.synthesizers.rsgf.Gncc", FindsNone)
    sample = noise(60, 60, 1)
    made = synthesize(SMALL, sample, (160, 160), None)
    assert made.lattice is None
    assert "nothing repeats" in made.note
    assert "stochastic" in made.note
    assert len(np.unique(places(made, 8)[::2, ::2].reshape(-1, 2), axis=0)) > 90


def test_without_a_lattice_given_it_finds_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """The detector's lattice is used and told, with what finding it cost."""

    class Finds:
        def detect(self, image: Image) -> Detection:
            return Detection(FRACTIONAL, 1.0)

    monkeypatch.setattr("nrbench.synthesizers.rsgf.Gncc", Finds)
    made = synthesize(SMALL, noise(60, 60), (50, 50), None)
    assert made.lattice == FRACTIONAL
    assert made.detection_seconds > 0
    assert not made.note


def test_a_sample_smaller_than_a_block_with_borders_is_refused_with_a_way_out() -> None:
    """The refusal says what would fit."""
    with pytest.raises(Refused, match="block \\+ 2 border <= 50"):
        synthesize(Rsgf(), noise(50, 128), (64, 64), FRACTIONAL)


def test_a_lattice_too_large_for_the_sample_is_refused() -> None:
    """Where the sample shows no whole patch equal to one of the output's, the refusal says so."""
    with pytest.raises(Refused, match="the tile is too large"):
        synthesize(Rsgf(), noise(70, 70), (256, 256), Lattice((65, 0), (0, 65)))


@pytest.mark.parametrize(
    "parameters",
    [
        {"border": 0}, {"border": 21}, {"block": 1}, {"tolerance": -1.0}, {"deform": -1.0}, {"deform": 3.5},
        {"deform": math.nan}, {"tolerance": 3.0, "search": "everywhere"}, {"tolerance": 3.0, "search": "stochastic"},
    ],
)  # fmt: skip
def test_parameters_out_of_range_are_refused(parameters: dict[str, Any]) -> None:
    """Parameters out of range are named, with what to choose."""
    with pytest.raises(BadInput, match="choose"):
        Rsgf(**parameters)


def test_a_flat_sample_gives_a_flat_output() -> None:
    """Nothing to match and nothing to cut around is no error."""
    flat = np.full((60, 60, 1), 0.4, np.float32)
    for match, seam in itertools.product(("ncc", "color"), SEAMS):
        method = Rsgf(block=8, border=2, match=match, seam=seam, deform=1.0)  # type: ignore[arg-type]
        made = synthesize(method, flat, (40, 40), FRACTIONAL)
        np.testing.assert_allclose(made.image, 0.4, atol=1e-6)


def test_a_sample_of_less_than_two_periods_works_or_is_refused() -> None:
    """Small blocks find a place for each; blocks that a sample of 1.5 periods cannot show everywhere are refused."""
    sample, lattice = noise(60, 60), Lattice((40.3, 0), (3.1, 38.6))
    assert synthesize(Rsgf(block=8, border=2), sample, (90, 90), lattice).image.shape == (90, 90, 3)
    with pytest.raises(Refused, match="choose a smaller block"):
        synthesize(Rsgf(block=24, border=6), sample, (90, 90), lattice)


@pytest.mark.parametrize("shape", [(1, 500), (500, 1), (3, 40), (50, 60)])
def test_outputs_smaller_than_the_sample_and_lines_work(shape: tuple[int, int]) -> None:
    """Any shape is filled with pixels of the sample's range."""
    made = synthesize(Rsgf(), noise(128, 128, 1), shape, FRACTIONAL)
    assert made.image.shape == (*shape, 1)
    assert 0 <= made.image.min() < made.image.max() <= 1
