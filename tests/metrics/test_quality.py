"""Quality, the worst of four perils: fresh draws, edits, baselines, and what cannot be told."""

import itertools
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from cases import Case, case, copy_cells, scored

from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.noise import Noise
from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.metrics import appearance
from nrbench.metrics.judgment import joint_tests
from nrbench.metrics.perception import visible
from nrbench.metrics.quality import PERILS, Quality
from nrbench.metrics.registration import coherence, lattice_net
from nrbench.plugins.forms import Observation, Score, Shape, Synthesizer, Task, Texture
from nrbench.synthesizers.random_phase import RandomPhase
from nrbench.synthesizers.scatter import Scatter
from nrbench.synthesizers.shuffle import Shuffle
from nrbench.synthesizers.supertile import Supertile
from nrbench.synthesizers.tiling import Tiling

PLAIN = Brick(color=0.0, intensity=0.0, noise=0.1)
"""Bricks without a tone of their own: joined ones look whole."""
UNSEEN: Mapping[str, float] = {
    "JPEG 4:2:0, quality": 85, "shift, bilinear, px": 0.5, "blur, px": 0.6, "turned, degrees": 0.5,
    "larger, share": 0.01, "smooth chroma, levels": 2, "brighter, levels": 2,
}  # fmt: skip
"""Edits that nobody sees, with their doses."""
HARSH: Mapping[str, float] = {
    "brighter, levels": 30, "gray grain, levels": 25, "flat hole, cells": 2, "half slipped along rows, s": 0.3,
    "step of light": 0.16,
}  # fmt: skip
SEEN: Mapping[str, float] = {**HARSH, "red and blue swapped": 1, "blur, px": 2, "JPEG 4:2:0, quality": 6}
"""Edits that everybody sees."""
BASELINES: tuple[Synthesizer, ...] = (Tiling(), Shuffle(), Scatter(), RandomPhase())


def quality(observation: Observation) -> Score:
    """Return the score, and check that it is the smallest of the known perils, and complete if all are known."""
    score = scored(Quality, observation)
    known = [score.values[name] for name in PERILS if score.values[name] is not None]
    assert score.values["score"] == min(known) == score.values[score.records["worst"]]
    lost = score.values["regularity"] == 0
    assert score.values["complete"] is (lost or len(known) == len(PERILS))
    return score


def rate(case: Case, image: Image, model: bool = True) -> float:
    """Return the quality of an output."""
    return float(quality(case.observe(image, model)).values["score"])


def rate_edits(own: Case, doses: Mapping[str, float], model: bool = True) -> dict[str, float]:
    """Return the quality of a fresh draw with each edit."""
    edits = enumerate(doses.items())
    return {name: rate(own, own.edited(name, dose, 1 + i % 2), model) for i, (name, dose) in edits}


@pytest.mark.parametrize("model", [True, False])
def test_fresh_draws_have_full_quality(own: Case, model: bool) -> None:
    """The mean quality of fresh draws is at least 0.97 with the model and 0.9 without it, and no peril is unknown."""
    found = [quality(own.observe(own.fresh(k=k), model)).values for k in range(6)]
    assert all(values["complete"] for values in found)
    scores = [values["score"] for values in found]
    assert np.mean(scores) >= (0.97 if model else 0.9)
    assert min(scores) >= (0.9 if model else 0.75)


def test_what_nobody_sees_keeps_the_quality(own: Case) -> None:
    """Re-encoding, resampling, a trace of blur, of noise and of light leave a quality of at least 0.85."""
    assert {edit: value for edit, value in rate_edits(own, UNSEEN).items() if value < 0.85} == {}


def test_what_everybody_sees_loses_the_quality(own: Case) -> None:
    """Swapped colors, light, blur, compression, noise, a hole and a slip leave a quality of at most 0.6."""
    assert {edit: value for edit, value in rate_edits(own, SEEN).items() if value > 0.6} == {}


def test_the_sample_alone_tells_seen_from_unseen_edits(own: Case) -> None:
    """Without the model each edit that nobody sees has a higher quality than any of light, noise, holes and slips."""
    assert min(rate_edits(own, UNSEEN, False).values()) >= 0.8
    assert max(rate_edits(own, HARSH, False).values()) <= 0.3


