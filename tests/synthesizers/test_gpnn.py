"""Generative patch nearest neighbors: small alpha makes the output complete, and a flat sample stays flat."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from synthesis_cases import synthesize

from nrbench.imaging.convert import Image, quantize
from nrbench.synthesizers.gpnn import Gpnn


def distances_to_output(sample: Image, output: Image) -> np.ndarray:
    """Return the mean squared difference of each patch of the sample from the nearest patch of the output."""
    ours, theirs = (
        sliding_window_view(each.astype(float), (7, 7), (0, 1)).reshape(-1, 147) for each in (sample, output)
    )
    squares = (ours**2).sum(1)[:, np.newaxis] + (theirs**2).sum(1) - 2 * ours @ theirs.T
    return np.asarray(np.maximum(squares.min(1), 0) / 147)


def test_a_small_alpha_makes_the_output_complete() -> None:
    """Each patch of gray grain with one red square is found in the output, and without completeness some are not."""
    rng = np.random.default_rng(0)
    sample = quantize((0.5 + 0.03 * rng.standard_normal((48, 48, 3))).astype(np.float32))
    sample[20:29, 30:39] = 0.9, 0.2, 0.1
    complete, without = (
        distances_to_output(sample, synthesize(Gpnn(alpha=alpha), sample, (64, 64)).image) for alpha in (0.005, 0)
    )
    assert complete.max() < 0.003
    assert without.max() > 0.1
    assert complete.mean() < 0.2 * without.mean()


def test_the_sample_is_found_better_the_smaller_alpha() -> None:
    """With alpha = 0.0005 patches of the sample are nearer to those of the output than with alpha = 1 (section 3.2)."""
    sample = quantize(np.random.default_rng(1).random((40, 40, 3), np.float32).repeat(2, 0)[:40])
    small, large = (
        distances_to_output(sample, synthesize(Gpnn(alpha=alpha), sample, (56, 56)).image).mean()
        for alpha in (0.0005, 1)
    )
    assert small < large
