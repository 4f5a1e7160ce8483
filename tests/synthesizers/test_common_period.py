import numpy as np
import pytest

from nrbench.errors import BadInput
from nrbench.lattice.geometry import Lattice
from nrbench.synthesizers.masks.texture_mask import find_common_period


def dual(*basis: tuple[float, float]) -> np.ndarray:
    """Return the fundamentals of a lattice."""
    return np.linalg.inv(np.array(basis)).T


def test_a_lattice_has_its_own_rectangle() -> None:
    """Of a running bond it is a brick wide and two courses high, within the rounding."""
    found = find_common_period([dual((27.3, 0.0), (13.65, 12.2))])
    assert found is not None and found.size == (27, 24)
    assert found.error == pytest.approx(0.4) and found.free == (False, False)


def test_stripes_leave_a_side_free() -> None:
    """Along stripes any length is a period: that side is as long as the other."""
    found = find_common_period([np.array([[0.0, 1 / 16.2]])])
    assert found is not None and found.size == (16, 16) and found.free == (True, False)


def test_several_groups_share_a_period() -> None:
    """Periods of 6 and 10 px across, of two lattices, are both periods of 30; without one within the limit, None."""
    groups = [dual((6.0, 0.0), (0.0, 5.0)), dual((10.0, 0.0), (0.0, 7.0))]
    found = find_common_period(groups, 0.1)
    assert found is not None and found.size == (30, 35) and found.error == pytest.approx(0)
    assert find_common_period(groups, 0.1, 29) is None


def test_its_sides_are_lattice_vectors() -> None:
    """Whatever the lattice, both sides are within the tolerance of lattice vectors, and the error is that distance."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        basis = rng.uniform(6, 20, (2, 2)) * [[1, 0.3], [-0.2, 1]]
        found = find_common_period([np.linalg.inv(basis).T], 0.5)
        if found is None:
            continue
        lattice = Lattice.from_basis(basis)
        misses = np.hypot(*lattice.wrap(found.sides).T)
        assert misses.max() == pytest.approx(found.error, abs=1e-9) and found.error <= 0.5


def test_nothing_has_no_period() -> None:
    """Without a group there is no rectangle."""
    assert find_common_period([]) is None


@pytest.mark.parametrize(
    ("tolerance", "limit", "hint"), [(-1.0, 99, "less than"), (9.0, 99, "less than"), (0.5, 0, "limit")]
)
def test_bad_limits_are_refused(tolerance: float, limit: int, hint: str) -> None:
    """Each error says what to give."""
    with pytest.raises(BadInput, match=hint):
        find_common_period([dual((10.0, 0.0), (0.0, 10.0))], tolerance, limit)
