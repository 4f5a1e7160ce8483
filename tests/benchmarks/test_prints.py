"""The benchmark of prints finds the elements of a picture, and measures their colors by CIELAB distances."""

from types import ModuleType

import numpy as np
import pytest
from skimage.color import rgb2lab

SHAPE, CORNER = (72, 90), (17, 40)


def crop_of(script: ModuleType, name: str) -> np.ndarray:
    """Return a part of a print, from :data:`CORNER` of its file."""
    (left, top), (height, width) = CORNER, SHAPE
    picture = script.DESIGNS[name].draw((top + height, left + width), script.CLASSES[name])
    return np.asarray(picture[top:, left:])


@pytest.mark.parametrize("name", ["dots-rim", "checks", "stars"])
def test_elements_have_the_colors_of_their_inks(script: ModuleType, name: str) -> None:
    """The color of each part of an element is the ink of its class, without scatter; a thin rim has no inner pixel."""
    design, classes = script.DESIGNS[name], script.CLASSES[name]
    found = script.find_elements(design, crop_of(script, name), CORNER)
    inks = rgb2lab(np.array(design.inks))[classes[found.place[:, 0] % 64, found.place[:, 1] % 64]]
    assert len(found.place) >= 6
    assert np.abs(found.color - (inks[:, 1:] if name == "dots-rim" else inks)).max() < 1e-6
    assert found.scatter.max() < 1e-6


def test_equal_prints_have_no_difference(script: ModuleType) -> None:
    """A print compared with itself has no new color, no uneven element, and the same statistics."""
    design, classes = script.DESIGNS["flowers"], script.CLASSES["flowers"]
    own = script.find_elements(design, crop_of(script, "flowers"), CORNER)
    compared = script.compare(design, classes, own, own)
    assert compared == script.Comparison(pytest.approx(0, abs=1e-9), 0.0, 0.0, 0.0)


def test_one_new_color_is_found(script: ModuleType) -> None:
    """One element of another color is as far from the sample as its color is, however many others are right."""
    design, classes = script.DESIGNS["checks"], script.CLASSES["checks"]
    picture, at = crop_of(script, "checks"), design.layout(SHAPE, CORNER)
    own = script.find_elements(design, picture, CORNER)
    row, column = own.place[len(own.place) // 2]
    there = ((at.row == row) & (at.column == column))[2::4, 2::4]
    green = np.array((0.1, 0.8, 0.1))
    other = np.where(there[..., np.newaxis], green, picture)
    compared = script.compare(design, classes, own, script.find_elements(design, other, CORNER))
    inks = rgb2lab(np.array(design.inks)[:, 0])
    assert compared.farthest == pytest.approx(np.linalg.norm(inks - rgb2lab(green), axis=-1).min(), abs=1e-6)
    assert compared.uneven == 0


def test_parts_of_two_classes_are_no_element_of_the_sample(script: ModuleType) -> None:
    """Petals of one class around the middle of another are new, though each color is in the sample."""
    design, classes = script.DESIGNS["flowers"], script.CLASSES["flowers"]
    own = script.find_elements(design, crop_of(script, "flowers"), CORNER)
    mixed = own.color.copy()
    mixed[:, 1] = np.roll(mixed[:, 1], 1, 0)
    assert script.compare(design, classes, own, own._replace(color=mixed)).farthest > 20


def test_two_halves_are_uneven(script: ModuleType) -> None:
    """An element that is joined of two colors counts as uneven."""
    design, classes = script.DESIGNS["checks"], script.CLASSES["checks"]
    picture = crop_of(script, "checks")
    own = script.find_elements(design, picture, CORNER)
    halves = np.where((np.arange(SHAPE[1]) % 2 == 0)[:, np.newaxis], picture, 1 - picture)
    assert script.compare(design, classes, own, script.find_elements(design, halves, CORNER)).uneven == 1
