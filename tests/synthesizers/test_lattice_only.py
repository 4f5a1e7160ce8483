import numpy as np

from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Synthesizer, Task
from nrbench.synthesizers.lattice_only import LatticeOnly

SAMPLE = np.random.default_rng(0).random((6, 5, 3), np.float32)


def test_the_lattice_is_handed_on() -> None:
    """The method reports the given lattice as the lattice used; without one it reports None."""
    lattice = Lattice((3.0, 0.0), (0.0, 2.0))
    for given in (lattice, None):
        assert LatticeOnly().synthesize(Task(SAMPLE, (4, 4), given, np.random.default_rng(0))).lattice is given


def test_the_output_is_the_sample_repeated_or_cut() -> None:
    """Pixel (x, y) is the sample's at (x mod width, y mod height)."""
    made = LatticeOnly().synthesize(Task(SAMPLE, (13, 4), None, np.random.default_rng(0)))
    assert made.image.shape == (13, 4, 3)
    np.testing.assert_array_equal(made.image[[0, 6, 12]], SAMPLE[[0, 0, 0], :4])
    np.testing.assert_array_equal(made.image[:6], SAMPLE[:, :4])


def test_it_is_a_reference_that_needs_no_lattice() -> None:
    """It has the form, is never ranked, and is not refused where a detector finds nothing."""
    assert isinstance(LatticeOnly(), Synthesizer)
    assert LatticeOnly.reference and LatticeOnly.uses_lattice and not LatticeOnly.needs_lattice
