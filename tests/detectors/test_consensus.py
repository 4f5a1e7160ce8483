"""The consensus detector finds the smallest lattice whose tiles best predict one another."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from nrbench import texture
from nrbench.detectors.agreement.evidence import Evidence
from nrbench.detectors.agreement.likeness import compute_likeness, views
from nrbench.detectors.agreement.search import propose_lattices
from nrbench.detectors.agreement.short_list import (
    Rival,
    Traits,
    classify,
    describe_choice,
    reclassify,
    relate_bases,
    share_certainty,
)
from nrbench.detectors.consensus import Consensus
from nrbench.detectors.frdft import Frdft
from nrbench.errors import BadInput
from nrbench.imaging.convert import Image, quantize, shrink
from nrbench.lattice.geometry import Lattice, Points
from nrbench.lattice.relation import lattice_error, relate
from nrbench.plugins.forms import Detection, NoLatticeFound, Probabilities


def is_exact(detection: Detection, truth: Lattice | None, image: Image, tolerance: float = 1.0) -> bool:
    """Return whether a detection is the true lattice."""
    assert truth is not None
    return lattice_error(detection.lattice, truth, image.shape[:2], tolerance).relation == "exact"


@pytest.mark.parametrize("model", ["brick", "weave", "hexagon", "squares", "scales", "basket", "plate", "pavement"])
@pytest.mark.parametrize("departures", [{}, {"color": 0.4, "noise": 0.05}], ids=["regular", "varied"])
def test_models_are_exact(model: str, departures: dict[str, Any]) -> None:
    """The lattice is exact to a quarter of a pixel for each family, regular or varied."""
    drawn = texture(model, (128, 144), 3, **departures)
    assert is_exact(Consensus().detect(quantize(drawn.image)), drawn.lattice, drawn.image, 0.25)


@pytest.mark.parametrize("seed", range(4))
def test_threads_that_match_by_chance_make_no_supercell(seed: int) -> None:
    """Strongly colored threads, which run across the image, do not lead to a coarser lattice."""
    drawn = texture("weave", (160, 160), seed, color=0.6, noise=0.05, rotation=31.7)
    assert is_exact(Consensus().detect(quantize(drawn.image)), drawn.lattice, drawn.image)


def test_joints_make_no_subcell() -> None:
    """Displaced bricks, whose long joints stay in line, do not lead to a finer lattice along the joints."""
    drawn = texture("brick", (160, 160), 2, color=0.3, jitter=0.3)
    assert is_exact(Consensus().detect(quantize(drawn.image)), drawn.lattice, drawn.image)


def test_tiles_that_alternate_are_kept_apart() -> None:
    """If every second tile differs, the cell holds both kinds; if all are equal, it holds one."""
    y, x = np.indices((144, 144)) // 16
    rng = np.random.default_rng(0)
    motif = ndimage.gaussian_filter(rng.normal(size=(16, 16)), 1.5, mode="wrap")
    other = ndimage.gaussian_filter(rng.normal(size=(16, 16)), 1.5, mode="wrap")
    first, second = (np.tile(0.5 + part, (9, 9)) for part in (motif, motif + 0.6 * other))
    mixed = np.where((x + y) % 2, first, second)[..., np.newaxis].astype(np.float32)
    detection = Consensus().detect(np.clip(mixed, 0, 1))
    assert detection.lattice.is_equivalent(Lattice((16, 16), (16, -16)), 0.1)
    plain = Consensus().detect(np.clip(first[..., np.newaxis].astype(np.float32), 0, 1))
    assert plain.lattice.is_equivalent(Lattice((16, 0), (0, 16)), 0.1)


@pytest.mark.parametrize("spectrum", ["white", "pink", "brown", "blobs", "grass"])
@pytest.mark.parametrize("seed", range(3))
def test_stochastic_textures_have_none(spectrum: str, seed: int) -> None:
    """No lattice is found in noise of any spectrum."""
    drawn = texture("noise", (96, 96), seed, spectrum=spectrum)
    with pytest.raises(NoLatticeFound):
        Consensus().detect(quantize(drawn.image))


def test_the_exception_carries_the_rejected_lattice() -> None:
    """The exception carries the best lattice and the reason; without rejection this lattice is returned."""
    drawn = quantize(texture("noise", (96, 96), 4, spectrum="grass").image)
    answer = Consensus(reject="none").detect(drawn)
    with pytest.raises(NoLatticeFound, match=r"chance|explains only") as refusal:
        Consensus().detect(drawn)
    assert refusal.value.best is not None
    assert refusal.value.best.lattice == answer.lattice


def test_surrogates_separate_lattices_from_chance() -> None:
    """Compared with phase-randomized copies, bricks have a lattice and noise has none."""
    bricks = quantize(texture("brick", (96, 96), 1, color=0.2, rotation=17.3).image)
    detection = Consensus(reject="surrogate").detect(bricks)
    assert detection.diagnostics["tested"] > detection.diagnostics["limit"] > 0
    noise = quantize(texture("noise", (96, 96), 6, spectrum="grass").image)
    with pytest.raises(NoLatticeFound):
        Consensus(reject="surrogate").detect(noise)


@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_a_grating_has_none(angle: float) -> None:
    """Stripes repeat by any vector along them: no two-dimensional lattice."""
    y, x = np.indices((96, 96))
    stripes = 0.5 + 0.3 * np.sin(2 * np.pi * (x * np.cos(angle) + y * np.sin(angle)) / 11.3)
    noise = np.random.default_rng(0).normal(0, 0.05, stripes.shape)
    with pytest.raises(NoLatticeFound):
        Consensus().detect(np.clip(stripes + noise, 0, 1)[..., np.newaxis].astype(np.float32))


@pytest.mark.parametrize("period", [2.8, 3.1, 4.01, 5.3, 7.7, 12.4])
@pytest.mark.parametrize("seed", range(2))
def test_fine_gratings_have_none(period: float, seed: int) -> None:
    """Stripes of a few pixels at any angle, whose edges beat with the pixel grid, have no lattice."""
    angle = np.random.default_rng(seed).uniform(0.1, 1.4)
    y, x = np.indices((80, 80))
    stripes = 0.5 + 0.4 * np.sin(2 * np.pi * (x * np.cos(angle) + y * np.sin(angle)) / period)
    with pytest.raises(NoLatticeFound):
        Consensus().detect(quantize(stripes[..., np.newaxis].astype(np.float32)))


@pytest.mark.parametrize("shape", [(8, 8), (8, 200), (200, 9), (33, 16)])
def test_tiny_and_thin_images_behave(shape: tuple[int, int]) -> None:
    """An image too small for a lattice has none, or a lattice of at least three tiles; never another exception."""
    image = np.random.default_rng(1).random((*shape, 3)).astype(np.float32)
    try:
        detection = Consensus(reject="none").detect(image)
    except NoLatticeFound:
        return
    assert detection.diagnostics["tiles"] > 2


def test_a_constant_image_has_none() -> None:
    """A constant image has no texture, and the reason says so."""
    with pytest.raises(NoLatticeFound, match="constant"):
        Consensus().detect(np.full((64, 64, 3), 0.4, np.float32))


@pytest.mark.parametrize("cell", [(2, 4), (4, 2), (2, 5), (1, 7)])
def test_periods_too_short_to_be_sampled_have_none(cell: tuple[int, int]) -> None:
    """A texture that repeats by less than three pixels has no lattice; this is an answer and no error."""
    values = np.random.default_rng(0).random(cell, np.float32)
    image = np.tile(values, (64 // cell[0] + 1, 64 // cell[1] + 1))[:64, :64, np.newaxis]
    with pytest.raises(NoLatticeFound):
        Consensus().detect(image)


def test_few_neighbors_of_faint_lattices_are_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the finer lattices of a faint lattice most are too bad to be fitted, so that noise takes little time."""
    image = np.random.default_rng(3).random((160, 160, 1), np.float32)
    evidence = Evidence(compute_likeness(image).pooled)
    lattices = [np.array(((30.0 + n, 3.0), (-2.0, 34.0 + n))) for n in range(10)]
    faint = [basis for basis in lattices if 0.001 < evidence.repeated(basis) < 0.03]
    fits, fit = [], Evidence.fit

    def count(self: Evidence, basis: Points) -> Points:
        fits.append(basis)
        return fit(self, basis)

    monkeypatch.setattr(Evidence, "fit", count)
    search = Consensus().make_search(evidence)
    for basis in faint:
        search.find_finest(basis)
    assert faint and len(fits) < 30 * len(faint)


