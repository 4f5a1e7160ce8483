"""Claims about the baselines: tiling, supertile, shuffle, scatter and random phase."""

from typing import Any

import numpy as np
import pytest
from synthesis_cases import OBLIQUE, noise, synthesize

from nrbench.calling.method_calls import checked_synthesis
from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Refused
from nrbench.synthesizers.baselines.lattice_baseline import half_extent
from nrbench.synthesizers.random_phase import RandomPhase, _periodic
from nrbench.synthesizers.scatter import Scatter
from nrbench.synthesizers.shuffle import Shuffle
from nrbench.synthesizers.supertile import Supertile, largest_supercell
from nrbench.synthesizers.tiling import Tiling

WHOLE = Lattice((20, 4), (-3, 16))
SQUARE = Lattice((16, 0), (0, 16))


@pytest.mark.parametrize("tile", ["typical", "random"])
def test_every_tile_is_the_same(tile: Any) -> None:
    """On a random sample with a whole-pixel lattice the output repeats exactly, and shows the pixels of one tile."""
    made = synthesize(Tiling(tile=tile), noise(70, 80), (120, 120), WHOLE)
    np.testing.assert_allclose(made.image[4:, 20:], made.image[:-4, :-20], atol=1e-6)
    np.testing.assert_allclose(made.image[16:, :-3], made.image[:-16, 3:], atol=1e-6)
    assert len(np.unique(made.source[..., :2].reshape(-1, 2), axis=0)) == WHOLE.area


def test_the_half_extent_is_that_of_the_voronoi_cell() -> None:
    """Rectangles reach half their sides; a running bond of squares, half its longer vector."""
    assert half_extent(Lattice((30, 0), (0, 24))) == pytest.approx((15, 12))
    assert half_extent(Lattice((40, 0), (20, 20))) == pytest.approx((20, 20))


def test_the_typical_tile_is_the_one_nearest_to_the_mean() -> None:
    """Of tiles of which all but one are odd, the one that is like the mean tile is repeated, at any seed."""
    rng = np.random.default_rng(4)
    motif = rng.random((20, 20, 3), np.float32) * 0.4 + 0.3
    sample = np.tile(motif, (5, 5, 1)) + 0.2 * rng.choice([-1.0, 1.0], (100, 100, 1)).astype(np.float32)
    sample[38:62, 38:62] = np.tile(motif, (5, 5, 1))[38:62, 38:62]
    made = [synthesize(Tiling(), quantize(sample), (60, 60), Lattice((20, 0), (0, 20)), seed) for seed in (0, 1)]
    np.testing.assert_array_equal(made[0].image, made[1].image)
    assert np.abs(made[0].image - np.tile(motif, (3, 3, 1))).max() < 1 / 255


def test_a_random_tile_is_drawn_from_the_stream() -> None:
    """With ``tile="random"`` another seed repeats another tile."""
    first, second = (synthesize(Tiling("random"), noise(70, 80), (40, 40), WHOLE, seed).image for seed in (0, 1))
    assert not np.array_equal(first, second)


def test_a_supertile_repeats_many_tiles_and_no_fewer() -> None:
    """On noise with a lattice of whole pixels the output repeats along the supercell's vectors, not the lattice's."""
    sample, cell = noise(90, 110), largest_supercell(WHOLE, (90, 110))
    image = synthesize(Supertile(), sample, (200, 220), WHOLE).image
    for vector, repeats in ((cell.t1, True), (cell.t2, True), (WHOLE.t1, False), (WHOLE.t2, False)):
        x, y = (int(value) for value in vector)
        rows, columns = slice(max(y, 0), 200 + min(y, 0)), slice(max(x, 0), 220 + min(x, 0))
        back = image[rows.start - y : rows.stop - y, columns.start - x : columns.stop - x]
        assert np.array_equal(image[rows, columns], back) == repeats


def test_the_crop_is_the_sample_itself() -> None:
    """Around the sample's middle every pixel is its own copy; a sample of a whole number of tiles is all repeated."""
    sample = noise(91, 111)
    image = synthesize(Supertile(), sample, (120, 140), WHOLE).image
    np.testing.assert_array_equal(image[20:70, 25:85], sample[20:70, 25:85])
    made = synthesize(Supertile(), sample[:60, :80], (120, 160), Lattice((20, 0), (10, 30)))
    np.testing.assert_array_equal(made.image, np.tile(sample[:60, :80], (2, 2, 1)))
    assert made.note == "repeats 8 tiles"


@pytest.mark.parametrize("lattice", [OBLIQUE, WHOLE, Lattice((9.3, 0), (4.65, 8.05)), Lattice((40, 3), (1, 44))])
def test_the_supercell_is_the_largest_that_fits(lattice: Lattice) -> None:
    """It is a sublattice whose cell lies in the sample, and none larger does."""
    cell = largest_supercell(lattice, (96, 128))
    change = cell.matrix @ np.linalg.inv(lattice.matrix)
    np.testing.assert_allclose(change, np.rint(change), atol=1e-6)
    assert (2 * np.array(half_extent(cell)) <= (128 + 1e-6, 96 + 1e-6)).all()
    steps = [np.array([a, b]) @ lattice.matrix for a in range(-14, 15) for b in range(-14, 15)]
    fitting = [v for v in steps if abs(v[0]) <= 128 and abs(v[1]) <= 96 and np.hypot(*v) > 30]
    wide = [v for v in fitting if v[0] > 55 and abs(v[1]) < 30]
    tall = [v for v in fitting if v[1] > 45 and abs(v[0]) < 40]
    for a in wide:
        for b in tall:
            other = Lattice((a[0], a[1]), (b[0], b[1]))
            if other.area > cell.area + 1e-6:
                assert (2 * np.array(half_extent(other)) > (128, 96)).any()


