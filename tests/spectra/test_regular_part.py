import numpy as np

import nrbench
from nrbench.lattice.geometry import Lattice
from nrbench.spectra.harmonic_groups import (
    LEAST_DISTANCE,
    fold_frequencies,
)
from nrbench.spectra.harmonics import analyze
from nrbench.spectra.regular_part import line_floor
from nrbench.spectra.spectrum import Spectrum

SIZE = np.array([128.0, 128.0])


def test_weak_signs_of_a_larger_tile_count() -> None:
    """English bond, whose courses differ little, has its own lattice, not the four times finer one of its headers."""
    texture = nrbench.texture("brick", shape=(160, 160), seed=3, bond="english", color=0.18, intensity=0.25, noise=0.04)
    found = analyze(texture.image.astype(np.float64), harmonics="tied")
    assert texture.lattice is not None and found.groups == (2,)
    assert Lattice.from_basis(np.linalg.inv(found.fundamentals).T).is_equivalent(texture.lattice, 0.05)


def test_no_two_waves_of_a_mask_are_near() -> None:
    """Not even those that pixels fold back from beyond Nyquist: each is 3/4 bin from all others and their mirrors."""
    texture = nrbench.texture("weave", seed=4, color=0.3, intensity=0.2, noise=0.03)
    seen = fold_frequencies(analyze(texture.image.astype(np.float64), harmonics="tied").frequencies)
    both = np.concatenate([seen, -seen])
    apart = np.hypot(*np.moveaxis(fold_frequencies(both[:, np.newaxis] - both) * 128, 2, 0)) + 9 * np.eye(len(both))
    assert len(seen) > 100 and apart.min() >= LEAST_DISTANCE


def test_the_floor_of_a_line_is_its_own() -> None:
    """On a line of the spectrum where rows vary at random the floor is that of the rows; beside it, of the noise."""
    rng = np.random.default_rng(0)
    rows = np.tile(rng.standard_normal((128, 1, 1)), (1, 128, 1)) + 0.01 * rng.standard_normal((128, 128, 1))
    power = np.abs(Spectrum(rows).bins()) ** 2
    on, beside = line_floor(power, (128, 128), np.array([(0.0, 0.2), (0.2, 0.2)]), np.zeros((0, 2)))[:, 0]
    assert 0.3 < on / 128**3 < 3 and 0.3 < beside / (0.01**2 * 128**2) < 3