def test_large_images_have_exact_lattices() -> None:
    """Small and large periods of an image over 640 px a side are found as precisely as in a small one."""
    for period, shape in ((9.37, (650, 650)), (150.6, (650, 900))):
        y, x = np.indices(shape)
        image = 0.5 + 0.2 * np.cos(2 * np.pi * x / period) * np.cos(2 * np.pi * y / (0.8 * period))
        image = image + 0.2 * np.cos(2 * np.pi * x / period)
        detection = Consensus().detect(image[..., np.newaxis].astype(np.float32))
        assert lattice_error(detection.lattice, Lattice((period, 0), (0, 0.8 * period)), shape).vector < 0.02


def test_detail_decides_over_views() -> None:
    """Sharp tiles that a small view blurs unevenly, tiles that differ in detail, and a thin strip are exact."""
    rng = np.random.default_rng(3)
    tile = rng.random((37, 53, 3), np.float32)
    sharp = np.tile(tile, (18, 13, 1))[:660, :680]
    assert Consensus().detect(sharp).lattice.is_equivalent(Lattice((53, 0), (0, 37)), 0.05)
    shared, first, second = rng.random((3, 24, 24, 1), np.float32)
    pair = [0.5 * shared + 0.5 * own for own in (first, second)]
    rows = [np.concatenate(pair, 1), np.concatenate(pair[::-1], 1)]
    mixed = np.tile(np.concatenate(rows), (14, 14, 1))
    assert Consensus().detect(mixed).lattice.is_equivalent(Lattice((24, 24), (24, -24)), 0.05)
    strip = np.tile(ndimage.gaussian_filter(rng.random((30, 450, 1)), (1, 1, 0), mode="wrap"), (4, 4, 1))
    detection = Consensus().detect(strip.astype(np.float32))
    assert detection.lattice.is_equivalent(Lattice((450, 0), (0, 30)), 0.05)


