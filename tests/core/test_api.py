"""The Python functions: what they accept as a lattice."""

from __future__ import annotations

from typing import Any

import pytest

from nrbench.api import as_lattice
from nrbench.errors import BadInput
from nrbench.lattice.geometry import Lattice


def test_a_lattice_may_be_given_in_any_form() -> None:
    """Vectors, vectors with an origin, text and a lattice give the same lattice; None gives none."""
    lattice = Lattice((27.3, 0), (13.65, 12.2), (3, 4))
    vectors = ((27.3, 0), (13.65, 12.2), (3, 4))
    assert as_lattice(lattice) == as_lattice(vectors) == as_lattice("27.3,0,13.65,12.2,3,4") == lattice
    assert as_lattice(vectors[:2]) == as_lattice("27.3,0,13.65,12.2")  # type: ignore[arg-type]
    assert as_lattice(None) is None


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (((32, 0),), r"lattice \(\(32, 0\),\): give two vectors"),
        ((32, 0, 0, 24), "give two vectors"),
        (32, "lattice 32: give two vectors"),
        ((32, 24), "t1 is 32; give two numbers"),
        (((1.5, 0), (0, 24)), "repeats every 1.5 px"),
        (Lattice((1.5, 0), (0, 24)), "repeats every 1.5 px"),
        ("1.5,0,0,24", "lattice '1.5,0,0,24': repeats every 1.5 px"),
    ],
)
def test_what_is_no_lattice_is_refused(given: Any, message: str) -> None:
    """The error shows what was given and says what to give."""
    with pytest.raises(BadInput, match=message):
        as_lattice(given)
