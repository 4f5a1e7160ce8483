import itertools
import math
from dataclasses import replace
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthesis_cases import FRACTIONAL, noise, synthesize

from nrbench import plugins
from nrbench.api import texture
from nrbench.errors import BadInput
from nrbench.imaging.convert import quantize
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Observation, Refused, Task
from nrbench.running.output_checks import checked_synthesis
from nrbench.synthesizers.gap_filling.canvas import SeamMethod
from nrbench.synthesizers.rsgf import Rsgf

SEAMS = get_args(SeamMethod)
PAPER = replace(Rsgf(**Rsgf.presets["paper"]), finder="consensus")
SMALL = replace(PAPER, block=8, border=2)


def test_the_papers_detector_loses_the_weave() -> None:
    """On a weave of 12.3 x 13.9 px, the paper's vectors of whole pixels lose the lattice; the default keeps it."""
    sample = texture("weave", (128, 128), 0, color=0.14)
    preserved = {}
    for name, method in (("paper", Rsgf(**Rsgf.presets["paper"])), ("default", Rsgf())):
        task = Task(quantize(sample.image), (224, 224), None, np.random.default_rng(0))
        observation = Observation(task.sample, quantize(method.synthesize(task).image), truth=sample)
        preserved[name] = plugins.build("metrics", "regularity").score(observation).values["preserved"]
    assert preserved == {"paper": False, "default": True}


@pytest.mark.parametrize("match", ["ncc", "color"])
@pytest.mark.parametrize("search", ["lattice", "everywhere"])
@pytest.mark.parametrize("channels", [1, 3])
def test_a_whole_pixel_lattice_is_continued_exactly(match: Any, search: Any, channels: int) -> None:
    """On a perfectly periodic sample the output continues it exactly, with its phase."""
    picture = np.tile(noise(24, 30, channels), (13, 13, 1))
    method = Rsgf(match=match, search=search)
    for shape in ((150, 170), (1, 300), (300, 1), (9, 5)):
        made = synthesize(method, picture[:128, :128], shape, Lattice((30, 0), (0, 24)))
        np.testing.assert_array_equal(quantize(made.image), picture[: shape[0], : shape[1]])


@pytest.mark.parametrize("seam", SEAMS)
@pytest.mark.parametrize("subpixel", [False, True])
def test_every_seam_continues_exactly(seam: Any, subpixel: bool) -> None:
    """Where patches continue each other, no seam or sub-pixel move changes a pixel."""
    picture = np.tile(noise(24, 30), (6, 6, 1))
    method = Rsgf(seam=seam, subpixel=subpixel)
    made = synthesize(method, picture[:128, :128], (100, 130), Lattice((30, 0), (0, 24)))
    np.testing.assert_array_equal(quantize(made.image), picture[:100, :130])