def test_views_cover_detail_and_whole() -> None:
    """The first view is the middle at full detail, the last the whole image; none exceeds 640 px a side."""
    image = np.random.default_rng(2).random((1400, 2600, 1)).astype(np.float32)
    parts = list(views(image))
    assert [part.factor for part in parts] == [1, 2, 4, 8]
    np.testing.assert_array_equal(parts[0].image, image[380:1020, 980:1620])
    assert parts[-1].image.shape == (175, 325, 1)
    assert max(max(part.image.shape) for part in parts) <= 640
    np.testing.assert_allclose(shrink(image, 2)[5, 7], image[10:12, 14:16].mean((0, 1)), rtol=1e-6)


def test_a_quarter_turn_turns_the_lattice() -> None:
    """A transposed image has the transposed lattice; a gray and a darker copy have the same lattice."""
    drawn = quantize(texture("hexagon", (128, 144), 5, color=0.3, rotation=12.0).image)
    lattice = Consensus().detect(drawn).lattice
    turned = Consensus().detect(np.ascontiguousarray(drawn.transpose(1, 0, 2))).lattice
    assert lattice.is_equivalent(Lattice(turned.t1[::-1], turned.t2[::-1]), 0.02)
    gray = drawn.mean(2, keepdims=True)
    assert lattice.is_equivalent(Consensus().detect(gray).lattice, 0.1)
    assert lattice.is_equivalent(Consensus().detect(0.2 + 0.5 * drawn).lattice, 0.05)


def test_the_same_image_has_the_same_lattice() -> None:
    """Equal pixels give equal bits."""
    drawn = quantize(texture("brick", (96, 96), 8, color=0.3).image)
    assert Consensus().detect(drawn).lattice == Consensus().detect(drawn.copy()).lattice


