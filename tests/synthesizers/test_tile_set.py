import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from synthesis_cases import FRACTIONAL, noise, synthesize

from nrbench.imaging.convert import Image, quantize, to_bytes
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Synthesis, Task
from nrbench.synthesizers.tile_set import TileLaying, TileSet

PAPER = TileSet(**{**TileSet.presets["paper"], "registration": 0.0})
TILES = ["auto", "upright", "lattice", "rectangle", "cell"]
LATTICES = [
    Lattice((30, 0), (0, 24)),
    Lattice((15, 12), (15, -12)),
    Lattice((20, 5), (-4, 22)),
    Lattice((24, 0), (0, 24)),
]


def periodic(shape: tuple[int, int], lattice: Lattice, channels: int = 3) -> Image:
    """Return noise that repeats exactly on a lattice of whole pixels."""
    x, y = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    wrapped = np.rint(lattice.wrap(np.stack([x, y], -1))).astype(int)
    return noise(101, 101, channels)[wrapped[..., 1], wrapped[..., 0]]


def waves(shape: tuple[int, int], lattice: Lattice) -> Image:
    """Return a smooth image with exactly this lattice."""
    x, y = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    u, v = np.moveaxis(lattice.to_cell(np.stack([x, y], -1)), -1, 0)
    first, second = np.cos(2 * math.pi * u), np.cos(2 * math.pi * (v + 0.1))
    return np.stack([0.5 + 0.2 * first + 0.2 * second, 0.5 + 0.4 * first * second, 0.5 + 0.3 * second], -1).astype("f4")


def misplacement(made: Synthesis, lattice: Lattice) -> NDArray[np.float64]:
    """Return the distance in px of each output pixel's source from the nearest equal place."""
    assert made.source is not None
    y, x = np.indices(made.source.shape[:2])
    return np.asarray(np.hypot(*np.moveaxis(lattice.wrap(made.source[..., :2] - np.stack([x, y], -1)), -1, 0)))


@pytest.mark.parametrize("lattice", LATTICES)
@pytest.mark.parametrize("tile", TILES)
@pytest.mark.parametrize("channels", [1, 3])
def test_a_whole_pixel_lattice_is_continued_exactly(lattice: Lattice, tile: Any, channels: int) -> None:
    """On a perfectly periodic sample the output continues it exactly, with its phase."""
    picture = periodic((160, 300), lattice, channels)
    for size in ((140, 150), (1, 300), (150, 1), (9, 5)):
        made = synthesize(TileSet(tile=tile), picture[:128, :128], size, lattice)
        np.testing.assert_array_equal(to_bytes(made.image), to_bytes(picture[: size[0], : size[1]]))


@pytest.mark.parametrize("lattice", LATTICES)
@pytest.mark.parametrize(
    "method", [TileSet(stitch="dynamic"), TileSet(cells=2), TileSet(cells=2, stitch="dynamic"), PAPER]
)
def test_seams_and_larger_tiles_continue_exactly_too(method: TileSet, lattice: Lattice) -> None:
    """The paper's two seams and its sum of differences, and tiles of 2 x 2 cells, also continue a periodic sample."""
    picture = periodic((160, 200), lattice)
    made = synthesize(method, picture[:160, :160], (160, 200), lattice)
    np.testing.assert_array_equal(to_bytes(made.image), to_bytes(picture))


def test_larger_tiles_are_fewer() -> None:
    """Tiles of 2 x 2 cells are laid in steps twice as long, and the sample still holds many of them."""
    lattice, sample = Lattice((20, 5), (-4, 22)), noise(160, 160)
    task = Task(sample, (400, 400), lattice, np.random.default_rng(0))
    small, large = (TileLaying(TileSet(tile="cell", cells=cells), task, lattice) for cells in (1, 2))
    np.testing.assert_allclose(large.tile.steps, 2 * small.tile.steps)
    assert len(large.tile_numbers()) < 0.4 * len(small.tile_numbers())
    assert len(large.sets[0, 0]) > 20


def test_the_minimum_cut_keeps_to_the_overlap() -> None:
    """A tile laid over another fills what is empty, and its outermost pixels replace nothing."""
    lattice, sample = Lattice((20, 0), (0, 20)), noise(120, 120)
    task = Task(sample, (60, 60), lattice, np.random.default_rng(0))
    laying = TileLaying(TileSet(tile="cell", stitch="graphcut", registration=0), task, lattice)
    canvas, cuts = laying.canvas, laying.stock.cut(laying.sets[0, 0])
    canvas.lay(40, 40, cuts.take(np.array([0])))
    before = canvas.values.copy()
    canvas.lay(50, 40, cuts.take(np.array([1])))
    x, y, border = canvas.tile.pixels[:, 0] + 50, canvas.tile.pixels[:, 1] + 40, canvas.tile.pixels[:, 4]
    assert canvas.filled[y, x].all()
    ring = (before[y, x].any(-1)) & (border == 0)
    assert ring.any()
    np.testing.assert_array_equal(canvas.values[y, x][ring], before[y, x][ring])


