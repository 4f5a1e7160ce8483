import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthesis_cases import noise, synthesize

from nrbench.errors import BadInput
from nrbench.imaging.convert import quantize
from nrbench.plugins.forms import Refused
from nrbench.running.output_checks import checked_synthesis
from nrbench.synthesizers.ann_pixel import AnnPixel


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


@settings(max_examples=40)
@given(
    st.tuples(st.integers(1, 40), st.integers(1, 40)),
    st.integers(2, 10),
    st.sampled_from([1, 3]),
    st.sampled_from(["ann", "exhaustive", "k-coherence"]),
    st.sampled_from([0.0, 1.0, 2.5]),
)
def test_every_pixel_is_the_samples_and_the_map_says_which(
    shape: tuple[int, int], neighborhood: int, channels: int, search: Any, coherence: float
) -> None:
    """For all parameters and shapes, every pixel is a copy, and the source map is right."""
    sample = noise(14, 19, channels)
    made = checked_synthesis(
        synthesize(AnnPixel(neighborhood, search=search, coherence=coherence), sample, shape), sample, shape
    )
    assert made.source is not None
    x, y, weight = np.moveaxis(made.source, -1, 0)
    assert (weight == 1).all()
    np.testing.assert_array_equal(made.image, sample[y.astype(int), x.astype(int)])


def test_every_parameter_changes_something() -> None:
    """Each parameter changes the output."""
    sample = quantize(0.8 * np.tile(noise(9, 10), (5, 5, 1)) + 0.2 * noise(45, 50, seed=1))
    coherent = {"search": "k-coherence", "coherence": 0.0}
    pairs: list[tuple[dict[str, Any], dict[str, Any]]] = [
        ({}, {"neighborhood": 5}), ({}, coherent), ({}, {"coherence": 1.0}), ({}, {"dimensions": 4}),
    ]  # fmt: skip
    for one, other in pairs:
        first, second = (synthesize(AnnPixel(**each), sample, (50, 50)).image for each in (one, other))
        assert (first != second).any(), other


def test_a_sample_smaller_than_the_window_is_refused() -> None:
    """The message names the sizes of the sample and of the window, whose rows below the pixel do not count."""
    with pytest.raises(Refused, match="10x6 px, the sample is 30x5 px"):
        synthesize(AnnPixel(10), noise(5, 30), (20, 20))
    assert (synthesize(AnnPixel(10), noise(6, 10), (9, 9)).image == noise(6, 10)[5, 5]).all()


@pytest.mark.parametrize(
    "parameters",
    [
        {"neighborhood": 1}, {"neighborhood": 11}, {"coherence": 0.5}, {"coherence": math.nan}, {"dimensions": -1},
    ],
)  # fmt: skip
def test_parameters_that_make_no_sense_are_refused(parameters: dict[str, Any]) -> None:
    """The message names a parameter that is out of range or has no effect, and valid values."""
    with pytest.raises(BadInput, match="choose"):
        AnnPixel(**parameters)
