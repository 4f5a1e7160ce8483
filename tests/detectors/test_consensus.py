"""The consensus detector finds the smallest lattice whose tiles best predict one another."""

from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from nrbench import texture
from nrbench.detectors.candidate_search.candidates import Traits, classify, relate_bases
from nrbench.detectors.consensus import Consensus, rate_levels
from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.lattice.relation import lattice_error, relate
from nrbench.plugins.forms import Detection, NoLatticeFound


def is_exact(detection: Detection, truth: Lattice | None, image: Image, tolerance: float = 1.0) -> bool:
    """Return whether a detection is the true lattice."""
    return lattice_error(detection.lattice, truth, image.shape[:2], tolerance).relation == "exact"


@pytest.mark.parametrize("model", ["brick", "weave", "hexagon", "squares", "scales", "basket", "plate", "pavement"])
@pytest.mark.parametrize("departures", [{}, {"color": 0.4, "noise": 0.05}], ids=["regular", "varied"])
def test_models_are_exact(model: str, departures: dict[str, Any]) -> None:
    """The lattice is exact to a quarter of a pixel for each family, regular or varied."""
    drawn = texture(model, (128, 144), 3, **departures)
    assert is_exact(Consensus().detect(quantize(drawn.image)), drawn.lattice, drawn.image, 0.25)


THREADS = {"color": 0.6, "noise": 0.05, "rotation": 31.7}


@pytest.mark.parametrize(
    ("model", "side", "seed", "departures"),
    [
        *(("weave", 160, seed, THREADS) for seed in range(4)),
        *(("weave", 128, seed, {"color": c, "noise": c / 4}) for seed, c in ((1, 0.4), (3, 0.2), (3, 0.6), (7, 0.4))),
        *((model, 160, 2, {"color": 0.5, "noise": 0.04}) for model in ("squares", "hexagon")),
        ("brick", 160, 2, {"color": 0.3, "jitter": 0.3}),
    ],
)
def test_chance_makes_neither_super_nor_subcell(model: str, side: int, seed: int, departures: dict[str, float]) -> None:
    """Neither threads whose colors match by chance, nor tiles dyed at random, nor joints in line change the lattice."""
    drawn = texture(model, (side, side), seed, **departures)
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
@pytest.mark.parametrize("seed", range(2))
def test_stochastic_textures_have_none(spectrum: str, seed: int) -> None:
    """No lattice is found in noise of any spectrum; the exception carries the one found without rejection, if any."""
    drawn = quantize(texture("noise", (96, 96), seed, spectrum=spectrum).image)
    with pytest.raises(NoLatticeFound) as refusal:
        Consensus().detect(drawn)
    best = refusal.value.best
    assert (best is None) == ("no two peaks" in str(refusal.value)) == (spectrum in ("white", "pink", "brown"))
    assert best is None or best.lattice == Consensus(reject="none").detect(drawn).lattice


@pytest.mark.parametrize("period", [2.8, 3.1, 4.01, 5.3, 7.7, 12.4])
@pytest.mark.parametrize("seed", range(2))
def test_fine_gratings_have_none(period: float, seed: int) -> None:
    """Stripes of a few pixels at any angle, whose edges beat with the pixel grid, have no lattice."""
    angle = np.random.default_rng(seed).uniform(0.1, 1.4)
    y, x = np.indices((80, 80))
    stripes = 0.5 + 0.4 * np.sin(2 * np.pi * (x * np.cos(angle) + y * np.sin(angle)) / period)
    with pytest.raises(NoLatticeFound):
        Consensus().detect(quantize(stripes[..., np.newaxis].astype(np.float32)))