def test_confidence_separates_right_from_wrong() -> None:
    """The confidence of a regular wall is high, that of lattices in noise is low."""
    wall = quantize(texture("brick", (128, 128), 1, color=0.2).image)
    assert Consensus().detect(wall).confidence > 0.9
    noise = [quantize(texture("noise", (128, 128), seed, spectrum="grass").image) for seed in range(4)]
    found = [Consensus(reject="none").detect(image).confidence for image in noise]
    assert np.mean(found) < 0.2 and max(found) < 0.3


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"max_loss": 1.0}, "max_loss is 1.0; give a share"),
        ({"relief": -0.1}, "relief is -0.1; give a share"),
        ({"tile_allowance": -1}, "tile_allowance is -1; give 0 or more"),
        ({"peaks": 1}, "peaks is 1; give at least 2"),
        ({"reject": "maybe"}, "give none, bartlett or surrogate"),
        ({"false_alarms": 0}, "give a probability"),
    ],
)
def test_bad_parameters_are_refused(parameters: dict[str, Any], message: str) -> None:
    """Each parameter out of its range is refused, and the message says what to give."""
    with pytest.raises(BadInput, match=message):
        Consensus(**parameters)


def test_alternatives_are_ranked_and_related() -> None:
    """The alternatives come by confidence, differ from the lattice, and say how; confidences add up to at most 1."""
    drawn = texture("brick", (128, 128), 1, color=0.3, noise=0.05)
    found = Consensus().detect(quantize(drawn.image))
    assert found.probabilities is not None
    assert found.confidence == found.probabilities.exact
    assert sum(found.probabilities) == pytest.approx(1)
    confidences = [other.confidence for other in found.alternatives]
    assert confidences == sorted(confidences, reverse=True)
    assert found.confidence + sum(confidences) <= 1 + 1e-9
    assert len(found.alternatives) >= 3
    for other in found.alternatives:
        change = relate(other.lattice, found.lattice)
        assert other.relation == (change.name if change else "unrelated") != "the same"


def halves(difference: float, seed: int) -> Image:
    """Return tiles of 15 x 19 px that alternate along x between two motifs, ``(150, 150, 3)``."""
    rng = np.random.default_rng(seed)
    first, other = (ndimage.gaussian_filter(rng.normal(size=(19, 15, 3)), (1.5, 1.5, 0), mode="wrap") for _ in "ab")
    cell = np.concatenate([first, first + difference * other], 1)
    image = 0.5 + 0.7 * np.tile(cell, (8, 5, 1))[:150, :150] + rng.normal(0, 0.03, (150, 150, 1))
    return quantize(np.clip(image, 0, 1).astype(np.float32))


@pytest.mark.parametrize("difference", [0.25, 0.4, 0.6])
@pytest.mark.parametrize("seed", range(2))
def test_a_cell_of_similar_halves_is_among_the_first_three(difference: float, seed: int) -> None:
    """If the two halves of a cell are similar, the whole cell is among the first three lattices."""
    found = Consensus().detect(halves(difference, seed))
    listed = [found.lattice, *(other.lattice for other in found.alternatives[:2])]
    assert any(lattice.is_equivalent(Lattice((30, 0), (0, 19)), 0.2) for lattice in listed)


def test_a_faint_alternation_lowers_the_confidence() -> None:
    """The more two alternating elements differ, the less probable is the cell of one, until that of both is found."""
    one, both = Lattice((15, 0), (0, 19)), Lattice((30, 0), (0, 19))
    found = [Consensus().detect(halves(difference, 0)) for difference in (0.0, 0.2, 0.3, 0.4, 0.6)]
    assert all(detection.lattice.is_equivalent(one, 0.2) for detection in found[:3])
    assert all(detection.lattice.is_equivalent(both, 0.2) for detection in found[3:])
    same, faint, clear, *_ = (detection.confidence for detection in found)
    assert same > 0.9 and same > faint + 0.1 > clear + 0.2
    assert found[2].alternatives[0].lattice.is_equivalent(both, 0.2) and found[2].alternatives[0].confidence > 0.3
    assert found[4].confidence > 0.9


