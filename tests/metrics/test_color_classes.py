"""Prints: element colors that come in classes, colors that belong to none, and equal elements that repeat nothing."""

from functools import cache, partial

import numpy as np
import pytest
from cases import scored
from numpy.typing import NDArray

from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.metrics.appearance import Appearance
from nrbench.metrics.judgment.color_classes import PlaceClasses, find_classes
from nrbench.metrics.randomness import Randomness
from nrbench.plugins.forms import Observation, Task, Texture
from nrbench.synthesizers.supertile import Supertile
from nrbench.synthesizers.tiling import Tiling

INKS = {
    2: np.array([(0.15, 0.3, 0.5), (0.85, 0.45, 0.3)]),
    3: np.array([(0.84, 0.28, 0.24), (0.2, 0.44, 0.7), (0.95, 0.75, 0.2)]),
}
PERIOD, RADIUS = 21.4, 7.5
LATTICE = Lattice((PERIOD, 0), (0, PERIOD), (3.0, 5.0))


def print_dots(colors: NDArray[np.float64], shift: float = 0.0) -> Image:
    """Return a picture of dots of given colors, ``(n, n, 3)``, on a light ground, shifted by some px."""
    side = int((len(colors) - 1) * PERIOD)
    y, x = (np.indices((4 * side, 4 * side)) + 0.5) / 4 - 0.5
    u, v = (x - 3 - shift) / PERIOD, (y - 5 - shift) / PERIOD
    i, j = np.rint(u).astype(int), np.rint(v).astype(int)
    dots = (np.hypot(u - i, v - j) * PERIOD < RADIUS)[..., np.newaxis]
    picture = np.where(dots, colors[j % len(colors), i % len(colors)], (0.93, 0.92, 0.88))
    return quantize(picture.reshape(side, 4, side, 4, 3).mean((1, 3)).astype(np.float32))


@cache
def draw_dots(inks: int, number: int, cells: int = 11) -> Image:
    """Return a print whose dots are drawn from a palette."""
    return print_dots(INKS[inks][np.random.default_rng([inks, number]).integers(inks, size=(cells, cells))])


def observe(inks: int, output: Image) -> Observation:
    """Return the observation of an output beside a sample that shows about 30 dots."""
    sample = draw_dots(inks, 0, 7)
    return Observation(sample, output, Texture(sample, LATTICE), rng=np.random.default_rng(0))


appearance, randomness = (partial(scored, metric) for metric in (Appearance, Randomness))


@pytest.mark.parametrize("inks", [2, 3])
def test_a_fresh_print_is_right(inks: int) -> None:
    """A print from the same inks has no new color, and equal dots are no repetition, by the sample alone."""
    for number in (1, 2, 3):
        observation = observe(inks, draw_dots(inks, number))
        assert randomness(observation).values["score"] >= 0.85
        assert appearance(observation).values["colors"] == 0


@pytest.mark.parametrize("inks", [2, 3])
def test_invented_colors_are_no_appearance(inks: int) -> None:
    """Colors between the inks, with their mean and covariance, have an appearance of 0."""
    rng, palette = np.random.default_rng(1), INKS[inks]
    colors = rng.multivariate_normal(palette.mean(0), np.cov(palette.T, ddof=0), (11, 11)).clip(0.02, 0.98)
    values = appearance(observe(inks, print_dots(colors))).values
    assert values["colors"] > 3 and values["score"] == 0


def test_dots_off_their_places_have_no_new_color() -> None:
    """Dots of the right inks, some of which lie 0.7 px off, have no new color, although their borders change."""
    colors = INKS[3][np.random.default_rng(4).integers(3, size=(11, 11))]
    left, right = print_dots(colors), print_dots(colors, 0.7)
    middle = left.shape[1] // 2
    mixed = np.concatenate([left[:, :middle], right[:, middle:]], 1)
    assert appearance(observe(3, mixed)).values["colors"] == 0


def test_one_strange_dot_is_allowed_and_many_are_not() -> None:
    """One dot of another color costs nothing, because a sample of 30 does not show rare ones; a third of them does."""
    colors = INKS[3][np.random.default_rng(4).integers(3, size=(11, 11))]
    one, many = colors.copy(), colors.copy()
    one[5, 5] = (0.4, 0.7, 0.4)
    many[::2, ::2] = (0.4, 0.7, 0.4)
    found = [appearance(observe(3, print_dots(each))).values["colors"] for each in (one, many)]
    assert 0 < found[0] < 1 < 1.5 < found[1]


@pytest.mark.parametrize("inks", [2, 3])
@pytest.mark.parametrize("method", [Tiling, Supertile])
def test_a_repeated_print_is_no_print(inks: int, method: type) -> None:
    """One dot repeated, or one crop of the sample, has at most 0.3, where elements are alike, too."""
    sample = draw_dots(inks, 0, 7)
    task = Task(sample, (214, 214), LATTICE, np.random.default_rng(0))
    values = randomness(observe(inks, quantize(method().synthesize(task).image))).values
    assert values["score"] <= 0.3


def test_sorted_inks_are_no_random_print() -> None:
    """Dots sorted by ink, into rows or a checkerboard, have at most 0.3."""
    rows = np.sort(np.random.default_rng(3).integers(2, size=121)).reshape(11, 11)
    board = np.indices((11, 11)).sum(0) % 2
    for order in (rows, board):
        assert randomness(observe(2, print_dots(INKS[2][order]))).values["score"] <= 0.3


def test_colors_that_vary_form_no_classes() -> None:
    """Neither Gaussian nor uniform colors form classes, nor do wide or near classes, however many are shown."""
    rng = np.random.default_rng(0)
    for count in (20, 60, 300):
        number = rng.integers(2, size=count)[:, np.newaxis]
        uniform, noise = rng.uniform(-20, 20, (count, 3)), rng.normal(0, 1, (count, 3))
        for colors in (10 * noise, uniform, uniform * (1, 0, 0), 40 * number + 8 * noise, 5 * number + noise):
            assert find_classes(colors) is None


def test_classes_are_found_at_all_counts() -> None:
    """Two to six tight classes are found, those of a single cell included."""
    rng = np.random.default_rng(0)
    for count in range(2, 7):
        number = np.concatenate([np.arange(count), rng.integers(1, count, size=40)])
        centers = np.array([(0, 0, 0), (40, 0, 0), (0, 40, 0), (0, 0, 40), (-40, 0, 0), (0, -40, 0)])
        found = find_classes(centers[number] + rng.normal(0, 0.7, (len(number), 3)))
        assert found is not None and sorted(found.counts) == sorted(np.bincount(number))


def test_rare_classes_allow_new_ones() -> None:
    """The more classes a sample shows once, the more cells may have a class that it does not show (Good 1953)."""
    centers, new = np.eye(3) * 40, np.full((100, 3), -30.0)
    new[10:] = centers[0]
    ratios = [
        PlaceClasses(0, centers, np.array(counts), 0.5).measure_new(new, np.argwhere(np.ones((10, 10))))
        for counts in ((100, 100, 100), (20, 10, 10), (38, 1, 1))
    ]
    assert ratios[0] > 1.5 > ratios[1] > 1 > ratios[2]
