import numpy as np
import pytest
from scipy import ndimage
from synthesis_cases import waves

from nrbench.imaging.mean_tile import cell_coordinates, fold, interpolate
from nrbench.lattice.geometry import Lattice

OBLIQUE = Lattice((17.3, 2.6), (-3.1, 14.8), (4.2, 1.7))


def test_a_periodic_image_folds_and_unfolds_to_itself() -> None:
    """The mean tile of a periodic image is its tile, up to the bilinear samples, at any shape."""
    tile = fold(waves((160, 190), OBLIQUE)[..., ::2], OBLIQUE)
    np.testing.assert_allclose(tile.unfold((70, 90)), waves((70, 90), OBLIQUE)[..., ::2], atol=0.04)


def test_many_cells_tell_what_lies_between_the_pixels() -> None:
    """Folded three samples a pixel, a periodic image is known between its pixels better than at one a pixel."""
    image, errors = waves((160, 190), OBLIQUE), []
    rows, columns = fold(image, OBLIQUE).counts.shape
    for fineness in (1, 3):
        tile = fold(image, OBLIQUE, grid=(fineness * rows, fineness * columns))
        errors.append(np.abs(tile.unfold((70, 90), (0.4, 0.3)) - waves((70, 90), OBLIQUE.shifted((0.4, 0.3)))).max())
    assert errors[1] < errors[0] / 2


def test_every_pixel_is_counted_once() -> None:
    """The counts add up to the pixels used; a tile that nothing reached is filled by the mean of the rest."""
    image = waves((50, 60), OBLIQUE)
    mask = np.zeros((50, 60), np.bool_)
    mask[:20, :8] = True
    tile = fold(image, OBLIQUE, mask)
    assert tile.counts.sum() == pytest.approx(160)
    assert (tile.counts == 0).any()
    assert np.isfinite(tile.values).all()


def test_cell_coordinates_are_those_of_every_pixel() -> None:
    """Every pixel's cell coordinates are the lattice's own, of an oblique lattice with an origin too."""
    lattice = Lattice((7.3, 1.2), (-2.1, 9.4), (3.5, -11.25))
    y, x = np.indices((13, 17))
    np.testing.assert_allclose(cell_coordinates(lattice, (13, 17)), lattice.to_cell(np.stack([x, y], -1)), atol=1e-12)


def test_bilinear_values_are_those_of_scipy() -> None:
    """Inside the image, on its last pixel and beyond its border."""
    image = np.random.default_rng(2).random((11, 14, 3)).astype(np.float32)
    xy = np.random.default_rng(3).uniform(-3, 16, (20, 9, 2))
    xy[0, :2] = (13, 10), (0, 0)
    expected = [
        ndimage.map_coordinates(plane, [xy[..., 1], xy[..., 0]], order=1, mode="nearest")
        for plane in np.moveaxis(image, -1, 0)
    ]
    np.testing.assert_allclose(interpolate(image, xy), np.stack(expected, -1), atol=1e-6)
