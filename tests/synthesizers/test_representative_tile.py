"""Claims about the representative tile: its costs, its choice, its repetition, and what is refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import call
from hypothesis import given, settings
from hypothesis import strategies as st
from synthesis_cases import BOND, FRACTIONAL, OBLIQUE, UPRIGHT, noise, waves

from nrbench.detectors.ssdn import ssdn
from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.pictures.files import read_image, write_image
from nrbench.plugins.forms import Refused, Synthesis, Task
from nrbench.synthesizers.representative_tile import (
    Costs,
    Mask,
    RepresentativeTile,
    Size,
    Values,
    continuity,
    preselect,
    resemblance,
)


def synthesize(
    sample: Image, shape: tuple[int, int], lattice: Lattice | None, seed: int = 1, **parameters: Any
) -> Synthesis:
    """Run the method."""
    return RepresentativeTile(**parameters).synthesize(Task(sample, shape, lattice, np.random.default_rng(seed)))


def test_the_tile_is_the_best_of_all_by_brute_force() -> None:
    """No place has a smaller alpha h + SSDN than the tile's, and the tile is what lies there."""
    sample, lattice = noise(40, 50), Lattice((11, 0), (0, 9))
    for alpha in (1.0, 30.0, 0.0):
        made = synthesize(sample, (40, 50), lattice, continuity_weight=alpha)
        rating = alpha * continuity(sample, (9, 11)) + resemblance(sample, (9, 11))
        x, y, smooth, alike, total = made.extras["best"][0]
        assert (int(y), int(x)) == np.unravel_index(rating.argmin(), rating.shape)
        assert alpha * smooth + alike == pytest.approx(total) == pytest.approx(rating.min())
        np.testing.assert_array_equal(quantize(made.extras["tile"]), sample[int(y) :, int(x) :][:9, :11])


def test_the_output_shows_the_sample_where_the_tile_lies() -> None:
    """The tile stays in its place (figure 4), and is repeated around it."""
    sample = noise(40, 50)
    made = synthesize(sample, (40, 50), Lattice((11, 0), (0, 9)))
    x, y = made.extras["best"][0, :2].astype(int)
    np.testing.assert_array_equal(quantize(made.image)[y : y + 9, x : x + 11], sample[y : y + 9, x : x + 11])
    np.testing.assert_array_equal(made.image[9:], made.image[:-9])
    np.testing.assert_array_equal(made.image[:, 11:], made.image[:, :-11])


def test_the_tile_is_floored_and_scaled_down_and_the_output_is_not() -> None:
    """The period of 21.37 x 18.81 px becomes 21 x 18 (equation 4); the output keeps the sample's period by default."""
    sample = quantize(waves((128, 128), UPRIGHT))
    made = synthesize(sample, (300, 300), UPRIGHT)
    assert made.extras["tile"].shape == (18, 21, 3)
    np.testing.assert_allclose(made.extras["frame"][1:], [[21.37 / 21, 0], [0, 18.81 / 18]])
    paper = synthesize(sample, (300, 300), UPRIGHT, rescale=False)
    np.testing.assert_array_equal(paper.image[18:, 21:], paper.image[:-18, :-21])
    small = waves((300, 300), Lattice((21, 0), (0, 18)))
    assert -10 * np.log10(((paper.image - small) ** 2).mean()) > 35


def test_the_papers_setting_returns_the_lattice_that_it_laid() -> None:
    """The output repeats by the returned lattice, whole pixels."""
    sample, parameters = noise(96, 96), RepresentativeTile.presets["paper"]
    made = synthesize(sample, (90, 90), Lattice((20.4, 0), (10.2, 8.3), (3.0, 2.0)), **parameters)
    assert made.lattice is not None and made.lattice.is_equivalent(Lattice((20, 0), (10, 8)), 1e-9)
    np.testing.assert_array_equal(made.image[16:, 20:], made.image[:-16, :-20])
    smooth = quantize(waves((128, 128), UPRIGHT))
    laid = synthesize(smooth, (128, 128), UPRIGHT, **parameters).lattice
    np.testing.assert_allclose(laid.matrix, [[21, 0], [0, 18]], atol=1e-9)


