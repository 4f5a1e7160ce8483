"""Texture optimization: the energy falls, and the output consists of what the sample shows."""

import numpy as np
import pytest
from synthesis_cases import synthesize

from nrbench import texture
from nrbench.imaging.convert import quantize
from nrbench.synthesizers.texture_optimization import TextureOptimization


@pytest.mark.parametrize("exponent", [0.8, 2.0])
def test_no_iteration_increases_the_energy(exponent: float) -> None:
    """At one resolution with one size, energies never rise, and the last one is well below the first (section 3.1)."""
    sample = quantize(texture("brick", (64, 64), 3, color=0.2, noise=0.05).image)
    method = TextureOptimization(neighborhood=8, levels=1, iterations=20, exponent=exponent)
    energy = synthesize(method, sample, (80, 72)).extras["energy"]
    assert len(energy) > 3
    assert (np.diff(energy) <= 1e-5 * energy[:-1]).all()
    assert energy[-1] < 0.9 * energy[0]


def test_robust_weights_blur_less() -> None:
    """With r = 0.8 the output is nearer to the sample in contrast than with the mean of squares (section 3.1.1)."""
    sample = quantize(texture("brick", (96, 96), 3, color=0.3, noise=0.1).image)

    def sharpness(exponent: float) -> float:
        made = synthesize(TextureOptimization(exponent=exponent), sample, (128, 128)).image
        return float(np.abs(np.diff(made, axis=0)).mean() / np.abs(np.diff(sample, axis=0)).mean())

    assert sharpness(2.0) < sharpness(0.8) < 1.05
