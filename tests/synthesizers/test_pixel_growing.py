"""Claims about methods that grow pixel by pixel: their search for neighborhoods, ann-pixel and fftm-pixel."""

import itertools
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from synthesis_cases import mask_of, noise, synthesize

from nrbench.calling.method_calls import checked_synthesis, is_picture
from nrbench.imaging.convert import Image, quantize
from nrbench.metrics.source import SourceUse
from nrbench.plugins.forms import Observation, Refused, Synthesis, Task
from nrbench.spectra.harmonics import WaveAnalysis
from nrbench.synthesizers.ann_pixel import AnnPixel
from nrbench.synthesizers.fftm_pixel import FftmPixel
from nrbench.synthesizers.masks.texture_mask import TextureMask
from nrbench.synthesizers.pixel_growing.neighbor_search import KdTree, Projection
from nrbench.synthesizers.pixel_growing.pixel_growth import Candidates, Neighborhood, NeighborhoodIndex


@pytest.mark.parametrize("search", ["ann", "exhaustive", "k-coherence"])
@pytest.mark.parametrize("neighborhood", [7, 10])
@pytest.mark.parametrize("channels", [1, 3])
def test_a_texture_that_the_window_spans_is_continued(search: Any, neighborhood: int, channels: int) -> None:
    """Below its random start the output repeats like the sample, except where pieces of different phase meet."""
    sample = np.tile(noise(5, 6, channels), (9, 8, 1))
    made = synthesize(AnnPixel(neighborhood, search=search), sample, (60, 70))
    lower = made.image[20:, 12:-12]
    assert (lower[5:] == lower[:-5]).all(-1).mean() > 0.9
    assert (lower[:, 6:] == lower[:, :-6]).all(-1).mean() > 0.5
    assert len(np.unique(lower.reshape(-1, channels), axis=0)) > 20


def test_a_texture_that_the_window_does_not_span_is_lost() -> None:
    """If stripes are farther apart than the window, the method does not continue their period."""
    stripes = np.zeros((64, 64, 1), np.float32)
    stripes[::16, :, 0] = 1
    made = synthesize(AnnPixel(3), stripes, (128, 64))
    rows = np.flatnonzero(made.image[20:, :, 0].mean(1) > 0.5)
    assert len(rows) == 0 or (np.diff(rows) != 16).any()


SEARCHES = ("ann", "exhaustive", "k-coherence")
MATCHES = ("full", "cluster")


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


def masked(
    sample: Image, shape: tuple[int, int], mask: TextureMask | Image, seed: int = 1, **parameters: Any
) -> Synthesis:
    """Run the method with a known mask, or that of a tile."""
    task = Task(sample, shape, None, np.random.default_rng(seed))
    return FftmPixel(**parameters).synthesize_with_mask(task, mask if isinstance(mask, TextureMask) else mask_of(mask))


def mean_run(made: Synthesis, sample: Image) -> float:
    """Return the mean unbroken run of the source map, px."""
    return SourceUse().score(Observation(sample, made.image, source=made.source)).values["mean_copy_length"]


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
    made = masked(sample, (70, 131), tile, neighborhood=neighborhood, match=match, search=search)
    assert ((made.image - due) ** 2).mean() < 10**-3.5
    if match == "full":
        np.testing.assert_array_equal(quantize(made.image), due)


@settings(max_examples=60)
@given(
    st.tuples(st.integers(1, 40), st.integers(1, 40)),
    st.sampled_from([1, 3]),
    st.tuples(st.integers(6, 30), st.integers(6, 30)),
    st.fixed_dictionaries({
        "neighborhood": st.integers(2, 6), "match": st.sampled_from(MATCHES), "search": st.sampled_from(SEARCHES),
        "coherence": st.sampled_from([0.0, 1.0, 2.5]), "dimensions": st.sampled_from([0, 3, 16]),
    }),
)  # fmt: skip
def test_every_pixel_is_the_samples_and_the_map_says_which_beside_a_mask(
    shape: tuple[int, int], channels: int, size: tuple[int, int], parameters: dict[str, Any]
) -> None:
    """For all parameters and shapes, pixels are copies, the source map is right, and the mask has the output's size."""
    sample = noise(*size, channels)
    made = checked_synthesis(masked(sample, shape, soft_tile(7, 9, channels), **parameters), sample, shape)
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
        more = {"match": match, "coherence": coherence, "dimensions": dimensions}
        ann, all_of_them = (masked(sample, (50, 41), tile, search=each, **more) for each in ("ann", "exhaustive"))
        np.testing.assert_array_equal(ann.source, all_of_them.source)


