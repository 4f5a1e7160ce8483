"""The benchmark of the limits keeps the results that a limit cannot change, and no others."""

from types import ModuleType

import pytest


def test_only_what_read_the_limit_is_computed_again(script: ModuleType) -> None:
    """A result is computed again if it, or a part of it, read the changed limit; afterwards it is as before."""
    memory, made, values = script.Memory(), [], {"A": 1.0, "B": 1.0}

    def read(name: str) -> float:
        made.append(name)
        memory.note(name)
        return values[name]

    def whole() -> float:
        made.append("whole")
        return sum(memory.recall(name, None, lambda name=name: read(name)) for name in "AB")

    def score() -> float:
        made.clear()
        return float(memory.recall("whole", None, whole))

    assert (score(), made) == (2, ["whole", "A", "B"])
    assert (score(), made) == (2, [])
    values["A"] = 5
    memory.change("A")
    assert (score(), made) == (6, ["whole", "A"])
    assert (score(), made) == (6, [])
    values["A"] = 1
    memory.change("C")
    assert (score(), made) == (2, [])


def test_of_a_share_near_1_the_rest_is_multiplied(script: ModuleType) -> None:
    """0.999 becomes 0.9992 and 0.99875, no share above 1; other limits are multiplied, whole numbers rounded."""
    changes = {(name, factor): value for name, factor, value in script.changed_limits(["TOP", "JND", "PLACES"])}
    assert changes["TOP", 0.8] == pytest.approx(0.9992) and changes["TOP", 1.25] == pytest.approx(0.99875)
    assert changes["JND", 1.25] == 2.5 and changes["PLACES", 0.8] == 6