def test_p_takes_the_smoothest_places_first() -> None:
    """With p only the share of places of least h is rated; with a small one the tile is the smoothest of all."""
    sample, lattice = noise(40, 50), Lattice((11, 0), (0, 9))
    smooth = continuity(sample, (9, 11))
    kept = preselect(smooth, 0.05 * smooth.size)
    assert kept.sum() == round(0.05 * smooth.size) and smooth[kept].max() <= smooth[~kept].min()
    first = synthesize(sample, (9, 9), lattice, rated_share=1e-4).extras["best"][0]
    assert first[2] == pytest.approx(smooth.min())
    alike = np.where(kept, smooth + resemblance(sample, (9, 11)), np.inf)
    best = synthesize(sample, (9, 9), lattice, rated_share=0.05, continuity_weight=1.0).extras["best"]
    assert best[0, 4] == pytest.approx(alike.min())


def test_a_turned_rectangle_is_cut_upright() -> None:
    """Of a lattice turned by 7 degrees the tile stands upright: it is that of the lattice before the turn."""
    made = synthesize(quantize(waves((128, 128), FRACTIONAL)), (64, 64), FRACTIONAL)
    tile = made.extras["tile"]
    assert tile.shape == (18, 21, 3)
    steps = made.extras["frame"][1:]
    np.testing.assert_allclose(np.degrees(np.arctan2(*steps[:, ::-1].T)), [7, 97], atol=1e-6)
    upright = waves((18, 21), Lattice((21, 0), (0, 18), tuple(-FRACTIONAL.to_cell(made.extras["frame"][0]) * (21, 18))))
    assert np.sqrt(((tile - upright) ** 2).mean()) < 0.01


def test_a_centred_lattice_gets_a_rectangle_of_two_cells() -> None:
    """A running bond is tiled by two bricks, and the note says so."""
    made = synthesize(quantize(waves((128, 128), BOND)), (64, 64), BOND)
    assert made.extras["tile"].shape == (24, 27, 3) and "2 cells" in made.note


def test_a_turned_tile_stands_back_behind_an_upright_one_unless_that_is_large() -> None:
    """Squares turned by 45 degrees get an upright tile of two; turned by that of a 3-4-5 triangle, a turned one."""
    for lattice, shape in ((Lattice((14, 14), (-14, 14)), (28, 28)), (Lattice((16, 12), (-12, 16)), (20, 20))):
        made = synthesize(quantize(waves((128, 128), lattice)), (16, 16), lattice)
        assert made.extras["tile"].shape[:2] == shape


def naive_tiling(image: Values, y: int, x: int, size: Size) -> Values:
    """Repeat the tile at (y, x) over the image, in the place where it lies (section 4.2, figure 4)."""
    tile = image[y : y + size[0], x : x + size[1]]
    rows, columns = (np.arange(image.shape[0]) - y) % size[0], (np.arange(image.shape[1]) - x) % size[1]
    return tile[np.ix_(rows, columns)]


def naive_continuity(tile: Values) -> float:
    """Sum equation 5 term by term."""
    height, width = tile.shape[:2]
    wide = tile.astype(np.float64)
    total = sum(((wide[height - 1, i] - wide[0, i]) ** 2).sum() for i in range(width))
    total += sum(((wide[i, width - 1] - wide[i, 0]) ** 2).sum() for i in range(height))
    return float(total / (2 * (width + height - 1)))


@settings(max_examples=30)
@given(
    st.tuples(st.integers(5, 24), st.integers(5, 24)),
    st.tuples(st.integers(1, 9), st.integers(1, 9)),
    st.sampled_from([1, 3]),
    st.integers(0, 99),
)
def test_every_place_costs_what_brute_force_says(shape: Size, size: Size, channels: int, seed: int) -> None:
    """Both criteria of every tile equal the paper's sums, to 1e-9, whatever the sizes."""
    image, size = noise(*shape, channels, seed), (min(size[0], shape[0]), min(size[1], shape[1]))
    alike, smooth = resemblance(image, size), continuity(image, size)
    assert alike.shape == smooth.shape == (shape[0] - size[0] + 1, shape[1] - size[1] + 1)
    for y, x in np.ndindex(alike.shape):
        assert alike[y, x] == pytest.approx(ssdn(naive_tiling(image, y, x, size), image), abs=1e-9)
        assert smooth[y, x] == pytest.approx(naive_continuity(image[y : y + size[0], x : x + size[1]]), abs=1e-9)


def naive_masked(image: Values, size: Size, known: Mask) -> Costs:
    """Compare the known pixels only; tiles that hold others cost infinity."""
    costs = np.full((image.shape[0] - size[0] + 1, image.shape[1] - size[1] + 1), np.inf)
    for y, x in np.ndindex(costs.shape):
        if known[y : y + size[0], x : x + size[1]].all():
            difference = (naive_tiling(image, y, x, size) - image.astype(np.float64))[known]
            costs[y, x] = (difference**2).sum() / known.sum()
    return costs


