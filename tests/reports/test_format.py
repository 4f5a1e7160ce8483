from __future__ import annotations

import pytest

from nrbench.reports.statistics import format as text_format
from nrbench.reports.statistics.estimates import Estimate


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"), (float("nan"), "–"), (True, "yes"), (False, "no"), (0.0, "0.00"), (0.876, "0.88"), (1, "1.00"),
        (0.0123, "0.012"), (-0.5, "−0.50"), (12.34, "12.3"), (1234.5, "1234"), (3.2e7, "3.20e+07"), (2e-5, "2.0e−05"),
    ],
)  # fmt: skip
def test_numbers_read_well(value: float | None, text: str) -> None:
    """Numbers are short at every size."""
    assert text_format.format_number(value) == text


def test_counts_say_what_was_left_out() -> None:
    """A success rate says k of n, and how many textures it leaves out."""
    assert text_format.format_successes(Estimate(0.875, 0.5, 1.0, 8, 8)) == "7 of 8"
    assert text_format.format_successes(Estimate(0.875, 0.5, 1.0, 8, 9)) == "7 of 8, 1 left out"
