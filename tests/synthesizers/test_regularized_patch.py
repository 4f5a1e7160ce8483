import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from synthesis_cases import FRACTIONAL, noise, synthesize, waves

import nrbench
from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.imaging.convert import quantize
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Observation, Refused, Texture
from nrbench.running.output_checks import check_source
from nrbench.synthesizers.regularized_patch import RegularizedPatch


def bent(bend: float, model: str = "brick", seed: int = 0, **departures: float) -> Texture:
    """Return a texture of 192 px with rounded pixels."""
    texture = nrbench.texture(model, shape=(192, 192), seed=seed, bend=bend, **departures)
    return replace(texture, image=quantize(texture.image))


@pytest.mark.parametrize("texel", ["hexagon", "quadrilateral", "given"])
def test_a_whole_pixel_lattice_is_continued_exactly(texel: Any) -> None:
    """On a perfectly periodic sample the output is the periodic continuation, phase included, to the gray level."""
    picture = quantize(np.tile(np.random.default_rng(0).random((24, 30, 3), np.float32), (12, 12, 1)))
    made = synthesize(RegularizedPatch(texel=texel), picture[:100, :128], (220, 250), Lattice((30, 0), (0, 24)))
    np.testing.assert_array_equal(quantize(made.image), picture[:220, :250])


def test_a_fractional_lattice_neither_drifts_nor_blurs() -> None:
    """Over 600 px an oblique real-valued lattice is continued within two gray levels (rms) of the truth."""
    sample = quantize(waves((110, 110), FRACTIONAL))
    made = synthesize(RegularizedPatch(), sample, (600, 600), FRACTIONAL)
    error = made.image - waves((600, 600), FRACTIONAL)
    assert np.sqrt((error**2).mean()) < 2 / 255
    assert np.sqrt((error[-100:, -100:] ** 2).mean()) < 2 / 255


@pytest.mark.parametrize("bend", [0.0, 0.5])
def test_the_map_points_at_what_is_shown(bend: float) -> None:
    """The source map passes the check of a run; straight pixels inside texels are copies or nearly so."""
    texture = bent(bend)
    made = synthesize(RegularizedPatch(), texture.image, (150, 170), texture.lattice)
    assert made.source is not None and made.lattice is not None
    check_source(made.source, quantize(made.image), texture.image)
    x, y = made.source[..., :2].astype(int).reshape(-1, 2).T
    shown = texture.image[y, x].reshape(made.image.shape)
    assert np.abs(shown - made.image).mean() < 0.05


def test_deformations_are_synthesized_kept_or_left_out() -> None:
    """The amplitude is that of the sample if synthesized or kept, a third or less by argmax, and nearly 0 without."""
    texture, ratios = bent(0.5, "weave"), {}
    settings: dict[str, dict[str, Any]] = {
        "sample": {},
        "argmax": {"update": "argmax"},
        "keep": {"deform": "keep"},
        "none": {"deform": "none"},
    }
    for name, parameters in settings.items():
        made = synthesize(RegularizedPatch(**parameters), texture.image, (256, 256), texture.lattice)
        observation = Observation(texture.image, quantize(made.image), texture)
        ratios[name] = nrbench.plugins.build("metrics", "deformation").score(observation).values["amplitude_ratio"]
    assert ratios["sample"] == pytest.approx(1, abs=0.25)
    assert ratios["keep"] == pytest.approx(1, abs=0.25)
    assert ratios["argmax"] < 0.35 and ratios["none"] < 0.1


def test_the_field_of_a_large_output_folds_nowhere() -> None:
    """Bricks of bend 0.5: the topology is intact, amplitude and correlation length are within 25 % of the sample's."""
    texture = bent(0.5, seed=1)
    made = synthesize(RegularizedPatch(), texture.image, (256, 256), texture.lattice)
    observation = Observation(texture.image, quantize(made.image), texture)
    values = nrbench.plugins.build("metrics", "deformation").score(observation).values
    assert values["folded"] == 0
    assert values["amplitude_ratio"] == pytest.approx(1, abs=0.25)
    assert values["length_ratio"] == pytest.approx(1, abs=0.25)


def test_tolerance_trades_fit_for_variety() -> None:
    """With a large d_max texels are drawn freely, so that fewer neighbors in the output are neighbors in the sample."""
    texture = bent(0.0, "hexagon", color=0.5)
    joints = []
    for tolerance in (0.0, 1.0):
        made = synthesize(RegularizedPatch(tolerance=tolerance, zone=2.0), texture.image, (160, 160), texture.lattice)
        assert made.source is not None
        joints.append((np.abs(np.diff(made.source[..., :2], axis=1)).max(-1) > 2).mean())
    assert joints[0] < 0.9 * joints[1]


@pytest.mark.parametrize(
    "parameters",
    [
        {"zone": -1.0},
        {"zone": math.nan},
        {"tolerance": -0.1},
        {"tolerance": 1e300},
        {"deform": "keep", "update": "argmax"},
    ],
)
def test_bad_parameters_are_refused(parameters: dict[str, Any]) -> None:
    """A parameter out of range, or without effect, is an error that names it."""
    with pytest.raises(BadInput, match=next(iter(parameters)) if len(parameters) == 1 else "update"):
        RegularizedPatch(**parameters)


def test_the_paper_with_the_deformation_kept_needs_another_update() -> None:
    """The preset sets update, so the message about deform=keep names the update that removes the error."""
    kept = {"preset": "paper", "deform": "keep"}
    with pytest.raises(BadInput, match="choose update 'sample', also beside preset 'paper'"):
        plugins.build("synthesizers", "regularized-patch", kept)
    assert plugins.build("synthesizers", "regularized-patch", {**kept, "update": "sample"}).deform == "keep"


def test_samples_without_texels_are_refused() -> None:
    """No lattice, less than two periods, and less than two whole texels are refused, saying what is missing."""
    with pytest.raises(Refused, match="no lattice"):
        synthesize(RegularizedPatch(), noise(64, 64), (64, 64))
    with pytest.raises(Refused, match="two periods"):
        synthesize(RegularizedPatch(), noise(64, 64), (64, 64), Lattice((40, 0), (0, 40)))
    with pytest.raises(Refused, match="does not hold two"):
        synthesize(RegularizedPatch(texel="given", zone=20), noise(64, 64), (64, 64), Lattice((30, 0), (0, 30)))