def test_unknown_pixels_neither_count_nor_serve() -> None:
    """With a disc of known pixels only, costs are brute force's over them, infinite for tiles that reach beyond."""
    y, x = np.indices((31, 27))
    known = np.hypot(y - 15, x - 13) < 13
    image = noise(31, 27, 3)
    costs = resemblance(image, (6, 5), known)
    np.testing.assert_allclose(costs, naive_masked(image, (6, 5), known), atol=1e-9)
    assert 0 < np.isfinite(costs).sum() < costs.size
    spoilt = np.where(known[..., np.newaxis], image, np.float32(7))
    np.testing.assert_allclose(resemblance(spoilt, (6, 5), known), costs, atol=1e-9)


def test_a_periodic_image_costs_nothing_and_any_other_something() -> None:
    """Every tile of a perfectly periodic image retells it; with one pixel changed, none does."""
    image = np.tile(noise(6, 7, 3), (4, 5, 1))
    np.testing.assert_allclose(resemblance(image, (6, 7)), 0, atol=1e-12)
    image[11, 17] += 0.5
    assert resemblance(image, (6, 7)).min() > 1e-4


PAPER = RepresentativeTile(**RepresentativeTile.presets["paper"])


def test_an_oblique_lattice_gets_a_rectangle_within_tolerance_or_is_refused() -> None:
    """Without tolerance no rectangle repeats; with some, one does."""
    sample = quantize(waves((128, 128), OBLIQUE))
    with pytest.raises(Refused, match="larger than the sample"):
        synthesize(sample, (64, 64), OBLIQUE, tolerance=0.0)
    assert synthesize(sample, (64, 64), OBLIQUE).extras["tile"].ndim == 3


def test_without_a_lattice_given_its_period_is_that_of_ssdn() -> None:
    """On a stacked wall without a given lattice the sub-pixel period is found, used and reported, with its cost."""
    sample = quantize(waves((128, 128), UPRIGHT))
    made = synthesize(sample, (400, 400), None)
    assert made.lattice is not None and made.detection_seconds > 0
    assert np.abs(np.sort(np.abs(made.lattice.matrix).max(0)) - (18.81, 21.37)).max() < 0.05
    last = synthesize(sample, (64, 64), None, finder="ssdn:preset=paper").lattice
    assert last is not None and last != made.lattice
    peaks = [round(5 * 21.37), round(6 * 18.81)]
    assert np.abs(np.array([last.matrix.max(0)[0] * 5, last.matrix.max(0)[1] * 6]) - peaks).max() < 1


def test_noise_is_refused_and_the_paper_goes_on() -> None:
    """Where no period is better than chance there is no tile; the paper takes the last minimum all the same."""
    sample = noise(64, 64, seed=23)
    with pytest.raises(Refused, match="no lattice found"):
        synthesize(sample, (64, 64), None)
    assert PAPER.synthesize(Task(sample, (64, 64), None, np.random.default_rng(0))).image.shape == (64, 64, 3)


def test_the_tolerance_decides_on_the_size_of_the_tile() -> None:
    """A slanted lattice has a large rectangle within a small tolerance, and a small one within a larger tolerance."""
    oblique = Lattice((20.3, 0), (6.1, 18.7))
    slanted = quantize(waves((128, 128), oblique))
    sizes = {synthesize(slanted, (9, 9), oblique, tolerance=share).extras["tile"].shape for share in (0.05, 0.1)}
    assert sizes == {(60, 50, 3), (23, 32, 3)}


def test_the_command_line_writes_the_tile_beside_the_output(capsys: pytest.CaptureFixture[str]) -> None:
    """``synth --extras`` writes the tile as a picture of its own; without the option, it prints the name alone."""
    write_image("sample.png", noise(60, 66, 1))
    line = "synth sample.png -m representative-tile:rescale=false --size 40x30 --lattice 11,0,0,9 -o out.png"
    assert call(line) == 0
    assert "not written: tile; --extras writes them" in capsys.readouterr().err
    assert not Path("out-tile.png").exists()
    assert call(f"{line} --extras") == 0
    tile, output = read_image("out-tile.png"), read_image("out.png")
    windows = (output[y : y + 9, x : x + 11] for y, x in np.ndindex(9, 11))
    assert tile.shape == (9, 11, 1) and any(np.array_equal(window, tile) for window in windows)