@pytest.mark.parametrize("difference", [0.2, 0.4])
@pytest.mark.parametrize("seed", range(2))
def test_elements_that_alternate_in_shape_have_no_roles(difference: float, seed: int) -> None:
    """Their slopes and edges repeat by the cell of both only, as their colors do: it is no lattice of colors."""
    found = Consensus().detect(halves(difference, seed))
    assert found.role == "" and all(other.role == "" for other in found.alternatives)


def test_traits_tell_alternating_elements_from_supercells() -> None:
    """The cell of both is distinct from that of one, whose elements alternate; a supercell of either is not."""
    _, rivals = Consensus().list_rivals(halves(0.3, 0))[0]
    cells = {relate_bases(rival.basis, np.diag([15.0, 19.0])): rival.traits for rival in rivals}
    assert cells[1].structure_alternation > 1 and cells[2].structure_alternation == 0 and cells[2].distinction > 1
    supercells = [traits.distinction for number, traits in cells.items() if number > 2]
    assert supercells and max(supercells) == 0


def test_similar_halves_are_no_stripes() -> None:
    """The correlation of the colors at half the cell is nearly as high as at the cell; at a third of it, it is low."""
    rng = np.random.default_rng(0)
    height, width = (int(n) for n in rng.integers(10, 28, 2))
    shape = (height, width, 3)
    first, other = (ndimage.gaussian_filter(rng.normal(size=shape), (1.5, 1.5, 0), mode="wrap") for _ in "ab")
    cell = 0.5 + np.concatenate([first, first + 0.45 * other], 1)
    image = np.tile(cell, (8, 5, 1)) + rng.normal(0, 0.03, (8 * height, 10 * width, 1))
    found = Consensus().detect(quantize(np.clip(image[:192, :192], 0, 1).astype(np.float32)))
    assert found.lattice.is_equivalent(Lattice((2 * width, 0), (0, height)), 0.2)


def under_grain(seed: int) -> tuple[Image, Lattice]:
    """Return squares of random colors, enlarged three times, under fine noise and specks, and their lattice."""
    drawn = texture("squares", (96, 96), seed, color=0.3)
    large = drawn.image.repeat(3, 0).repeat(3, 1)
    rng = np.random.default_rng(seed)
    specks = 0.35 * (rng.random((288, 288, 1)) < 0.07)
    grain = 0.25 * rng.standard_normal(large.shape).mean(2, keepdims=True)
    assert drawn.lattice is not None
    image = quantize(np.clip(large + grain - specks, 0, 1).astype(np.float32))
    return image, Lattice.from_basis(3 * drawn.lattice.matrix)