def test_shuffled_tiles_come_from_equal_places() -> None:
    """Source and pixel differ by a vector of the lattice, and tiles by different ones."""
    source = synthesize(Shuffle(), noise(90, 100), (120, 140), WHOLE).source
    y, x = np.indices(source.shape[:2])
    cells = WHOLE.to_cell(source[..., :2] - np.stack([x, y], -1))
    np.testing.assert_allclose(cells, np.rint(cells), atol=1e-4)
    assert len(np.unique(np.rint(cells).reshape(-1, 2), axis=0)) > 20


def test_shuffling_cuts_through_the_middle_of_the_motif() -> None:
    """Plates of their own colors, 12 px wide with joints of 4 px, are cut near their middles, not along joints."""
    plates = np.kron(np.random.default_rng(1).random((8, 8, 3)), np.ones((16, 16, 1)))
    joint = np.minimum(np.arange(128) % 16, 15 - np.arange(128) % 16) < 2
    plates[joint] = plates[:, joint] = 0.5
    source = synthesize(Shuffle(), quantize(plates.astype(np.float32)), (120, 140), SQUARE, 0).source
    broken = np.abs(np.diff(source[..., 0], axis=1) - 1) > 0.5
    columns = np.unique(np.nonzero(broken)[1] + 1) % 16
    assert len(columns)
    assert (np.abs(columns - 8) <= 3).all()


def test_scattered_patches_come_from_anywhere() -> None:
    """Over many blocks every part of the sample is used, most pixels are copies, and patches seldom recur."""
    made = synthesize(Scatter(), noise(60, 70, 1), (640, 640))
    middles = made.source[16::32, 16::32, :2].reshape(-1, 2)
    assert len(np.unique(middles, axis=0)) > 250
    assert made.source[..., 0].min() <= 4 and made.source[..., 0].max() >= 65
    assert (made.source[..., 2] == 1).mean() > 0.7


@pytest.mark.parametrize(
    ("method", "reason"),
    [
        (Tiling(), "60x50 px, the sample is 55x90 px"),
        (Supertile(), "60x50 px, the sample is 55x90 px"),
        (Shuffle(), "holds no whole tile"),
        (Scatter(block=48), r"block \+ 2 border <= 55"),
    ],
)
def test_a_sample_without_a_whole_tile_is_refused(method: Any, reason: str) -> None:
    """The refusal gives the sizes of the tile and the sample, or what would fit."""
    with pytest.raises(Refused, match=reason):
        synthesize(method, noise(90, 55), (64, 64), Lattice((60, 0), (0, 50)))


def smooth_colors() -> Image:
    """Return smooth colored noise, its channels correlated, far from black and white; it wraps."""
    white = np.fft.rfft2(np.random.default_rng(0).standard_normal((3, 96, 96)))
    y, x = np.fft.fftfreq(96)[:, np.newaxis], np.fft.rfftfreq(96)
    smooth = np.fft.irfft2(white * np.exp(-800 * (x**2 + y**2)), (96, 96))
    colors = np.array([[1, 0.2, 0], [0.8, 0.5, 0], [0.3, 0.1, 0.6]])
    mixed = np.tensordot(colors, smooth / smooth.std(), 1)
    return quantize(np.moveaxis(0.5 + 0.06 * mixed, 0, -1).astype(np.float32))


def test_at_the_samples_size_the_spectrum_is_the_samples() -> None:
    """The moduli of all frequencies, and the phases between channels, are those of the periodic component."""
    sample = smooth_colors()
    made = checked_synthesis(synthesize(RandomPhase(), sample, (96, 96), seed=0), sample, (96, 96))
    planes = [np.moveaxis(image.astype(np.float64), -1, 0) for image in (sample, made.image)]
    own, other = np.fft.rfft2(_periodic(planes[0])), np.fft.rfft2(planes[1])
    strong = np.abs(own) > 3
    np.testing.assert_allclose(np.abs(other[strong]), np.abs(own[strong]), rtol=0.1)
    between, kept = own[0] * own[1].conj(), other[0] * other[1].conj()
    strong = np.abs(between) > 20
    assert np.abs(np.angle(kept / between)[strong]).max() < 0.2


@pytest.mark.parametrize("shape", [(300, 280), (300, 50), (96, 96)])
def test_colors_and_their_covariance_are_kept(shape: tuple[int, int]) -> None:
    """Over draws, mean and covariance of the colors are the sample's, at any output size."""
    sample = smooth_colors()
    draws = [quantize(synthesize(RandomPhase(), sample, shape, seed=seed).image) for seed in range(12)]
    np.testing.assert_allclose(np.mean([draw.mean((0, 1)) for draw in draws], 0), sample.mean((0, 1)), atol=0.02)
    expected, *found = (np.cov(image.reshape(-1, 3).T) for image in (sample, *draws))
    assert np.abs(np.mean(found, 0) - expected).max() < 0.25 * expected.max()


def test_jumps_across_the_borders_are_taken_out() -> None:
    """Of a ramp across the picture the periodic component keeps under a tenth of the jump, and the mean."""
    ramp = np.broadcast_to(np.arange(64) / 6.4, (1, 64, 64))
    periodic = _periodic(ramp)
    assert np.abs(periodic[..., 0] - periodic[..., -1]).max() < 1
    assert periodic.mean() == pytest.approx(ramp.mean())
