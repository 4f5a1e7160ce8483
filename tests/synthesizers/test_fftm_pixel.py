import inspect
import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from skimage.color import rgb2ypbpr
from synthesis_cases import noise

from nrbench.errors import BadInput
from nrbench.imaging.convert import Image, quantize
from nrbench.metrics.source import SourceUse
from nrbench.plugins.forms import Observation, Refused, Synthesis, Task
from nrbench.plugins.parameters import fields_by_call
from nrbench.running.output_checks import checked_synthesis, is_picture
from nrbench.spectra.harmonics import WaveAnalysis
from nrbench.synthesizers.ann_pixel import AnnPixel
from nrbench.synthesizers.fftm_patch import FftmPatch
from nrbench.synthesizers.fftm_pixel import FftmPixel
from nrbench.synthesizers.masks.texture_mask import TextureMask

SEARCHES = ("ann", "exhaustive", "k-coherence")
MATCHES = ("full", "cluster")


def mask_of(tile: Image, stretch: float = 1.0) -> TextureMask:
    """Return the exact mask of a repeated tile with odd sides, stretched about (0, 0)."""
    height, width, channels = tile.shape
    planes = rgb2ypbpr(tile.astype(np.float64)) if channels == 3 else tile.astype(np.float64)
    waves = np.fft.fft2(planes, axes=(0, 1)) / (height * width)
    v, u = (np.rint(np.fft.fftfreq(n) * n).astype(int) for n in (height, width))
    orders = np.array([(i, j) for j in v for i in u if i > 0 or (i == 0 and j > 0)])
    chosen = 2 * waves[orders[:, 1], orders[:, 0]]
    fundamentals = np.diag([1 / (width * stretch), 1 / (height * stretch)])
    mean = waves[0, 0].real
    return TextureMask(
        WaveAnalysis(orders @ fundamentals, chosen.real, -chosen.imag, mean, fundamentals, orders, (2,), 1.0)
    )


def soft_tile(height: int, width: int, channels: int = 3) -> Image:
    """Return a smooth tile."""
    y, x = np.indices((height, width))
    wave = 0.5 + 0.25 * np.cos(2 * np.pi * x / width) + 0.2 * np.sin(2 * np.pi * y / height)
    return quantize(np.repeat(wave[..., np.newaxis], channels, 2).astype(np.float32))