def test_coherence_lengthens_runs_and_exhaustive_search_does_not() -> None:
    """The mean length of copied runs grows with the coherence factor; exhaustive search alone gives short runs."""
    tile = soft_tile(11, 13)
    sample = repeated(tile, (64, 64), 0.08)
    kinds = (("exhaustive", 0.0), ("ann", 0.0), ("ann", 1.5), ("ann", 2.0), ("ann", 4.0))
    outputs = (masked(sample, (80, 80), tile, search=search, coherence=factor) for search, factor in kinds)
    all_of_them, none, once, twice, far = (mean_run(made, sample) for made in outputs)
    assert all_of_them == none < once < twice < far and far > 3 * none


def test_the_output_looks_like_the_mask_the_more_it_counts() -> None:
    """The correlation of output and mask grows with the weight: it is 0 at weight 0, and changes little above 5."""
    tile = soft_tile(11, 13)
    sample, shape = repeated(tile, (64, 64), 0.15), (96, 96)
    like = {}
    for weight in (0.0, 0.01, 1.0, 5.0, 100.0):
        made = masked(sample, shape, tile, weight=weight, coherence=0.0)
        like[weight] = float(np.corrcoef(made.image.ravel(), made.extras["mask"].ravel())[0, 1])
    assert abs(like[0.0]) < 0.2
    assert like[0.0] + 0.1 < like[0.01] + 0.1 < like[1.0] < like[5.0]
    assert abs(like[100.0] - like[5.0]) < 0.1


def test_a_flat_sample_gives_a_flat_output() -> None:
    """If all neighborhoods are equal, the search ends and the output is flat."""
    flat = np.full((64, 64, 1), 0.4, np.float32)
    for match, search in itertools.product(MATCHES, SEARCHES):
        made = masked(flat, (70, 70), soft_tile(7, 9, 1), match=match, search=search)
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
    assert made.lattice.area == pytest.approx(143, rel=0.02)
    assert made.detection_seconds > 0


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
    task = sample, (60, 75), mask_of(quantize(tile * 0.5 + 0.25))

    def ratio(tileable: bool) -> float:
        more = {"neighborhood": neighborhood, "weight": 1.0, "tileable": tileable}
        return float(np.mean([seam_ratio(masked(*task, k, **more).image) for k in range(4)]))

    assert ratio(True) < min(1.35, 0.8 * ratio(False))


def test_a_tileable_output_of_a_perfect_texture_is_its_continuation() -> None:
    """The second pass does not change an output that is periodic already, even of a single tile."""
    tile = noise(13, 15)
    for shape in ((13, 15), (39, 60)):
        made = masked(repeated(tile, (60, 62)), shape, tile, tileable=True)
        np.testing.assert_array_equal(quantize(made.image), repeated(tile, shape))


def test_a_size_that_is_no_period_is_refused_with_the_nearest_ones_that_work() -> None:
    """The message names the nearest valid size; with it the output tiles, even if the period is fractional."""
    tile, sample = soft_tile(11, 13), repeated(soft_tile(11, 13), (64, 64), 0.05)
    mask = mask_of(tile, 1.03)
    with pytest.raises(Refused, match="nearest valid size: 68x67"):
        masked(sample, (64, 73), mask, tileable=True)
    made = masked(sample, (67, 68), mask, tileable=True)
    assert seam_ratio(made.extras["mask"]) < 1.1
    assert seam_ratio(mask.draw((64, 73))) > 1.5


def test_stripes_tile_along_themselves_at_any_length() -> None:
    """A mask of one fundamental has a period across its stripes alone."""
    harmonics = WaveAnalysis(
        np.array([[0.1, 0.0]]), np.array([[0.2]]), np.array([[0.0]]), np.array([0.5]),
        np.array([[0.1, 0.0]]), np.array([[1]]), (1,), 1.0,
    )  # fmt: skip
    sample, mask = noise(30, 30, 1), TextureMask(harmonics)
    assert masked(sample, (17, 40), mask, tileable=True).image.shape == (17, 40, 1)
    with pytest.raises(Refused, match="nearest valid size: 40x17"):
        masked(sample, (17, 43), mask, tileable=True)