@pytest.mark.parametrize("seed", range(2))
def test_grain_does_not_hide_large_elements(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Their lattice is found at half the detail; at full detail it explains too little."""
    image, truth = under_grain(seed)
    found = Consensus().detect(image)
    assert is_exact(found, truth, image, 1.5) and found.diagnostics["shrunk"] > 1
    monkeypatch.setattr("nrbench.detectors.consensus.COARSEST", 1)
    with pytest.raises(NoLatticeFound, match="explains only"):
        Consensus().detect(image)


def rival(basis: float, exact: float, merit: float = 0.5) -> Rival:
    """Return the best stable lattice of a detail, with square cells."""
    traits = Traits(*np.zeros(len(Traits._fields)))._replace(best=1.0)
    rest = (1 - exact) / 2
    return Rival(basis * np.eye(2), merit, traits, Probabilities(exact, rest, rest))


def test_the_most_certain_detail_is_chosen() -> None:
    """The lattices of the others are further rivals; periods under 12 px of the shrunk image do not count."""
    detector = Consensus()
    choice = detector.choose([(1, [rival(40, 0.1)]), (2, [rival(60, 0.3)]), (4, [rival(44, 0.9)])])
    assert choice is not None and choice.detail == 1
    assert [one.basis[0, 0] for one in choice.rivals] == [60, 44, 40]
    assert detector.choose([]) is None and detector.choose([(4, [rival(44, 0.9)])]) is None


def test_a_certain_lattice_ends_the_search() -> None:
    """No coarser detail is read, unless the lattice explains too little of the image."""

    def read() -> Iterator[tuple[int, list[Rival]]]:
        yield 1, [rival(40, 0.99, merit)]
        yield 2, [rival(60, 0.3)]
        raise AssertionError("the third detail was read")

    detector = Consensus()
    merit = 0.5
    choice = detector.choose(read())
    assert choice is not None and choice.detail == 0 and len(choice.rivals) == 1
    merit = 0.01
    with pytest.raises(AssertionError, match="third detail"):
        detector.choose(read())
    choice = detector.choose([(1, [rival(40, 0.99, 0.01)]), (2, [rival(60, 0.3)])])
    assert choice is not None and choice.detail == 1


def two_colored(contrast: float) -> Image:
    """Return nested squares, 24 px apart, of which every second column has another color, ``(168, 168, 3)``."""
    y, x = np.indices((168, 168))
    size = np.maximum(abs(x % 24 - 12), abs(y % 24 - 12))
    shade = np.where(size < 4, 0.25, np.where(size < 9, 0.55, 0.4))[..., np.newaxis]
    tint = np.where(x // 24 % 2 == 0, contrast, -contrast)[..., np.newaxis] * [1.0, -0.5, -0.5]
    square = (size < 9)[..., np.newaxis]
    noise = np.random.default_rng(0).normal(0, 0.03, (168, 168, 3))
    return quantize(np.clip(shade + square * tint + noise, 0, 1).astype(np.float32))


def test_structure_and_color_are_both_told() -> None:
    """Squares in columns of two colors have two lattices, each with its role and with the same confidence."""
    found = Consensus().detect(two_colored(0.15))
    lattices = {found.role: found.lattice} | {other.role: other.lattice for other in found.alternatives if other.role}
    assert lattices["structure"].is_equivalent(Lattice((24, 0), (0, 24)), 0.1)
    assert lattices["color"].is_equivalent(Lattice((48, 0), (0, 24)), 0.1)
    assert found.confidence <= 0.5
    partner = next(other for other in found.alternatives if other.role)
    assert partner in found.alternatives[:2] and partner.confidence == pytest.approx(found.confidence)


@pytest.mark.parametrize("model", ["weave", "squares", "hexagon"])
def test_random_colors_have_no_roles(model: str) -> None:
    """Elements whose colors vary at random do not repeat by a coarser lattice."""
    drawn = texture(model, (160, 160), 2, color=0.5, noise=0.04)
    found = Consensus().detect(quantize(drawn.image))
    assert found.role == "" and not any(other.role for other in found.alternatives)


@pytest.mark.parametrize(("seed", "color"), [(1, 0.4), (3, 0.2), (3, 0.6), (7, 0.4)])
def test_few_long_threads_have_no_roles(seed: int, color: float) -> None:
    """Nine threads whose random colors alternate by chance are not taken for two colors."""
    found = Consensus().detect(quantize(texture("weave", (128, 128), seed, color=color, noise=color / 4).image))
    assert found.role == "" and not any(other.role for other in found.alternatives)


def test_waves_and_views_are_analyzed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shrunk copies reuse the waves of a small image, and the views of a large one."""
    sides: list[int] = []
    monkeypatch.setattr(Frdft, "propose", lambda self, image: sides.append(len(image)) or [])
    detector = Consensus()
    grain = np.random.default_rng(0).random((700, 700, 1), np.float32)
    assert len(list(detector.list_rivals(grain[:128, :128]))) <= 3 and sides == [128]
    sides.clear()
    detector.list_rivals(grain)
    assert sides == [256, 256, 175]  # the middle of the image, of its half, and all of its quarter


def test_proposals_of_other_detectors_are_rated(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lattice that only another detector proposes is found."""
    drawn = texture("brick", (128, 128), 1, color=0.2)
    image = quantize(drawn.image)
    assert drawn.lattice is not None
    own = propose_lattices
    monkeypatch.setattr("nrbench.detectors.consensus.propose_lattices", lambda *given: own(*given)[:0])
    assert is_exact(Consensus().detect(image), drawn.lattice, image)


@pytest.mark.parametrize("color", [0.0, 0.1, 0.3])
def test_traits_of_structure_ignore_colors(color: float) -> None:
    """If every second column of disks has another brightness, slopes and edges tell no alternation of elements."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:168, :168]
    disks = 1 / (1 + np.exp(3 * (np.hypot(x % 12 - 5.5, y % 12 - 5.5) - 3.5)))
    levels = np.kron(1 + 0.06 * rng.normal(size=(14, 14)), np.ones((12, 12))) * (1 + color * (x // 12 % 2 - 0.5))
    image = np.clip(0.2 + 0.5 * disks * levels + rng.normal(0, 0.02, (168, 168)), 0, 1)
    _, rivals = Consensus().list_rivals(quantize(image[..., np.newaxis].astype(np.float32)))[0]
    cells = {relate_bases(rival.basis, np.diag([12.0, 12.0])): rival.traits for rival in rivals}
    assert {1, 2} <= set(cells) and (cells[1].alternation > 3) == (color > 0)
    assert cells[1].structure_alternation == cells[2].distinction == 0


def test_a_supercell_and_a_subcell_that_are_probable_speak_for_different_errors() -> None:
    """What a nearly as probable lattice is tells what the chosen one may be.

    The partner of structure or color does not count.
    """
    traits = Traits(*np.zeros(len(Traits._fields)))
    sure = Rival(np.eye(2) * 20, 1.0, traits, Probabilities(0.6, 0.3, 0.1))
    coarser, finer, unrelated = (
        sure._replace(basis=basis, probabilities=Probabilities(0.5, 0.3, 0.2))
        for basis in (np.diag([20.0, 40.0]), np.diag([10.0, 20.0]), np.array([[17.0, 3.0], [-5.0, 31.0]]))
    )
    alone = describe_choice([sure])
    for number, rival in enumerate((coarser, finer, unrelated), 3):
        described = describe_choice([sure, rival])
        assert described[number] == math.log(0.5)
        assert described[:number] + described[number + 1 :] == alone[:number] + alone[number + 1 :]
    assert describe_choice([sure._replace(role="color"), coarser._replace(role="structure")]) == alone
    doubled, alternated = (reclassify([sure, rival]) for rival in (coarser, finer))
    assert doubled.sub_or_supercell > max(alternated.sub_or_supercell, reclassify([sure]).sub_or_supercell)


def test_certainty_is_shared() -> None:
    """Of several lattices at most one is exact; a pair of structure and color divides the larger probability."""
    traits = Traits(*np.zeros(len(Traits._fields)))
    basis = np.eye(2) * 20
    sure = Rival(basis, 1.0, traits, Probabilities(0.9, 0.08, 0.02))
    likely = Rival(basis * 2, 0.9, traits, Probabilities(0.6, 0.2, 0.2))
    chosen, (other,) = share_certainty([sure, likely])
    assert sum(chosen) == pytest.approx(1) and chosen.exact == reclassify([sure, likely]).exact
    assert 0 < other <= 1 - chosen.exact + 1e-12
    alone, _ = share_certainty([sure])
    assert alone.exact > chosen.exact  # no other one is nearly as probable
    pair, (partner,) = share_certainty([sure._replace(role="color"), likely._replace(role="structure")])
    assert sum(pair) == pytest.approx(1) and pair.none == pytest.approx(alone.none)
    assert pair.exact == partner == pytest.approx(alone.exact / 2)


def test_probabilities_follow_the_traits() -> None:
    """A strong lattice that three detectors propose is exact; one whose supercells correlate better is a subcell."""
    nothing = Traits(*np.zeros(len(Traits._fields)))
    strong = nothing._replace(sigmas=4.0, tiles=4.6, structure_relief=1.0, split_error=-4.0, merit=1.0, best=1.0)
    strong = strong._replace(gncc=1.0, frdft=1.0, dominance=1.0)
    assert classify(strong).exact > 0.9
    alone = strong._replace(gncc=0.0, frdft=0.0, dominance=0.0, coarser=3.0)
    alone = alone._replace(structure_split=1.0, split_2=1.0, alternation=3.0)
    assert classify(alone).exact < 0.3
    assert sum(classify(alone)) == pytest.approx(1)
