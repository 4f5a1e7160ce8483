from dataclasses import replace

import numpy as np
import pytest

from nrbench.metrics.ncc.window_search import Colors, Scan, smoothed
from nrbench.metrics.verdict.reference import reference_from_model

from .conftest import MODELS, make_case


def searched(name: str) -> tuple[Scan, np.ndarray, np.ndarray]:
    """Return a scan of a texture's one-tile windows, a fresh draw, and corners all over it."""
    case = make_case(name)
    assert case.texture.lattice is not None
    scan = reference_from_model(case.texture, case.texture.lattice, case.again).periodic.searches[0].scan
    y, x = np.indices((12, 12)).reshape(2, -1) * 9
    return scan, case.fresh(160), np.stack([x, y], -1)


@pytest.mark.parametrize("name", MODELS)
def test_the_best_offset_is_found_at_a_fraction_of_the_cost(name: str) -> None:
    """The NCC found is never above the highest at any offset, within 0.001 of it nearly always, and what it says."""
    scan, image, corners = searched(name)
    planes = scan.colors.planes(image)
    at, ncc = scan.find(planes, corners)
    every = scan._transforms(planes, corners)
    exact = np.full((len(every), *scan.where.shape), -1.0)
    exact[:, scan.where] = every
    np.testing.assert_allclose(ncc, exact[np.arange(len(at)), at[:, 1], at[:, 0]], atol=1e-4)
    short = every.max(1) - ncc
    assert short.min() > -1e-4
    assert (short < 1e-3).mean() > 0.8
    assert short.max() < 0.1


@pytest.mark.parametrize("name", MODELS)
def test_with_all_pixels_nothing_is_missed(name: str) -> None:
    """With the power of every pixel and all axes of color the maps are those of the transforms."""
    scan, image, corners = searched(name)
    colors = replace(scan.colors, main=3)
    whole = replace(scan, sizes=(1, 1), colors=colors)
    planes = colors.planes(image)
    found = np.concatenate(list(whole.maps(planes, corners)))
    np.testing.assert_allclose(found, whole._transforms(planes, corners), atol=1e-4)


def test_the_better_of_two_makes_up_for_half_the_resolution() -> None:
    """With pixels taken two by two the NCC found is exact, and within 0.001 of the highest nearly always."""
    scan, image, corners = searched("hexagon")
    coarse, planes = replace(scan, sizes=(2, 2)), scan.colors.planes(image)
    at, ncc = coarse.find(planes, corners)
    exact = np.full((len(corners), *scan.where.shape), -1.0)
    exact[:, scan.where] = scan._transforms(planes, corners)
    np.testing.assert_allclose(ncc, exact[np.arange(len(at)), at[:, 1], at[:, 0]], atol=1e-4)
    assert (exact.max((1, 2)) - ncc < 1e-3).mean() > 0.9


@pytest.mark.parametrize("size", [1, 2])
def test_sums_along_the_axes_are_sums_over_windows(size: int) -> None:
    """What is summed along one axis and then the other is what each window's pixels sum to."""
    scan = replace(searched("weave")[0], sizes=(size, 2))
    planes = smoothed(np.moveaxis(scan.template.image, -1, 0), size)
    cut = scan._cut(planes, scan._offsets, size)
    np.testing.assert_allclose(scan._sums(planes), cut.sum(2).T, atol=1e-3)


def test_flat_windows_show_nothing() -> None:
    """A window without variance has NCC 0 everywhere."""
    scan, image, corners = searched("brick")
    planes = scan.colors.planes(np.full_like(image, 0.4))
    assert np.abs(np.concatenate(list(scan.maps(planes, corners)))).max() == 0
    assert np.abs(scan.find(planes, corners)[1]).max() == 0


def test_axes_of_color_are_those_that_vary() -> None:
    """Of an image on a line of colors one axis varies; turning the colors changes no distance."""
    shape = np.random.default_rng(0).random((20, 30, 1), np.float32)
    image = shape * np.array([0.7, -0.2, 0.4], np.float32) + np.float32(0.3)
    colors = Colors.of(image)
    assert (colors.varies, colors.main) == (1, 1)
    turned = colors.along(image)
    np.testing.assert_allclose(
        np.linalg.norm(turned, axis=-1), np.linalg.norm(image - image.mean((0, 1)), axis=-1), atol=1e-5
    )
    assert np.abs(turned[..., 1:]).max() < 1e-5
