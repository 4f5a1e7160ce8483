import numpy as np
import pytest

from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Refused, Synthesis, Task
from nrbench.running.output_checks import checked_synthesis
from nrbench.synthesizers.shuffle import Shuffle

WHOLE = Lattice((20, 4), (-3, 16))
SQUARE = Lattice((16, 0), (0, 16))


def made(sample: Image, lattice: Lattice | None, seed: int = 0, shape: tuple[int, int] = (120, 140)) -> Synthesis:
    """Run the method, and check its result."""
    task = Task(sample, shape, lattice, np.random.default_rng(seed))
    return checked_synthesis(Shuffle().synthesize(task), sample, shape)


def plates() -> Image:
    """Return squares of random colors, 12 px wide with a joint of 4 px, their middles at (7.5, 7.5) modulo 16."""
    colors = np.random.default_rng(1).random((8, 8, 3))
    image = np.kron(colors, np.ones((16, 16, 1)))
    joint = np.minimum(np.arange(128) % 16, 15 - np.arange(128) % 16) < 2
    image[joint] = image[:, joint] = 0.5
    return quantize(image.astype(np.float32))


def test_every_pixel_comes_from_an_equal_place() -> None:
    """Source and pixel differ by a vector of the lattice, and tiles by different ones."""
    sample = quantize(np.random.default_rng(0).random((90, 100, 3), np.float32))
    source = made(sample, WHOLE).source
    assert source is not None
    assert (source[..., 2] == 1).all()
    y, x = np.indices(source.shape[:2])
    cells = WHOLE.to_cell(source[..., :2] - np.stack([x, y], -1))
    np.testing.assert_allclose(cells, np.rint(cells), atol=1e-4)
    assert len(np.unique(np.rint(cells).reshape(-1, 2), axis=0)) > 20


def test_a_regular_sample_is_continued() -> None:
    """On a perfectly regular texture the method is valid: the output is the periodic continuation."""
    picture = quantize(np.tile(np.random.default_rng(0).random((16, 16, 3), np.float32), (12, 12, 1)))
    image = made(picture[:100, :100], SQUARE).image
    np.testing.assert_array_equal(image, picture[:120, :140])
    assert "0" in Shuffle.right_on


def test_cuts_run_through_the_middle_of_the_motif() -> None:
    """Square plates of their own colors are cut near their middles, not along their joints."""
    source = made(plates(), SQUARE).source
    assert source is not None
    broken = np.abs(np.diff(source[..., 0], axis=1) - 1) > 0.5
    columns = np.unique(np.nonzero(broken)[1] + 1) % 16
    assert len(columns)
    assert (np.abs(columns - 8) <= 3).all()


def test_without_a_tile_it_refuses() -> None:
    """The refusal says what is missing."""
    with pytest.raises(Refused, match="holds no whole tile"):
        made(plates()[:30], Lattice((60, 0), (0, 50)))
