"""Claims about the plain weave."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from nrbench.datasets_procedural.weave import Weave
from nrbench.errors import BadInput

EVEN = Weave(warp=12, weft=10, gap=2, phase=(0, 0), color=0, intensity=0, noise=0)


def test_threads_alternate() -> None:
    """Warp and weft lie above in turn, like a chess-board, and between threads it is dark."""
    image = EVEN.render((41, 49), np.random.default_rng(0)).image
    crossings = image[::10, ::12, 0]
    chess = np.indices(crossings.shape).sum(0) % 2 == 0
    assert np.ptp(crossings[chess]) < 1e-6 and np.ptp(crossings[~chess]) < 1e-6
    assert crossings[~chess].min() - crossings[chess].max() > 0.2
    assert image[5, 6].max() < 0.25


def test_threads_are_round() -> None:
    """A thread is lightest along its middle, and darker towards its sides and where it dives."""
    image = EVEN.render((30, 30), np.random.default_rng(0)).image[..., 0]
    across, along = image[0, 0:5], image[0:5, 0]
    assert (np.diff(across) < 0).all() and (np.diff(along) < 0).all()


def test_a_thread_keeps_its_color() -> None:
    """The factor belongs to the thread: the same at every crossing where it lies above."""
    weave = Weave(warp=12, weft=10, gap=2, phase=(0, 0), color=0.5, intensity=0.2, noise=0)
    texture = weave.render((101, 121), np.random.default_rng(0))
    assert texture.ideal is not None
    ratio = (texture.image / texture.ideal)[::10, ::12]
    for i in range(ratio.shape[1]):
        assert np.ptp(ratio[i % 2 :: 2, i], axis=0).max() < 1e-5
    for j in range(ratio.shape[0]):
        assert np.ptp(ratio[j, (j + 1) % 2 :: 2], axis=0).max() < 1e-5
    assert ratio[0, ::2].std() > 0.1


def test_equal_spacings_still_need_two_threads() -> None:
    """With square crossings the smallest lattice is the centred one, of area 2 p^2."""
    lattice = Weave(warp=13.3, weft=13.3).render((32, 32), np.random.default_rng(0)).lattice
    assert lattice is not None
    assert lattice.area == pytest.approx(2 * 13.3**2) and lattice.s == pytest.approx(13.3 * np.sqrt(2))


@pytest.mark.parametrize("parameters", [{"gap": 0.0}, {"warp": 3.0}, {"weft": float("nan")}])
def test_bad_sizes(parameters: dict[str, Any]) -> None:
    """A gap under one px, and a thread that the gaps swallow, are refused with the least size."""
    with pytest.raises(BadInput, match="give at least"):
        Weave(**parameters)
