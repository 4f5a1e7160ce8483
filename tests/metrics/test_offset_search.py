from dataclasses import replace

import numpy as np
import pytest

from nrbench.metrics.ncc.window_search import Colors, OffsetSearch, smooth_planes
from nrbench.metrics.verdict.reference import reference_from_model

from .conftest import MODELS, make_case


def make_search(name: str) -> tuple[OffsetSearch, np.ndarray, np.ndarray]:
    """Return the search for a texture's one-tile windows, a fresh draw, and corners of windows all over it."""
    case = make_case(name)
    assert case.texture.lattice is not None
    search = (
        reference_from_model(case.texture, case.texture.lattice, case.again).periodic.tile_searches[0].offset_search
    )
    y, x = np.indices((12, 12)).reshape(2, -1) * 9
    return search, case.fresh(160), np.stack([x, y], -1)


@pytest.mark.parametrize("name", MODELS)
def test_the_best_offset_is_found_at_a_fraction_of_the_cost(name: str) -> None:
    """The resulting NCC is exact, and nearly always within 0.001 of the highest NCC at any offset."""
    search, image, corners = make_search(name)
    planes = search.colors.planes(image)
    at, ncc = search.find(planes, corners)
    every = search._transforms(planes, corners)
    exact = np.full((len(every), *search.where.shape), -1.0)
    exact[:, search.where] = every
    np.testing.assert_allclose(ncc, exact[np.arange(len(at)), at[:, 1], at[:, 0]], atol=1e-4)
    short = every.max(1) - ncc
    assert short.min() > -1e-4
    assert (short < 1e-3).mean() > 0.8
    assert short.max() < 0.1


@pytest.mark.parametrize("name", MODELS)
def test_with_all_pixels_the_search_is_exact(name: str) -> None:
    """With single pixels and all axes of color, the maps equal those of the Fourier transforms."""
    search, image, corners = make_search(name)
    colors = replace(search.colors, main=3)
    whole = replace(search, sizes=(1, 1), colors=colors)
    planes = colors.planes(image)
    ncc = np.concatenate(list(whole.maps(planes, corners)))
    np.testing.assert_allclose(ncc, whole._transforms(planes, corners), atol=1e-4)


def test_half_the_resolution_finds_the_best_offset() -> None:
    """With blocks of 2 x 2 pixels the resulting NCC is exact, and nearly always within 0.001 of the highest one."""
    search, image, corners = make_search("hexagon")
    coarse, planes = replace(search, sizes=(2, 2)), search.colors.planes(image)
    at, ncc = coarse.find(planes, corners)
    exact = np.full((len(corners), *search.where.shape), -1.0)
    exact[:, search.where] = search._transforms(planes, corners)
    np.testing.assert_allclose(ncc, exact[np.arange(len(at)), at[:, 1], at[:, 0]], atol=1e-4)
    assert (exact.max((1, 2)) - ncc < 1e-3).mean() > 0.9


@pytest.mark.parametrize("size", [1, 2])
def test_sums_along_the_axes_are_sums_over_windows(size: int) -> None:
    """Sums along one axis and then along the other equal the sums over the pixels of each window."""
    search = replace(make_search("weave")[0], sizes=(size, 2))
    planes = smooth_planes(np.moveaxis(search.template.image, -1, 0), size)
    cut = search._cut(planes, search._offsets, size)
    np.testing.assert_allclose(search._sums(planes), cut.sum(2).T, atol=1e-3)


def test_flat_windows_have_no_correlation() -> None:
    """A window without variance has NCC 0 everywhere."""
    search, image, corners = make_search("brick")
    planes = search.colors.planes(np.full_like(image, 0.4))
    assert np.abs(np.concatenate(list(search.maps(planes, corners)))).max() == 0
    assert np.abs(search.find(planes, corners)[1]).max() == 0


def test_axes_of_color_are_those_that_vary() -> None:
    """If all colors lie on a line, one axis varies. The axes preserve distances between colors."""
    shape = np.random.default_rng(0).random((20, 30, 1), np.float32)
    image = shape * np.array([0.7, -0.2, 0.4], np.float32) + np.float32(0.3)
    colors = Colors.of(image)
    assert (colors.varies, colors.main) == (1, 1)
    projected = colors.project(image)
    np.testing.assert_allclose(
        np.linalg.norm(projected, axis=-1), np.linalg.norm(image - image.mean((0, 1)), axis=-1), atol=1e-5
    )
    assert np.abs(projected[..., 1:]).max() < 1e-5
