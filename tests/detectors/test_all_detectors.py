"""What holds for every detector: its form, its answers to images without a lattice, and its parameters."""

import pickle
from typing import Any

import numpy as np
import pytest
from conformance import violations

from nrbench import plugins, texture
from nrbench.errors import BadInput
from nrbench.imaging.convert import quantize
from nrbench.plugins.forms import NoLatticeFound

NAMES = [plugin.name for plugin in plugins.inventory("detectors") if plugin.built_in]
FEW = {"surrogates": 8}
CHEAP: dict[str, dict[str, Any]] = {"frdft": {"reject": "none"}, "ssdn": FEW, "gncc": FEW, "dominance": FEW}
WITH_COPIES = ("gncc", "frdft", "ssdn", "dominance")
"""The detectors that are tested against phase-randomized copies."""
REASONS = {
    "consensus": "no two peaks|chance|explains only|stripes",
    "gncc": "no two peaks|chance",
    "frdft": "waves|chance",
    "ssdn": "only rectangular",
    "dominance": "no two peaks|chance",
    "tracked": "no two peaks|chance|explains only|stripes",
}
"""Words of the reasons for which each detector refuses the smallest images."""


@pytest.mark.parametrize("name", NAMES)
def test_a_detector_conforms(name: str) -> None:
    """The detector fails no clause of its form."""
    assert violations("detectors", name, CHEAP.get(name, {})) == []


@pytest.mark.parametrize("angle", [0.0, 0.6, np.pi / 2])
@pytest.mark.parametrize("name", NAMES)
def test_a_grating_has_no_lattice(name: str, angle: float) -> None:
    """Stripes in noise repeat along one direction only and are refused."""
    y, x = np.indices((96, 96))
    stripes = np.tanh(4 * np.sin(2 * np.pi * (x * np.cos(angle) + y * np.sin(angle)) / 17.3))
    image = 0.5 + 0.15 * stripes + 0.03 * np.random.default_rng(0).standard_normal((96, 96))
    with pytest.raises(NoLatticeFound):
        plugins.build("detectors", name).detect(quantize(np.clip(image, 0, 1)[..., np.newaxis].astype(np.float32)))


@pytest.mark.parametrize("name", NAMES)
def test_noise_has_no_lattice(name: str) -> None:
    """White noise is refused."""
    with pytest.raises(NoLatticeFound):
        plugins.build("detectors", name).detect(np.random.default_rng(0).random((96, 64, 3)).astype(np.float32))


@pytest.mark.parametrize("name", NAMES)
def test_a_constant_image_has_no_texture(name: str) -> None:
    """A constant image is refused with and without a test against chance, and the message says that it is constant."""
    for parameters in ({}, {"reject": "none"}):
        with pytest.raises(NoLatticeFound, match="constant"):
            plugins.build("detectors", name, parameters).detect(np.full((64, 64, 3), 0.4, np.float32))


@pytest.mark.parametrize("shape", [(8, 8), (8, 40), (13, 9)])
@pytest.mark.parametrize("name", NAMES)
def test_tiny_images_are_refused_with_a_reason(name: str, shape: tuple[int, int]) -> None:
    """The smallest images of noise raise nothing but a refusal, which says why."""
    detector = plugins.build("detectors", name, {"surrogates": 10} if name in WITH_COPIES else {})
    for seed in range(5):
        with pytest.raises(NoLatticeFound, match=REASONS[name]):
            detector.detect(np.random.default_rng(seed).random((*shape, 3)).astype(np.float32))


@pytest.mark.parametrize("shape", [(8, 8), (8, 200), (200, 9), (33, 16)])
@pytest.mark.parametrize("name", NAMES)
def test_tiny_images_are_answered_without_a_test(name: str, shape: tuple[int, int]) -> None:
    """Without a test against chance, an image too small for a lattice is refused or gets a lattice that it can hold."""
    for seed in range(3):
        try:
            found = plugins.build("detectors", name, {"reject": "none"}).detect(
                np.random.default_rng(seed).random((*shape, 3)).astype(np.float32)
            )
        except NoLatticeFound:
            continue
        assert 0 < found.lattice.area < shape[0] * shape[1] and 0 <= found.confidence <= 1


@pytest.mark.parametrize("name", NAMES)
def test_detection_repeats_and_travels(name: str) -> None:
    """Two detections of one image agree to the last bit, copies included; they and refusals survive pickling."""
    image = quantize(texture("card", (96, 96), 0).image)
    detector = plugins.build("detectors", name, {"surrogates": 6} if name in WITH_COPIES else {})
    first, second = (detector.detect(image) for _ in range(2))
    assert first.lattice == second.lattice == pickle.loads(pickle.dumps(first)).lattice
    for key in first.diagnostics:
        if key.startswith("surrogate_"):
            np.testing.assert_array_equal(first.diagnostics[key], second.diagnostics[key])
    refusal = pickle.loads(pickle.dumps(NoLatticeFound("why", first)))
    assert refusal.reason == "why" and refusal.best.lattice == first.lattice


@pytest.mark.parametrize(
    ("name", "parameter", "hint"),
    [
        ("consensus", {"min_explained": 1.0}, "give a share"),
        ("consensus", {"reject": "maybe"}, "give none or bartlett"),
        ("gncc", {"alpha": 0.9}, "at least 1"),
        ("gncc", {"peaks": 1}, "at least 2"),
        ("frdft", {"threshold": -1.0}, "amplitude"),
        ("ssdn", {"depth": 0.0}, "above 0"),
        ("dominance", {"tolerance": 0.5}, "between 0 and 0.5"),
        ("tracked", {"reject": "maybe"}, "give none or half"),
        *((name, {"reject": "maybe"}, "none or surrogate") for name in WITH_COPIES),
        *((name, {"surrogates": 1}, "at least 2") for name in WITH_COPIES),
        *((name, {"false_alarms": 0.0}, "probability") for name in WITH_COPIES),
    ],
)
def test_parameters_out_of_range_are_refused(name: str, parameter: dict[str, Any], hint: str) -> None:
    """The message names the parameter and says what to give."""
    with pytest.raises(BadInput, match=hint) as refusal:
        plugins.find("detectors", name).cls(**parameter)
    assert str(refusal.value).startswith(f"{name}: {next(iter(parameter))}")