def test_baselines_have_little_quality(own: Case) -> None:
    """Each baseline, and hard-edged copies of cells, fall into one peril: the quality is at most 0.25.

    A supertile is judged on an output of twice the sample, as in the suites: on less it hardly returns.
    """
    made = {type(baseline).__name__: baseline.synthesize(own.task()).image for baseline in BASELINES}
    made["supertile"] = Supertile().synthesize(own.task(256)).image
    made["copies"] = copy_cells(own.task())
    found = {name: rate(own, quantize(image)) for name, image in made.items()}
    assert {name: value for name, value in found.items() if value > 0.25} == {}


@pytest.mark.parametrize(
    ("kind", "size", "peril"),
    [
        ("phase-step", 0.25, "regularity"),
        ("two-tone", 0.4, "integrity"),
        ("color-mean", 0.15, "appearance"),
    ],
)
def test_a_fault_is_named_by_its_peril(own: Case, kind: str, size: float, peril: str) -> None:
    """A slip, two-tone tiles and another color each lower one peril most, and the quality by it."""
    score = quality(own.observe(own.planted(kind, size)[0]))
    assert score.records["worst"] == peril and score.values["score"] < 0.8


def exchange_axes(texture: Texture) -> Texture:
    """Return a texture with x and y exchanged."""
    assert texture.lattice is not None and texture.ideal is not None
    vectors = (texture.lattice.t1, texture.lattice.t2, texture.lattice.origin)
    image, ideal = (np.ascontiguousarray(plane.swapaxes(0, 1)) for plane in (texture.image, texture.ideal))
    return replace(texture, image=image, ideal=ideal, lattice=Lattice(*((y, x) for x, y in vectors)), lattices=())


@pytest.mark.parametrize("kind", ["phase-step", "color-mean"])
def test_no_axis_is_special(kind: str) -> None:
    """If x and y of texture, fresh draws and output are exchanged, the quality changes by less than a twentieth."""
    own = case("hexagon")
    image = own.planted(kind, 0.15)[0]
    other = exchange_axes(own.texture)

    def again(shape: Shape, k: int) -> Texture | None:
        drawn = own.again((shape[1], shape[0]), k)
        return drawn and exchange_axes(drawn)

    turned = Observation(other.image, np.ascontiguousarray(image.swapaxes(0, 1)), other, again=again)
    assert quality(turned).values["score"] == pytest.approx(rate(own, image), abs=0.05)


@pytest.mark.parametrize("model", [True, False])
def test_pictures_of_something_else_have_no_quality(own: Case, model: bool) -> None:
    """A flat picture of the mean color, and white noise, have a quality of 0."""
    flat = np.broadcast_to(own.texture.image.mean((0, 1)), (192, 192, 3)).astype(np.float32)
    assert rate(own, quantize(flat), model) == 0
    assert rate(own, quantize(np.random.default_rng(0).random((192, 192, 3), np.float32)), model) == 0


def test_a_lost_lattice_leaves_the_tiles_unjudged() -> None:
    """Where no tile is in place, integrity and randomness are None with a reason, and the quality is complete."""
    score = quality(case("brick").observe(case("brick").planted("off-lattice", 0.3)[0]))
    assert score.values["score"] == 0 and score.values["complete"] is True
    assert score.values["integrity"] is None and "out of place" in score.reasons["integrity"]
    assert score.values["randomness"] is None and "out of place" in score.reasons["randomness"]


def test_a_peril_without_power_makes_an_upper_bound() -> None:
    """If bricks have no tone of their own integrity is None, and the quality is not complete."""
    own = Case.of(PLAIN)
    score = quality(own.observe(own.fresh()))
    assert score.values["integrity"] is None and score.reasons["integrity"].startswith("not measured")
    assert score.values["complete"] is False and score.values["score"] > 0.9


@pytest.mark.parametrize(("sample", "output"), [(128, 8), (128, 24), (128, 40), (16, 96), (8, 8)])
@pytest.mark.parametrize("model", [True, False])
def test_too_small_pictures_have_reasons(sample: int, output: int, model: bool) -> None:
    """A sample or an output of few tiles gives values with reasons, and no error."""
    whole = case("brick").observe(case("brick").fresh()[:output, :output], model)
    small = whole.sample[:sample, :sample]
    truth = replace(case("brick").texture, image=small) if model else Texture(small, case("brick").lattice)
    observation = replace(whole, sample=small, truth=truth)
    assert scored(Quality, observation).values["score"] is None or output == 40 or model
    for metric in PERILS.values():
        scored(metric, observation)


