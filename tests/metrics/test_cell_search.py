import numpy as np

from nrbench.metrics.ncc.window_search import CellSearch, cut_planes, smooth_planes
from nrbench.metrics.verdict.reference import reference_from_model

from .conftest import make_case


def test_blocks_of_pixels_find_the_same_places() -> None:
    """With blocks of 2 x 2 pixels, windows of a fresh draw have the same displacements as with single pixels."""
    case = make_case("hexagon")
    assert case.texture.lattice is not None
    search = reference_from_model(case.texture, case.texture.lattice, case.again).periodic.cell_search
    y, x = np.indices((9, 9)).reshape(2, -1) * 14
    planes, corners = search.colors.planes(case.fresh(192)), np.stack([x, y], -1)
    sizes = (CellSearch(search.template, search.inside, search.colors, size) for size in (1, 2))
    fine, coarse = (one.find(planes, corners) for one in sizes)
    away = case.texture.lattice.wrap(fine[0] - coarse[0])
    assert np.hypot(*away.T).max() < 0.5
    assert np.abs(fine[1] - coarse[1]).max() < 0.12


def test_windows_of_means_are_means_over_blocks() -> None:
    """Every second running mean of a window is the mean over one of its blocks. Incomplete blocks are left out."""
    image = np.random.default_rng(0).random((3, 9, 12), np.float32)
    windows = cut_planes(smooth_planes(image, 2), np.array([(1, 2)]), (7, 10), 2)
    blocks = image[:, 2:8, 1:11].reshape(3, 3, 2, 5, 2).mean((2, 4))
    np.testing.assert_allclose(windows[0], blocks, atol=1e-6)
    np.testing.assert_array_equal(smooth_planes(image, 1), image)
