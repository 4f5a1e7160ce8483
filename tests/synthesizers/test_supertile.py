import numpy as np
import pytest
from synthesis_cases import waves

from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Refused, Synthesis, Task
from nrbench.running.output_checks import checked_synthesis
from nrbench.synthesizers.baselines.voronoi_cell import half_extent
from nrbench.synthesizers.supertile import Supertile, largest_supercell

OBLIQUE = Lattice((21.37, 2.6), (-2.3, 18.81))
WHOLE = Lattice((20, 4), (-3, 16))


def noise(shape: tuple[int, int]) -> Image:
    """Return a random image of 3 channels."""
    return quantize(np.random.default_rng(0).random((*shape, 3), np.float32))


def made(sample: Image, shape: tuple[int, int], lattice: Lattice) -> Synthesis:
    """Run the method, and check its result."""
    task = Task(sample, shape, lattice, np.random.default_rng(0))
    return checked_synthesis(Supertile().synthesize(task), sample, shape)


def test_it_repeats_many_tiles_and_no_fewer() -> None:
    """On noise with a lattice of whole pixels the output repeats along the supercell's vectors, not the lattice's."""
    sample, cell = noise((90, 110)), largest_supercell(WHOLE, (90, 110))
    image = made(sample, (200, 220), WHOLE).image
    for vector, repeats in ((cell.t1, True), (cell.t2, True), (WHOLE.t1, False), (WHOLE.t2, False)):
        x, y = (int(value) for value in vector)
        rows, columns = slice(max(y, 0), 200 + min(y, 0)), slice(max(x, 0), 220 + min(x, 0))
        back = image[rows.start - y : rows.stop - y, columns.start - x : columns.stop - x]
        assert np.array_equal(image[rows, columns], back) == repeats


def test_the_crop_is_the_sample_itself() -> None:
    """Around the sample's middle every pixel is its own copy, phase included."""
    sample = noise((91, 111))
    image = made(sample, (120, 140), WHOLE).image
    np.testing.assert_array_equal(image[20:70, 25:85], sample[20:70, 25:85])


def test_a_fractional_lattice_neither_drifts_nor_blurs() -> None:
    """A perfectly regular oblique sample is continued within a gray level (rms), 700 px away."""
    image = made(quantize(waves((90, 100), OBLIQUE)), (800, 800), OBLIQUE).image
    error = (image - waves((800, 800), OBLIQUE))[-100:, -100:]
    assert np.sqrt((error**2).mean()) < 1 / 255


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


def test_a_sample_without_a_whole_tile_is_refused() -> None:
    """The refusal gives the tile's size and the sample's."""
    with pytest.raises(Refused, match="60x50 px, the sample is 55x90 px"):
        made(noise((90, 55)), (64, 64), Lattice((60, 0), (0, 50)))


def test_a_sample_that_wraps_is_all_repeated() -> None:
    """Where the sample is a whole number of tiles, the crop is the sample."""
    sample = noise((60, 80))
    np.testing.assert_array_equal(
        made(sample, (120, 160), Lattice((20, 0), (10, 30))).image, np.tile(sample, (2, 2, 1))
    )


def test_the_note_counts_the_tiles() -> None:
    """How many tiles are repeated stands in the note."""
    assert made(noise((60, 80)), (64, 64), Lattice((20, 0), (0, 20))).note == "repeats 12 tiles"