def test_gray_images_are_scored() -> None:
    """Of gray pictures a fresh draw has full quality, with the model and without, and one tile repeated has none."""
    model = Brick(color=0.0, intensity=0.25, noise=0.03)
    own = Case.of(model, 5)

    def again(shape: Shape, k: int) -> Texture | None:
        drawn = own.again(shape, k)
        return replace(drawn, image=drawn.image[..., :1], ideal=drawn.ideal[..., :1])

    gray = replace(own.texture, image=own.texture.image[..., :1])
    fresh = Observation(gray.image, own.fresh()[..., :1], gray, again=again)
    alone = replace(fresh, truth=Texture(gray.image, own.lattice), again=None)
    task = Task(gray.image, (192, 192), own.lattice, np.random.default_rng(0))
    paper = quantize(Tiling().synthesize(task).image)
    for observation in (fresh, alone):
        assert quality(observation).values["score"] >= 0.85
        assert quality(replace(observation, output=paper)).values["score"] <= 0.1


def test_a_texture_without_lattice_has_its_appearance_only() -> None:
    """Noise has no lattice: the quality is None with that reason, appearance is measured."""
    model = Noise(spectrum="pink")
    drawn = [model.render((128, 128), np.random.default_rng(k)) for k in range(2)]
    observation = Observation(drawn[0].image, drawn[1].image, replace(drawn[0], kind="stochastic"))
    score = scored(Quality, observation)
    assert set(score.values.values()) == {None} and "no lattice" in score.reasons["score"]
    assert scored(PERILS["appearance"], observation).values["score"] is not None


def test_the_order_of_metrics_does_not_matter() -> None:
    """Each metric has the same values alone, after all others, and within quality."""
    image = case("weave").planted("two-tone", 0.2)[0]
    shared = case("weave").observe(image)
    whole = quality(shared).values
    for name, metric in itertools.chain(reversed(PERILS.items()), PERILS.items()):
        values = scored(metric, shared).values
        assert values == scored(metric, case("weave").observe(image)).values
        assert whole[name] == values["score"]


@pytest.mark.parametrize("model", [True, False])
def test_what_the_method_used_does_not_matter(model: bool) -> None:
    """The lattice, source map and extras of a method, its cost and the random stream change no value."""
    image = case("hexagon").planted("displaced-tile", 0.35)[0]
    plain = case("hexagon").observe(image, model)
    told = replace(
        plain,
        lattice_given=Lattice((17.0, 3.0), (0.0, 19.0)),
        lattice_used=Lattice((5.0, 0.0), (0.0, 5.0)),
        source=np.zeros((192, 192, 3), np.float32),
        seconds=3.0,
        rng=np.random.default_rng(7),
    )
    for metric in (Quality, *PERILS.values()):
        assert scored(metric, told).values == scored(metric, plain).values


def test_bands_change_no_score(monkeypatch: pytest.MonkeyPatch) -> None:
    """A large picture is judged in bands: its scores and its marked pictures are those of the whole."""
    observation = case("brick").observe(case("brick").fresh(), model=False)
    whole = [metric().score(replace(observation)) for metric in PERILS.values()]
    for module, name, value in (
        (lattice_net, "_BAND", 5000),
        (coherence, "_MOST_VOTES", 50_000),
        (appearance, "_BLOCK", 1000),
        (visible, "_BAND", 5000),
        (joint_tests, "_AT_ONCE", 5),
    ):
        monkeypatch.setattr(module, name, value)
    for before, metric in zip(whole, PERILS.values(), strict=True):
        after = metric().score(replace(observation))
        assert after.reasons == before.reasons
        known = {name: value for name, value in before.values.items() if value is not None}
        assert {name: after.values[name] for name in known} == pytest.approx(known, rel=1e-5, abs=1e-6)
        for name, picture in before.pictures.items():
            np.testing.assert_array_equal(after.pictures[name], picture)