@pytest.mark.parametrize("cell", [(2, 4), (4, 2), (2, 5), (1, 7)])
def test_periods_too_short_to_be_sampled_have_none(cell: tuple[int, int]) -> None:
    """A texture that repeats by less than three pixels has no lattice; this is an answer and no error."""
    values = np.random.default_rng(0).random(cell, np.float32)
    image = np.tile(values, (64 // cell[0] + 1, 64 // cell[1] + 1))[:64, :64, np.newaxis]
    with pytest.raises(NoLatticeFound):
        Consensus().detect(image)


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


def test_a_quarter_turn_turns_the_lattice() -> None:
    """A transposed image has the transposed lattice; a gray and a darker copy have the same lattice."""
    drawn = quantize(texture("hexagon", (128, 144), 5, color=0.3, rotation=12.0).image)
    lattice = Consensus().detect(drawn).lattice
    turned = Consensus().detect(np.ascontiguousarray(drawn.transpose(1, 0, 2))).lattice
    assert lattice.is_equivalent(Lattice(turned.t1[::-1], turned.t2[::-1]), 0.02)
    gray = drawn.mean(2, keepdims=True)
    assert lattice.is_equivalent(Consensus().detect(gray).lattice, 0.1)
    assert lattice.is_equivalent(Consensus().detect(0.2 + 0.5 * drawn).lattice, 0.05)


def test_confidence_separates_right_from_wrong() -> None:
    """The confidence of a regular wall is high, that of lattices in noise is low."""
    wall = quantize(texture("brick", (128, 128), 1, color=0.2).image)
    assert Consensus().detect(wall).confidence > 0.9
    noise = [quantize(texture("noise", (128, 128), seed, spectrum="grass").image) for seed in range(4)]
    found = [Consensus(reject="none").detect(image).confidence for image in noise]
    assert np.mean(found) < 0.2 and max(found) < 0.3


def test_alternatives_are_ranked_and_related() -> None:
    """The alternatives come by confidence, differ from the lattice, and say how; confidences add up to at most 1."""
    drawn = texture("brick", (128, 128), 1, color=0.3, noise=0.05)
    found = Consensus().detect(quantize(drawn.image))
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


def test_similar_halves_are_no_stripes() -> None:
    """The correlation at half of the cell is nearly as high as at the cell, and the lattice is found all the same."""
    image = halves(0.45, 1)
    assert not next(rate_levels(image)).is_striped()
    assert Consensus().detect(image).lattice.is_equivalent(Lattice((30, 0), (0, 19)), 0.2)


def test_a_faint_alternation_lowers_the_confidence() -> None:
    """The more two alternating elements differ, the less probable is the cell of one, until that of both is found."""
    one, both = Lattice((15, 0), (0, 19)), Lattice((30, 0), (0, 19))
    found = [Consensus().detect(halves(difference, 0)) for difference in (0.0, 0.2, 0.3, 0.4, 0.6)]
    assert all(detection.lattice.is_equivalent(one, 0.2) for detection in found[:2])
    assert all(detection.lattice.is_equivalent(both, 0.2) for detection in found[2:])
    same, faint, *clear = (detection.confidence for detection in found)
    assert same > 0.9 and same > faint + 0.1 and clear == sorted(clear) and clear[-1] > 0.9
    assert found[1].alternatives[0].lattice.is_equivalent(both, 0.2) and found[1].alternatives[0].confidence > 0.2


def under_grain(seed: int) -> tuple[Image, Lattice]:
    """Return squares of random colors, enlarged three times, under fine noise and specks, and their lattice."""
    drawn = texture("squares", (96, 96), seed, color=0.3)
    large = drawn.image.repeat(3, 0).repeat(3, 1)
    rng = np.random.default_rng(seed)
    specks = 0.35 * (rng.random((288, 288, 1)) < 0.07)
    grain = 0.25 * rng.standard_normal(large.shape).mean(2, keepdims=True)
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


def test_proposals_of_other_detectors_are_rated(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lattice that only another detector proposes is found."""
    drawn = texture("brick", (128, 128), 1, color=0.2)
    image = quantize(drawn.image)
    monkeypatch.setattr("nrbench.detectors.consensus.propose_lattices", lambda evidence: [])
    assert is_exact(Consensus().detect(image), drawn.lattice, image)


def test_elements_that_alternate_tell_a_subcell() -> None:
    """The cell of one of two alternating elements has a high alternation; the cell of both has none."""
    candidates = next(rate_levels(halves(0.3, 0))).candidates
    traits = {relate_bases(each.basis, np.diag([15.0, 19.0])): each.traits for each in candidates}
    assert traits[1].alternation > traits[2].alternation == 0


def test_candidates_share_the_probability() -> None:
    """The probabilities follow the traits and the weights, and add up to less than 1: possibly none is exact."""
    strong = Traits(1.0, 4.0, 2.0, 0.0, 0.0, 0.0, 1.0)
    weak = strong._replace(votes=0.0, nested_votes=2.0, alternation=2.0, best=0.0)
    alone, (first, second) = classify([strong]), classify([strong, weak])
    assert alone[0] > 0.9 and alone[0] > first > 0.8 > 0.1 > second > 0 and first + second < 1
    assert classify([strong, weak], dict.fromkeys(Traits._fields, 0.0)).tolist() == [1 / 3, 1 / 3]
