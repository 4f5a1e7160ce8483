from typing import Literal

import numpy as np
import pytest
from synthesis_cases import mask_of, smooth

from nrbench import texture
from nrbench.calling.method_calls import checked_synthesis, is_picture
from nrbench.errors import BadInput
from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Refused, Synthesis, Task
from nrbench.synthesizers.fftm_patch import FftmPatch, automatic_size
from nrbench.synthesizers.masks.texture_mask import MaskParameters, TextureMask

WHOLE = Lattice((24, 0), (0, 20))


def test_the_papers_patches_are_the_tiles_of_their_sample() -> None:
    """With free waves the rule of equation 7 gives the tile of each sample; the other rule gives 40 px always."""
    paper = FftmPatch(**FftmPatch.presets["paper"])
    assert paper.patch_rule == "lowest" and paper.harmonics == "free"
    for width, height in ((27.3, 12.2), (23.7, 10.4)):
        sample = quantize(texture("brick", (128, 128), 1, width=width, height=height, color=0.14).image)
        mask = paper.find_mask(sample)
        size = automatic_size(mask, (128, 128), paper.patch_rule)
        assert np.abs(np.subtract(size, (2 * height, width))).max() < 1
        assert automatic_size(mask, (128, 128)) == (40, 40)


def waves_of(tile: Image) -> TextureMask:
    """Return the mask of a repeated tile."""
    return MaskParameters().find_mask(np.tile(tile, (4, 4, 1)))


def synthesize(method: FftmPatch, sample: Image, shape: tuple[int, int], mask: TextureMask) -> Synthesis:
    """Run the method with a known mask."""
    made = method.synthesize_with_mask(Task(sample, shape, None, np.random.default_rng(1)), mask)
    return checked_synthesis(made, sample, shape)