def draw_points(count: int, axes: int, spread: int, seed: int) -> NDArray[np.int16]:
    """Return points whose coordinates take few values where the spread is small: many ties."""
    return np.random.default_rng(seed).integers(-spread, spread + 1, (count, axes)).astype(np.int16)


def distances(points: NDArray[np.int16], queries: NDArray[np.int16]) -> NDArray[np.int64]:
    """Return all squared distances, (q, n)."""
    apart = queries[:, np.newaxis].astype(np.int64) - points
    return np.asarray((apart**2).sum(-1))


SETS = st.tuples(
    st.integers(1, 120), st.integers(1, 20), st.sampled_from([0, 1, 3, 50, 5000]), st.integers(0, 999)
).map(lambda drawn: (draw_points(*drawn), draw_points(20, *drawn[1:3], drawn[3] + 1)))
"""Points and queries."""
Sets = tuple[NDArray[np.int16], NDArray[np.int16]]


@settings(max_examples=150)
@given(SETS, st.integers(1, 5), st.integers(1, 9), st.integers(1, 4))
def test_the_nearest_are_those_of_brute_force(drawn: Sets, k: int, leaf: int, number: int) -> None:
    """With eps 0 the k nearest of a group are found, ties by rank, whatever the leaves; -1 where there are fewer."""
    (points, queries), rng = drawn, np.random.default_rng(k)
    ranks, groups = rng.permutation(len(points)), np.sort(np.arange(len(points)) % number)
    among = rng.integers(groups.max() + 1, size=20)
    numbers, apart = KdTree.build(points, ranks, groups, leaf).nearest(queries, k, groups=among)
    for query, row in enumerate(distances(points, queries)):
        mine = np.flatnonzero(groups == among[query])
        due = mine[np.lexsort([ranks[mine], row[mine]])][:k]
        np.testing.assert_array_equal(numbers[query, : len(due)], due)
        np.testing.assert_array_equal(apart[query, : len(due)], row[due])
        assert (numbers[query, len(due) :] == -1).all()


@settings(max_examples=60)
@given(SETS, st.integers(1, 9), st.integers(0, 20))
def test_the_nearest_by_two_norms_are_those_of_brute_force(drawn: Sets, leaf: int, leading: int) -> None:
    """With two norms the point of the least sum is found, whatever the leaves."""
    points, queries = drawn
    leading = min(leading, points.shape[1])
    numbers, _ = KdTree.build(points, leaf=leaf, leading=leading).nearest(queries)
    parts = [distances(points[:, part], queries[:, part]) for part in (slice(leading), slice(leading, None))]
    sums = sum(np.sqrt(part) for part in parts)
    found = np.take_along_axis(np.asarray(sums), numbers, 1)[:, 0]
    np.testing.assert_allclose(found**2, sums.min(1) ** 2, atol=1)


def test_the_papers_norms_choose_another_source() -> None:
    """A difference of 3 in the texture is less than one of 2 in texture and mask by norms, and more by squares."""
    mask, texture = np.full((3, 32, 1), 100, np.uint8), np.full((3, 32, 1), 100, np.uint8)
    texture[:, :16], texture[:, 16:], mask[:, 16:] = 103, 102, 102
    neighborhood = Neighborhood(np.array([(-1, 0, 0), (0, 0, 1)]))
    layers, query = np.stack([texture, mask]), np.full((1, 2), 100, np.uint8)
    pixels = np.array([8, 24])
    for norms, due in ((True, 0), (False, 1)):
        candidates = Candidates(pixels, np.arange(2))
        index = NeighborhoodIndex(layers, candidates, neighborhood, AnnPixel(dimensions=0), 1.0, norms)
        numbers, _ = index.tree.nearest(index._projection.points(query))
        assert numbers.tolist() == [[due]]
    assert FftmPixel(**FftmPixel.presets["paper"]).distance == "norms"


@settings(max_examples=100)
@given(SETS, st.sampled_from([0.1, 0.5, 1.0, 3.0]))
def test_with_eps_none_is_farther_than_it_may_be(drawn: Sets, eps: float) -> None:
    """What is found is at most (1 + eps) times as far as the nearest."""
    points, queries = drawn
    _, apart = KdTree.build(points, leaf=2).nearest(queries, eps=eps)
    assert (apart[:, 0] <= distances(points, queries).min(1) * (1 + eps) ** 2).all()


