import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from nrbench.errors import BadInput
from nrbench.imaging.door import Image, quantize, to_bytes
from nrbench.lattice.detection import Detection, NoLatticeFound
from nrbench.lattice.geometry import Lattice
from nrbench.synthesis import Refused, Synthesis, Task
from nrbench.synthesizers.rsgf import Rsgf

SMALL = Rsgf(block=8, border=2)
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


def test_any_basis_of_the_lattice_gives_the_same_bytes() -> None:
    """Long, skewed generating vectors of the same lattice change nothing."""
    sample = noise(128, 128)
    one = synthesize(Rsgf(), sample, (100, 100), Lattice((20, 5), (-4, 22)))
    other = synthesize(Rsgf(), sample, (100, 100), Lattice((20, 5), (3 * 20 - 4, 3 * 5 + 22)))
    np.testing.assert_array_equal(one.image, other.image)


def test_a_fractional_lattice_does_not_drift() -> None:
    """Over 800 px placed patches keep within half a pixel of the real-valued lattice, and gaps within the tolerance."""
    made = synthesize(Rsgf(), noise(128, 128), (800, 800), FRACTIONAL)
    found = places(made, 40)
    rows, columns = np.indices(found.shape[:2])
    output = np.stack([columns, rows], -1) * 40
    placed = (rows + columns) % 2 == 0
    tolerance = 0.1 * FRACTIONAL.s
    misplaced = np.abs(FRACTIONAL.wrap(found - output)).max(-1)
    assert misplaced[placed].max() <= 0.5 + 1e-9
    assert misplaced[~placed].max() <= tolerance + 1e-9


def test_a_smooth_fractional_texture_is_continued_well() -> None:
    """A periodic texture whose lattice is of no whole pixels comes back with a PSNR of over 30 dB."""
    x, y = np.meshgrid(np.arange(512), np.arange(512))
    u, v = np.moveaxis(FRACTIONAL.to_cell(np.stack([x, y], -1)), -1, 0)
    truth = 0.5 + 0.2 * (np.cos(2 * math.pi * u) + np.cos(2 * math.pi * v))[..., np.newaxis].astype(np.float32)
    made = synthesize(Rsgf(), quantize(truth[:128, :128]), (512, 512), FRACTIONAL)
    assert -10 * np.log10(((made.image - truth) ** 2).mean()) > 30


def test_the_random_choice_is_uniform_over_the_candidates() -> None:
    """Each patch equal by the lattice and whole inside the sample, borders included, is drawn equally often."""
    sample, lattice = noise(60, 60, 1), Lattice((11, 2), (-3, 13))
    drawn = [tuple(places(synthesize(SMALL, sample, (8, 8), lattice, k), 8)[0, 0].tolist()) for k in range(3000)]
    room = range(2, 60 - 8 - 2 + 1)
    candidates = {(x, y) for x in room for y in room if np.abs(lattice.wrap([x, y])).max() < 1e-9}
    counts = {place: drawn.count(place) for place in set(drawn)}
    assert set(counts) == candidates
    assert stats.chisquare(list(counts.values())).pvalue > 1e-3


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
    method = Rsgf(block=8, border=2, match=match, search=search, tolerance=tolerance)
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
    st.integers(0, 99),
)
def test_what_the_source_map_calls_a_copy_is_one(
    shape: tuple[int, int], block: int, border: int, channels: int, seed: int
) -> None:
    """Whatever the blocks and the shape: pixels of weight 1 are the sample's, all others a blend of near weights."""
    sample = noise(50, 45, channels)
    made = synthesize(Rsgf(block, min(border, block // 2)), sample, shape, Lattice((9.3, 1.2), (-2.1, 10.4)), seed)
    assert made.image.shape == (*shape, channels)
    assert made.source is not None
    x, y, weight = np.moveaxis(made.source, -1, 0)
    copied = weight == 1
    np.testing.assert_array_equal(made.image[copied], sample[y[copied].astype(int), x[copied].astype(int)])
    assert (weight[~copied] >= 1 / 3 - 1e-6).all()
    assert ((made.image >= 0) & (made.image <= 1 + 1e-6)).all()


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


@pytest.mark.parametrize("parameters", [{"border": 0}, {"border": 21}, {"block": 1}, {"tolerance": -1.0}])
def test_parameters_out_of_range_are_refused(parameters: dict[str, Any]) -> None:
    """Parameters out of range are named, with what to choose."""
    with pytest.raises(BadInput, match="choose"):
        Rsgf(**parameters)


def test_a_flat_sample_gives_a_flat_output() -> None:
    """Nothing to match is no error."""
    flat = np.full((60, 60, 1), 0.4, np.float32)
    for match in ("ncc", "color"):
        made = synthesize(Rsgf(block=8, border=2, match=match), flat, (40, 40), FRACTIONAL)  # type: ignore[arg-type]
        np.testing.assert_allclose(made.image, 0.4, atol=1e-6)