def varied(tile: Image, height: int, width: int, strength: float, seed: int = 3) -> Image:
    """Return a sample: the repeated tile with smooth departures."""
    repeated = np.tile(tile, (height // tile.shape[0] + 1, width // tile.shape[1] + 1, 1))[:height, :width]
    departures = smooth(height, width, tile.shape[2], seed) - 0.5
    return quantize(np.clip(repeated + strength * departures, 0, 1))


@pytest.mark.parametrize("normalized", [False, True])
@pytest.mark.parametrize("channels", [1, 3])
def test_a_whole_pixel_lattice_is_continued(normalized: bool, channels: int) -> None:
    """For a perfectly periodic sample and a perfect mask, the output is exactly the periodic continuation."""
    tile = smooth(20, 24, channels)
    picture = quantize(np.tile(tile, (13, 13, 1)))
    method = FftmPatch(normalized=normalized, randomness=1e-4)
    for shape in ((160, 150), (1, 200), (200, 1), (9, 5), (1, 1)):
        made = synthesize(method, picture[:96, :96], shape, mask_of(tile))
        np.testing.assert_array_equal(made.image, picture[: shape[0], : shape[1]])


@pytest.mark.parametrize("matching", ["sub-patch", "entire"])
def test_departures_from_the_mask_do_not_break_the_phase(matching: Literal["sub-patch", "entire"]) -> None:
    """For a sample with departures, every pixel comes from its own place in the tile, up to one pixel."""
    tile = smooth(20, 24)
    made = synthesize(FftmPatch(matching=matching), varied(tile, 96, 96, 0.4), (240, 250), mask_of(tile))
    y, x = np.mgrid[:240, :250]
    for found, place, period in ((made.source[..., 0], x, 24), (made.source[..., 1], y, 20)):
        assert np.abs((found - place + period / 2) % period - period / 2).max() <= 1
    starts = np.unique((made.source[..., :2] - np.stack([x, y], -1)).reshape(-1, 2), axis=0)
    assert len(starts) > 8


@pytest.mark.parametrize("shape", [(64, 70), (3, 90), (90, 2), (20, 24)])
@pytest.mark.parametrize("channels", [1, 3])
def test_any_shape_is_filled_with_copies(shape: tuple[int, int], channels: int) -> None:
    """Every pixel is the copy that the source map names, also in small outputs and in lines of pixels."""
    tile = smooth(20, 24, channels)
    sample = varied(tile, 60, 66, 0.5)
    made = synthesize(FftmPatch(randomness=0.2), sample, shape, mask_of(tile))
    x, y, weight = np.moveaxis(made.source, -1, 0)
    assert (weight == 1).all()
    np.testing.assert_array_equal(made.image, sample[y.astype(int), x.astype(int)])
    assert is_picture(made.extras["mask"])
    np.testing.assert_array_equal(made.extras["mask"], mask_of(tile).draw(shape))
    assert made.lattice is not None and made.lattice.is_equivalent(WHOLE, 1e-6)


def test_without_weight_the_mask_does_not_matter() -> None:
    """At weight 0 another mask of the same tile size gives the same output."""
    sample = varied(smooth(20, 24), 60, 60, 0.5)
    masks = [mask_of(smooth(20, 24, seed=seed)) for seed in (5, 6)]
    made = [synthesize(FftmPatch(weight=0.0), sample, (80, 80), mask).image for mask in masks]
    np.testing.assert_array_equal(*made)


def test_entire_patches_are_placed_by_the_mask() -> None:
    """With entire patches the mask places the first one: in phase with a weight, and anywhere at weight 0."""
    tile = smooth(20, 24)
    sample, mask = varied(tile, 96, 96, 0.2), mask_of(tile)
    methods = [FftmPatch(matching="entire", weight=weight, randomness=0.0) for weight in (1.0, 0.0)]
    firsts = [synthesize(method, sample, (40, 44), mask).source for method in methods]
    phases = [first[0, 0, :2] % (24, 20) for first in firsts if first is not None]
    assert phases[0].tolist() == [0, 0] and phases[1].tolist() != [0, 0]


def test_the_patches_of_the_preset_are_larger_than_its_windows() -> None:
    """The whole sample is laid where a window fits: half of the output lies in parts of more than two windows."""
    sample = quantize(texture("brick", (96, 96), 1, color=0.3).image)
    paper = FftmPatch(**{**FftmPatch.presets["paper"], "refinements": 1})
    mask = paper.find_mask(sample)
    made = synthesize(paper, sample, (160, 160), mask)
    height, width = automatic_size(mask, (96, 96), paper.patch_rule)
    starts = (made.source[..., :2] - np.stack(np.meshgrid(np.arange(160), np.arange(160)), -1)).reshape(-1, 2)
    _, which, counts = np.unique(starts, axis=0, return_inverse=True, return_counts=True)
    assert np.median(counts[which]) > 2 * height * width


@pytest.mark.parametrize("matching", ["sub-patch", "entire"])
def test_a_tileable_output_continues_at_its_edges(matching: Literal["sub-patch", "entire"]) -> None:
    """Between copies laid side by side there is no larger jump than inside; without ``tileable`` there is."""
    tile = smooth(20, 24)
    sample, mask = varied(tile, 72, 72, 1.0), waves_of(tile)

    def jump(tileable: bool) -> tuple[float, float]:
        method = FftmPatch(matching=matching, tileable=tileable, refinements=2)
        image = synthesize(method, sample, (120, 120), mask).image
        twice = np.tile(image, (2, 2, 1)).astype(float)
        steps = np.abs(np.diff(twice, axis=1)).mean((0, 2)), np.abs(np.diff(twice, axis=0)).mean((1, 2))
        return max(each[119] for each in steps), max(np.delete(each, 119).max() for each in steps)

    across, inside = jump(True)
    assert across <= inside
    assert jump(False)[0] > 1.2 * inside


def test_an_output_that_is_no_period_is_not_tileable() -> None:
    """The message names the nearest valid size; too small outputs are refused, too."""
    tile = smooth(20, 24)
    method, sample = FftmPatch(tileable=True), varied(tile, 60, 60, 0.3)
    with pytest.raises(Refused, match=r"nearest valid size: 9[678]x100"):
        synthesize(method, sample, (100, 100), waves_of(tile))
    with pytest.raises(Refused, match=r"nearest valid size: 24x[12]"):
        synthesize(method, sample, (2, 24), waves_of(tile))
    with pytest.raises(BadInput, match="choose harmonics 'tied'"):
        FftmPatch(tileable=True, harmonics="free")


@pytest.mark.parametrize(
    ("tile", "room", "size"),
    [
        ((20, 24), (128, 128), (40, 24)),
        ((7, 31), (128, 128), (28, 31)),
        ((20, 24), (30, 200), (15, 24)),
        ((90, 24), (128, 128), (40, 40)),
        ((90, 24), (9, 8), (4, 4)),
        ((20, 24), (1, 1), (1, 1)),
    ],
)
def test_patches_are_tiles_of_some_size(tile: tuple[int, int], room: tuple[int, int], size: tuple[int, int]) -> None:
    """A patch has as few tiles as give 24 px a side; 40 px without a tile; at most half the sample."""
    assert automatic_size(mask_of(smooth(*tile)), room) == size


@pytest.mark.parametrize("given", [False, True])
def test_it_makes_the_mask_by_itself(given: bool) -> None:
    """The method finds the mask of a brick wall, with or without a lattice, and continues it far beyond the sample."""
    wall = texture("brick", (160, 160), seed=1, color=0.1)
    lattice = wall.lattice if given else None
    made = FftmPatch().synthesize(Task(quantize(wall.image[:80, :80]), (160, 160), lattice, np.random.default_rng(0)))
    assert made.lattice is not None and made.lattice.is_equivalent(wall.lattice, 0.05)
    assert (made.detection_seconds > 0) != given
    assert np.corrcoef(made.extras["mask"].ravel(), wall.ideal.ravel())[0, 1] > 0.95
    assert np.corrcoef(made.image.ravel(), wall.ideal.ravel())[0, 1] > 0.8
