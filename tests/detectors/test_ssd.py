import numpy as np
import pytest

from nrbench.detectors.ssdn import shift_ssdn, ssdn


@pytest.mark.parametrize("axis", [0, 1])
def test_the_curve_is_the_papers(axis: int) -> None:
    """At each lag g is the mean squared difference of the two parts that overlap, channels summed: by brute force."""
    image = np.random.default_rng(0).random((23, 17, 3)).astype(np.float32)
    turned = np.moveaxis(image, axis, 0)
    n = len(turned)
    expected = [ssdn(turned[: n - k], turned[k:]) for k in range(n)]
    np.testing.assert_allclose(shift_ssdn(image, axis)[0], expected, atol=1e-6)


def test_unrelated_parts_reach_the_expected_level() -> None:
    """For white noise g is what is expected of unrelated parts, at every lag but 0, where it is 0."""
    g, unrelated = shift_ssdn(np.random.default_rng(0).random((64, 64, 3)).astype(np.float32), 1)
    assert g[0] < 1e-9 and np.abs(g[1:48] / unrelated[1:48] - 1).max() < 0.1