@settings(max_examples=40)
@given(
    st.tuples(st.integers(1, 45), st.integers(1, 45)),
    st.integers(2, 15),
    st.integers(1, 7),
    st.sampled_from([1, 3]),
    st.sampled_from(SEAMS),
    st.booleans(),
    st.integers(0, 99),
)
def test_what_the_source_map_calls_a_copy_is_one(
    shape: tuple[int, int],
    block: int,
    border: int,
    channels: int,
    seam: Any,
    subpixel: bool,
    seed: int,
) -> None:
    """For any blocks, seams and shape, pixels of weight 1 are copies of the sample, and other weights stay large."""
    sample = noise(50, 45, channels)
    method = Rsgf(block, min(border, block // 2), seam=seam, subpixel=subpixel)
    made = synthesize(method, sample, shape, Lattice((9.3, 1.2), (-2.1, 10.4)), seed)
    checked_synthesis(made, sample, shape)
    assert made.image.shape == (*shape, channels)
    assert made.source is not None
    x, y, weight = np.moveaxis(made.source, -1, 0)
    copied = weight == 1
    np.testing.assert_array_equal(made.image[copied], sample[y[copied].astype(int), x[copied].astype(int)])
    assert (weight >= (1 / 3 if seam == "blend" else 1) * (1 if not subpixel else 0.25) - 1e-6).all()
    assert ((made.image >= 0) & (made.image <= 1 + 1e-6)).all()


@pytest.mark.parametrize("seam", SEAMS)
@pytest.mark.parametrize("block", [2, 3])
def test_the_smallest_blocks_are_filled(seam: Any, block: int) -> None:
    """Gaps are filled even if their patches lie at the sample's edge and their hole is a pixel wide or empty."""
    sample = noise(12, 13)
    for seed in range(3):
        made = synthesize(Rsgf(block, 1, seam=seam), sample, (24, 25), Lattice((4.3, 0.2), (-0.1, 5.4)), seed)
        checked_synthesis(made, sample, (24, 25))
        assert made.source is not None and (made.source[..., 2] > 0).all()


def test_seams_leave_no_pixel_blended() -> None:
    """At whole pixels, cut along seams, every pixel is a copy."""
    made = synthesize(Rsgf(subpixel=False), noise(128, 128), (150, 170), FRACTIONAL)
    assert made.source is not None
    assert (made.source[..., 2] == 1).all()


def test_every_parameter_changes_something() -> None:
    """Every parameter has an effect on a sample that varies, also in brightness, and is slightly off its lattice."""
    varied = 0.3 * noise(128, 128) + 0.7 * np.tile(noise(24, 30), (6, 5, 1))[:128, :128]
    sample = quantize(varied * np.linspace(0.3, 1, 128, dtype=np.float32)[:, np.newaxis])
    base = synthesize(Rsgf(), sample, (128, 128), FRACTIONAL).image
    changes: list[dict[str, Any]] = [
        {"block": 36}, {"border": 8}, {"match": "ncc"}, {"search": "everywhere"}, {"search": "stochastic"},
        {"tolerance": 0.0}, {"subpixel": False}, {"seam": "blend"},
        {"candidate_fraction": 0.0}, {"candidate_fraction": 1.0}, {"prefer_unused": False},
    ]  # fmt: skip
    for change in changes:
        assert (synthesize(Rsgf(**change), sample, (128, 128), FRACTIONAL).image != base).any(), change


def test_a_sample_smaller_than_a_block_with_borders_is_refused() -> None:
    """The refusal says what would fit."""
    with pytest.raises(Refused, match="block \\+ 2 border <= 50"):
        synthesize(Rsgf(), noise(50, 128), (64, 64), FRACTIONAL)


def test_a_lattice_too_large_for_the_sample_is_refused() -> None:
    """The refusal says that no complete patch is equal to one of the output's."""
    with pytest.raises(Refused, match="the tile is too large"):
        synthesize(Rsgf(), noise(70, 70), (256, 256), Lattice((65, 0), (0, 65)))


@pytest.mark.parametrize(
    "parameters",
    [
        {"border": 0}, {"border": 21}, {"block": 1}, {"tolerance": -1.0},
        {"tolerance": 3.0, "search": "everywhere"}, {"tolerance": 3.0, "search": "stochastic"},
        {"candidate_fraction": -0.1}, {"candidate_fraction": 1.5}, {"candidate_fraction": math.nan},
        {"candidate_fraction": 0.5, "search": "everywhere"},
    ],
)  # fmt: skip
def test_parameters_out_of_range_are_refused(parameters: dict[str, Any]) -> None:
    """The error names the parameter and says what to choose."""
    with pytest.raises(BadInput, match="choose"):
        Rsgf(**parameters)


def test_a_flat_sample_gives_a_flat_output() -> None:
    """A sample without any structure to match or cut around is no error."""
    flat = np.full((60, 60, 1), 0.4, np.float32)
    for match, seam in itertools.product(("ncc", "color"), SEAMS):
        method = Rsgf(block=8, border=2, match=match, seam=seam)  # type: ignore[arg-type]
        made = synthesize(method, flat, (40, 40), FRACTIONAL)
        np.testing.assert_allclose(made.image, 0.4, atol=1e-6)


def test_a_sample_of_less_than_two_periods_works_or_is_refused() -> None:
    """Small blocks work on a sample of 1.5 periods; blocks without an equal patch in it are refused."""
    sample, lattice = noise(60, 60), Lattice((40.3, 0), (3.1, 38.6))
    assert synthesize(Rsgf(block=8, border=2), sample, (90, 90), lattice).image.shape == (90, 90, 3)
    with pytest.raises(Refused, match="choose a smaller block"):
        synthesize(Rsgf(block=24, border=6), sample, (90, 90), lattice)