def repeated(tile: Image, shape: tuple[int, int], grain: float = 0.0, seed: int = 0) -> Image:
    """Return a tile that is repeated over ``shape``, with noise."""
    height, width = (-(-want // have) for want, have in zip(shape, tile.shape, strict=False))
    picture = np.tile(tile, (height, width, 1))[: shape[0], : shape[1]]
    return quantize(picture + grain * np.random.default_rng(seed).standard_normal(picture.shape).astype(np.float32))


def synthesize(method: FftmPixel, sample: Image, shape: tuple[int, int], mask: TextureMask, seed: int = 1) -> Synthesis:
    """Run the method with a known mask."""
    return method.synthesize_with_mask(Task(sample, shape, None, np.random.default_rng(seed)), mask)


def mean_run(made: Synthesis, sample: Image) -> float:
    """Return the mean unbroken run of the source map, px."""
    found = SourceUse().score(Observation(sample, made.image, source=made.source)).values["mean_copy_length"]
    assert found is not None
    return float(found)


@pytest.mark.parametrize("match", MATCHES)
@pytest.mark.parametrize("search", SEARCHES)
@pytest.mark.parametrize("neighborhood", [2, 3, 6])
@pytest.mark.parametrize("channels", [1, 3])
def test_a_perfect_texture_with_a_perfect_mask_is_continued(
    match: Any, search: Any, neighborhood: int, channels: int
) -> None:
    """On a whole-pixel lattice the output continues the texture periodically: PSNR over 35 dB, exact for match full."""
    tile = noise(13, 15, channels)
    sample, due = repeated(tile, (60, 62)), repeated(tile, (70, 131))
    made = synthesize(FftmPixel(neighborhood, match=match, search=search), sample, (70, 131), mask_of(tile))
    error = float(((made.image - due) ** 2).mean())
    assert error < 10**-3.5
    if match == "full":
        np.testing.assert_array_equal(quantize(made.image), due)


@settings(max_examples=60)
@given(
    st.tuples(st.integers(1, 40), st.integers(1, 40)),
    st.integers(2, 6),
    st.sampled_from([1, 3]),
    st.sampled_from(MATCHES),
    st.sampled_from(SEARCHES),
    st.sampled_from([0.0, 1.0, 2.5]),
    st.sampled_from([0, 3, 16]),
    st.tuples(st.integers(6, 30), st.integers(6, 30)),
)
def test_every_pixel_is_the_samples_and_the_map_says_which(
    shape: tuple[int, int],
    neighborhood: int,
    channels: int,
    match: Any,
    search: Any,
    coherence: float,
    dimensions: int,
    size: tuple[int, int],
) -> None:
    """For all parameters and shapes, pixels are copies, the source map is right, and the mask has the output's size."""
    sample = noise(*size, channels)
    method = FftmPixel(neighborhood, match=match, search=search, coherence=coherence, dimensions=dimensions)
    made = checked_synthesis(synthesize(method, sample, shape, mask_of(soft_tile(7, 9, channels))), sample, shape)
    assert made.source is not None
    x, y, weight = np.moveaxis(made.source, -1, 0)
    assert (weight == 1).all()
    np.testing.assert_array_equal(made.image, sample[y.astype(int), x.astype(int)])
    assert is_picture(made.extras["mask"])
    assert made.extras["mask"].shape == (*shape, channels)


@pytest.mark.parametrize("match", MATCHES)
@pytest.mark.parametrize("coherence", [0.0, 2.0])
@pytest.mark.parametrize("dimensions", [0, 5])
def test_the_tree_finds_what_exhaustive_search_finds(match: Any, coherence: float, dimensions: int) -> None:
    """Both searches give the same bytes, on noise and on a texture with many ties."""
    tile = soft_tile(7, 9)
    for sample in (noise(40, 44), repeated(tile, (40, 44)), repeated(tile, (40, 44), 0.05)):
        ann, all_of_them = (
            synthesize(
                FftmPixel(match=match, search=search, coherence=coherence, dimensions=dimensions),
                sample,
                (50, 41),
                mask_of(tile),
            )
            for search in ("ann", "exhaustive")
        )
        np.testing.assert_array_equal(ann.source, all_of_them.source)


def test_coherence_lengthens_runs_and_exhaustive_search_does_not() -> None:
    """The mean length of copied runs grows with the coherence factor; exhaustive search alone gives short runs."""
    tile = soft_tile(11, 13)
    sample = repeated(tile, (64, 64), 0.08)
    runs = {
        (search, factor): mean_run(
            synthesize(FftmPixel(search=search, coherence=factor), sample, (80, 80), mask_of(tile)), sample
        )
        for search, factor in (("exhaustive", 0.0), ("ann", 0.0), ("ann", 1.5), ("ann", 2.0), ("ann", 4.0))
    }  # type: dict[tuple[Any, float], float]
    none, once, twice, far = (runs["ann", factor] for factor in (0.0, 1.5, 2.0, 4.0))
    assert runs["exhaustive", 0.0] == none
    assert none < once < twice < far
    assert far > 3 * none


def test_the_output_looks_like_the_mask_the_more_it_counts() -> None:
    """The correlation of output and mask grows with the weight: it is 0 at weight 0, and changes little above 5."""
    tile = soft_tile(11, 13)
    sample, shape = repeated(tile, (64, 64), 0.15), (96, 96)
    like = {}
    for weight in (0.0, 0.01, 1.0, 5.0, 100.0):
        made = synthesize(FftmPixel(weight=weight, coherence=0.0), sample, shape, mask_of(tile))
        like[weight] = float(np.corrcoef(made.image.ravel(), made.extras["mask"].ravel())[0, 1])
    assert abs(like[0.0]) < 0.2
    assert like[0.0] + 0.1 < like[0.01] + 0.1 < like[1.0] < like[5.0]
    assert abs(like[100.0] - like[5.0]) < 0.1


def test_every_parameter_changes_something() -> None:
    """Each parameter changes the output."""
    tile = soft_tile(11, 13)
    sample = repeated(tile, (64, 64), 0.1)

    def output(**change: Any) -> NDArray[np.float32]:
        return synthesize(FftmPixel(**change), sample, (66, 78), mask_of(tile)).image

    clustered, coherent = {"match": "cluster"}, {"search": "k-coherence", "coherence": 0.0}
    pairs: list[tuple[dict[str, Any], dict[str, Any]]] = [
        ({}, {"neighborhood": 4}), ({}, {"weight": 3.0}), ({}, clustered), ({}, coherent), ({}, {"coherence": 0.0}),
        ({}, {"dimensions": 4}), ({}, {"tileable": True}),
    ]  # fmt: skip
    for one, other in pairs:
        assert (output(**one) != output(**other)).any(), other


@pytest.mark.parametrize("tileable", [False, True])
def test_progress_rises_to_one(tileable: bool) -> None:
    """Progress is reported band by band."""
    reports: list[float] = []
    task = Task(noise(30, 30), (66, 63), None, np.random.default_rng(0), progress=reports.append)
    FftmPixel(tileable=tileable).synthesize_with_mask(task, mask_of(soft_tile(11, 9)))
    assert reports == sorted(reports)
    assert reports[-1] == 1
    assert len(reports) > 8


def test_a_sample_smaller_than_the_window_is_refused() -> None:
    """The message names the sizes of neighborhood and sample; one complete neighborhood is enough."""
    mask = mask_of(soft_tile(7, 9))
    with pytest.raises(Refused, match="6x6 px, the sample is 30x5 px"):
        synthesize(FftmPixel(6), noise(5, 30), (20, 20), mask)
    for match, search in itertools.product(MATCHES, SEARCHES):
        made = synthesize(FftmPixel(6, match=match, search=search), noise(6, 6), (9, 9), mask)  # type: ignore[arg-type]
        assert (made.image == noise(6, 6)[3, 3]).all()


def test_a_flat_sample_gives_a_flat_output() -> None:
    """If all neighborhoods are equal, the search ends and the output is flat."""
    flat = np.full((64, 64, 1), 0.4, np.float32)
    for match, search in itertools.product(MATCHES, SEARCHES):
        made = synthesize(FftmPixel(match=match, search=search), flat, (70, 70), mask_of(soft_tile(7, 9, 1)))  # type: ignore[arg-type]
        np.testing.assert_allclose(made.image, 0.4, atol=0.002)


def test_it_makes_its_own_mask() -> None:
    """Without a given lattice or mask, the output continues the sample in phase, and the lattice is reported."""
    y, x = 2 * np.pi * np.indices((11, 13)) / np.array([11, 13])[:, np.newaxis, np.newaxis]
    wave = np.cos(x) + np.sin(y) + np.cos(x + y) + np.sin(x - y) + np.cos(2 * x) + np.sin(2 * y + x)
    tile = quantize((0.5 + 0.08 * wave)[..., np.newaxis].astype(np.float32))
    sample = repeated(tile, (66, 65), 0.02)
    made = FftmPixel().synthesize(Task(sample, (90, 100), None, np.random.default_rng(0)))
    due = repeated(tile, (90, 100))
    assert np.corrcoef(made.image.ravel(), due.ravel())[0, 1] > 0.95
    assert made.lattice is not None
    assert made.lattice.area == pytest.approx(143, rel=0.02)
    assert made.detection_seconds > 0


@pytest.mark.parametrize(
    "parameters",
    [
        {"neighborhood": 1}, {"neighborhood": 7}, {"weight": -1.0}, {"weight": math.nan}, {"weight": 101.0},
        {"coherence": 0.5}, {"coherence": math.inf}, {"coherence": math.nan}, {"dimensions": -1},
        {"weight": 2.0, "match": "cluster"},
        {"tileable": True, "harmonics": "free"}, {"threshold": -1.0},
    ],
)  # fmt: skip
def test_parameters_that_make_no_sense_are_refused(parameters: dict[str, Any]) -> None:
    """The message names a parameter that is out of range or has no effect, and valid values."""
    with pytest.raises(BadInput, match="choose"):
        FftmPixel(**parameters)


@pytest.mark.parametrize("method", [AnnPixel, FftmPatch, FftmPixel])
def test_all_fields_are_documented(method: type[Any]) -> None:
    """The page describes each parameter under one heading, inherited ones last, in the order of the defaults."""
    page = inspect.getdoc(method) or ""
    assert page.count("\nParameters\n") == 1
    places = [page.index(f"\n{field.name}\n") for field in fields_by_call(method)]
    assert places == sorted(places)


def seam_ratio(image: Image) -> float:
    """Return the mean step between opposite borders of the output, relative to the mean step inside."""
    across = np.abs(image[:, 0] - image[:, -1]).mean() + np.abs(image[0] - image[-1]).mean()
    inside = np.abs(np.diff(image, axis=1)).mean() + np.abs(np.diff(image, axis=0)).mean()
    return float(across / inside)


@pytest.mark.parametrize("neighborhood", [2, 3, 6])
def test_a_tileable_output_meets_itself_without_a_seam(neighborhood: int) -> None:
    """Smooth blobs continue across the borders of a tileable output; in other outputs they are cut off."""
    rng = np.random.default_rng(2)
    tile = soft_tile(15, 15, 1)
    rough = rng.standard_normal((90, 90))
    waves = np.exp(-0.5 * (np.hypot(*np.meshgrid(np.fft.fftfreq(90), np.fft.fftfreq(90))) / 0.06) ** 2)
    blobs = np.fft.ifft2(np.fft.fft2(rough) * waves).real
    sample = quantize(repeated(tile, (90, 90)) * 0.5 + (0.25 + 0.1 * blobs / blobs.std())[..., np.newaxis])
    mask = mask_of(quantize(tile * 0.5 + 0.25))
    ratios = {
        tileable: np.mean(
            [
                seam_ratio(synthesize(FftmPixel(neighborhood, tileable=tileable), sample, (60, 75), mask, k).image)
                for k in range(4)
            ]
        )
        for tileable in (False, True)
    }
    assert ratios[True] < 1.35
    assert ratios[True] < 0.8 * ratios[False]


def test_a_tileable_output_of_a_perfect_texture_is_its_continuation() -> None:
    """The second pass does not change an output that is periodic already, even of a single tile."""
    tile = noise(13, 15)
    for shape in ((13, 15), (39, 60)):
        made = synthesize(FftmPixel(tileable=True), repeated(tile, (60, 62)), shape, mask_of(tile))
        np.testing.assert_array_equal(quantize(made.image), repeated(tile, shape))


def test_a_size_that_is_no_period_is_refused_with_the_nearest_ones_that_work() -> None:
    """The message names the nearest valid size; with it the output tiles, even if the period is fractional."""
    tile, sample = soft_tile(11, 13), repeated(soft_tile(11, 13), (64, 64), 0.05)
    mask = mask_of(tile, 1.03)
    with pytest.raises(Refused, match="nearest valid size: 68x67"):
        synthesize(FftmPixel(tileable=True), sample, (64, 73), mask)
    made = synthesize(FftmPixel(tileable=True), sample, (67, 68), mask)
    assert seam_ratio(made.extras["mask"]) < 1.1
    assert seam_ratio(mask.draw((64, 73))) > 1.5


def test_stripes_tile_along_themselves_at_any_length() -> None:
    """A mask of one fundamental has a period across its stripes alone."""
    harmonics = WaveAnalysis(
        np.array([[0.1, 0.0]]), np.array([[0.2]]), np.array([[0.0]]), np.array([0.5]),
        np.array([[0.1, 0.0]]), np.array([[1]]), (1,), 1.0,
    )  # fmt: skip
    sample, mask = noise(30, 30, 1), TextureMask(harmonics)
    assert synthesize(FftmPixel(tileable=True), sample, (17, 40), mask).image.shape == (17, 40, 1)
    with pytest.raises(Refused, match="nearest valid size: 40x17"):
        synthesize(FftmPixel(tileable=True), sample, (17, 43), mask)
