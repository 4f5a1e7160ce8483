"""Claims about threads that pass over and under each other."""

from __future__ import annotations

import numpy as np

from nrbench.datasets_procedural.modelling.threads import interlaced
from nrbench.datasets_procedural.weave import Weave

DRAFT = np.array([[True, True, False], [False, True, True]])


def test_the_draft_is_followed() -> None:
    """At each crossing the thread is seen that the draft puts above, whole, and the other not at all."""
    y, x = np.mgrid[0:4, 0:6] * 10.0
    warp, weft = interlaced(x, y, (10.0, 10.0), 2.0, DRAFT)
    expected = np.tile(DRAFT, (2, 2))
    np.testing.assert_array_equal(warp.coverage, expected)
    np.testing.assert_array_equal(weft.coverage, ~expected)
    np.testing.assert_array_equal(warp.index, np.tile(np.arange(6), (4, 1)))


def test_threads_rise_and_dive() -> None:
    """A thread is lighter where it lies above, and as light all along where it stays above two others."""
    x = np.linspace(0, 30, 61)
    weft = interlaced(x, np.zeros(61), (10.0, 10.0), 2.0, ~DRAFT)[1]
    assert weft.shade[0] == weft.shade[10] == weft.shade[20] == 1.0 and weft.shade[40] < 0.6


def test_drafts_of_weaves() -> None:
    """In a twill each thread floats over two; a basket weave moves pairs; a herringbone turns back."""
    grid = np.mgrid[0:8, 0:8] * 10.0
    above = {}
    for draft in ("plain", "twill", "basket", "herringbone"):
        cloth = Weave(warp=10, weft=10, gap=2, draft=draft)  # type: ignore[arg-type]
        above[draft] = cloth.pattern(grid[1], grid[0]).layers[0].coverage > 0.5
    assert (above["plain"] != np.roll(above["plain"], 1, 0)).all()
    for draft in ("twill", "basket", "herringbone"):
        assert (above[draft] == np.roll(above[draft], 2, 0)).mean() == 0 and above[draft].mean() == 0.5
    assert (above["twill"] == np.roll(np.roll(above["twill"], 1, 0), -1, 1)).all()
    assert (above["basket"][::2] == above["basket"][1::2]).all()
    assert (above["herringbone"][:, 1:4] == above["herringbone"][:, 7:4:-1]).all()
