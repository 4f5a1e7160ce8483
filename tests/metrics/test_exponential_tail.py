import numpy as np
import pytest

from nrbench.metrics.verdict.exponential_tail import ExponentialTail


@pytest.mark.parametrize("count", [50, 500, 5000])
@pytest.mark.parametrize("law", ["exponential", "normal"])
def test_false_alarms_do_not_grow_with_the_number_of_windows(count: int, law: str) -> None:
    """The largest surprisal of an image without defects exceeds x with a probability of about exp(-x) at most."""
    rng, worst = np.random.default_rng(0), []
    for _ in range(300):
        draw = rng.exponential if law == "exponential" else rng.normal
        worst.append(ExponentialTail.fit(draw(size=1000)).surprisal(draw(size=count)).max())
    for x in (2.0, 3.0):
        assert np.mean(np.array(worst) > x) < 2 * np.exp(-x)


def test_surprisal_grows_with_the_value_and_shrinks_with_the_excesses() -> None:
    """Larger values have a larger surprisal. A tail that is estimated from fewer excesses gives a smaller one."""
    tail, thin = (
        ExponentialTail.fit(np.random.default_rng(1).exponential(size=1000), overlap=overlap) for overlap in (1, 20)
    )
    far = np.array([5.0, 9.0, 20.0])
    assert np.all(np.diff(tail.surprisal(far)) > 0)
    assert np.all(thin.surprisal(far) < tail.surprisal(far))


def test_constant_references_have_a_tail() -> None:
    """If all references are equal, the surprisal is finite and still increases with the value."""
    surprisal = ExponentialTail.fit(np.zeros(40)).surprisal(np.array([0.0, 1.0]))
    assert np.isfinite(surprisal).all()
    assert surprisal[0] < surprisal[1]