@pytest.mark.parametrize("coordinate", [-16000, 0, 16000])
def test_points_that_are_all_alike_are_one_leaf_and_the_first_rank_wins(coordinate: int) -> None:
    """Ten thousand copies of a point neither stop the build nor hide which is preferred."""
    points = np.full((10_000, 3), coordinate, np.int16)
    ranks = np.random.default_rng(0).permutation(10_000)
    numbers, apart = KdTree.build(points, ranks).nearest(points[:5], 2)
    np.testing.assert_array_equal(numbers, [np.argsort(ranks)[:2]] * 5)
    assert (apart == 0).all()


def test_the_farthest_points_do_not_overflow() -> None:
    """Distances up to 2^31 - 1, the largest number of 32 bits, are right."""
    points = np.array([[-16000, 0, 0, 0], [16000, 0, 0, 0]], np.int16)
    numbers, apart = KdTree.build(points).nearest(np.array([[16000, 32000, 0, 0]], np.int16), 2)
    assert numbers.tolist() == [[1, 0]]
    assert apart.tolist() == [[32000**2, 2 * 32000**2]]


def draw_vectors(count: int, width: int, seed: int) -> NDArray[np.uint8]:
    """Return vectors of few dimensions in truth, with some noise."""
    rng = np.random.default_rng(seed)
    mixed = rng.random((count, 3)) @ rng.random((3, width)) * 60 + rng.normal(60, 4, (count, width))
    return np.clip(mixed, 0, 255).astype(np.uint8)


def distances_in_gray_levels(points: NDArray[Any], units: float = 1, weights: Any = 1.0) -> NDArray[np.float64]:
    """Return all distances in gray levels."""
    difference = points[:, np.newaxis].astype(np.float64) - points
    return np.asarray(np.sqrt((difference**2 * weights).sum(-1)) / units)


@settings(max_examples=40)
@given(st.integers(1, 40), st.integers(1, 60), st.sampled_from([0, 999]), st.floats(0, 6), st.integers(0, 99))
def test_all_values_keep_weighted_distances(count: int, width: int, dimensions: int, weight: float, seed: int) -> None:
    """Without components, distances are those of the weighted values, up to the rounding of each coordinate."""
    vectors = draw_vectors(count, width, seed)
    weights = np.where(np.arange(width) % 2, weight, 1.0)
    projection = Projection.fit(vectors, weights, dimensions)
    found, due = distances_in_gray_levels(projection.points(vectors), projection.units), (vectors, 1, weights)
    np.testing.assert_allclose(found, distances_in_gray_levels(*due), atol=1.5 * np.sqrt(width) / projection.units)


def test_components_keep_what_varies() -> None:
    """Of vectors of three dimensions and noise, four components keep distances to the noise."""
    vectors = draw_vectors(200, 50, 0)
    projection = Projection.fit(vectors, np.ones(50), 4)
    assert not projection.matrix[4:].any()
    found, due = (
        distances_in_gray_levels(projection.points(vectors), projection.units),
        distances_in_gray_levels(vectors),
    )
    assert (found <= due + 1).all()
    far = due > 150
    assert far.any()
    np.testing.assert_allclose(found[far], due[far], rtol=0.1)


@pytest.mark.parametrize("weight", [0.0, 1.0, 100.0])
@pytest.mark.parametrize("dimensions", [0, 1, 16])
def test_extremes_fit_sixteen_bits(weight: float, dimensions: int) -> None:
    """Black and white neighborhoods of 300 values differ by less than 32 767 units, however the mask counts."""
    vectors = np.zeros((10, 108), np.uint8)
    vectors[5:] = 255
    vectors[3, ::2] = 255
    weights = np.where(np.arange(108) % 2, weight, 1.0)
    projection = Projection.fit(vectors, weights, dimensions)
    matrix = projection.matrix[:, :108].T.astype(np.int64)
    exact = vectors.astype(np.int64) @ matrix + projection.shift >> projection.bits
    np.testing.assert_array_equal(projection.points(vectors), exact)
    assert np.sqrt(((exact[:, np.newaxis] - exact) ** 2).sum(-1)).max() < 32767