@pytest.mark.parametrize(("registration", "decibels"), [(None, 35), (0.0, 42)])
@pytest.mark.parametrize("parts", [4, 8])
def test_a_smooth_fractional_texture_is_continued_well(parts: int, registration: float | None, decibels: int) -> None:
    """A periodic texture with fractional vectors is continued with a PSNR over 35 dB, and over 42 dB unregistered."""
    truth = waves((256, 256), FRACTIONAL)
    method = TileSet(parts=parts, registration=registration)
    made = synthesize(method, quantize(truth[:128, :128]), (256, 256), FRACTIONAL)
    assert -10 * np.log10(((made.image - truth) ** 2).mean()) > decibels


def test_whole_pixels_continue_a_fractional_texture_to_half_a_pixel() -> None:
    """By default places are rounded to whole pixels, which leaves a PSNR over 30 dB."""
    truth = waves((256, 256), FRACTIONAL)
    made = synthesize(TileSet(), quantize(truth[:128, :128]), (256, 256), FRACTIONAL)
    assert -10 * np.log10(((made.image - truth) ** 2).mean()) > 30


@pytest.mark.parametrize("parts", [None, 4])
def test_a_fractional_lattice_does_not_drift(parts: int | None) -> None:
    """Over 1024 px no pixel's source is more than 0.1 s off the lattice, and the mean does not grow."""
    for shape in ((1024, 96), (96, 1024)):
        made = synthesize(TileSet(parts=parts), noise(128, 128), shape, FRACTIONAL)
        off = misplacement(made, FRACTIONAL)
        assert off.max() < 0.1 * FRACTIONAL.s
        assert off[-256:, -256:].mean() == pytest.approx(off[:256, :256].mean(), rel=0.15)


@pytest.mark.parametrize(
    "method",
    [
        TileSet(),
        TileSet(parts=4),
        TileSet(tile="upright"),
        TileSet(stitch="dynamic"),
    ],
)
def test_the_map_points_at_what_was_copied(method: TileSet) -> None:
    """Pixels of weight 1 are copies of the sample, and every pixel has a source inside the sample."""
    sample = noise(90, 100)
    made = synthesize(method, sample, (120, 110), FRACTIONAL)
    assert made.source is not None
    x, y, weight = np.moveaxis(made.source, -1, 0)
    assert (x >= 0).all() and (x <= 99).all() and (y >= 0).all() and (y <= 89).all()
    assert (weight > 0).all() and (weight <= 1).all()
    copied = weight == 1
    np.testing.assert_array_equal(
        to_bytes(made.image)[copied], to_bytes(sample)[y[copied].astype(int), x[copied].astype(int)]
    )


def test_the_anchor_keeps_borders_off_the_detail() -> None:
    """The quiet anchor puts the borders of tiles where the mean tile is flat."""
    lattice = Lattice((32, 0), (0, 32))
    motif = np.full((32, 32, 3), 0.5, np.float32)
    motif[4:12, 18:26] = noise(8, 8)
    picture = quantize(np.tile(motif, (5, 5, 1)))
    task = Task(picture, (40, 40), lattice, np.random.default_rng(0))
    laying = TileLaying(TileSet(tile="cell", anchor="quiet"), task, lattice)
    spot = np.array([21.5, 7.5])
    away = np.abs((spot - laying.lattice.origin + 8) % 16 - 8)
    assert (away > 3).all()


def test_elements_are_shown_whole_by_t() -> None:
    """Anchored by elements, the tiles of T lie around what differs from tile to tile."""
    lattice = Lattice((32, 0), (0, 32))
    picture = np.full((160, 160, 3), 0.5, np.float32)
    for place, color in zip(np.ndindex(5, 5), np.random.default_rng(0).random((25, 3)), strict=True):
        row, column = np.array(place) * 32
        picture[row + 4 : row + 20, column + 10 : column + 26] = color
    task = Task(quantize(picture), (40, 40), lattice, np.random.default_rng(0))
    laying = TileLaying(TileSet(tile="cell", anchor="elements"), task, lattice)
    assert np.abs(lattice.wrap(np.subtract(laying.lattice.origin, (17.5, 11.5)))).max() <= 2
