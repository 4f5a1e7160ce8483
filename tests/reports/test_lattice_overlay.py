from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrbench.lattice.geometry import Lattice
from nrbench.reports.page.lattice_overlay import align_basis, trace_lattice


def _segments(path: str) -> np.ndarray:
    numbers = [float(number) for number in re.findall(r"-?[\d.]+", path)]
    return np.array(numbers).reshape(-1, 2, 2)


def _ray(length: float, turn: float) -> tuple[float, float]:
    return length * np.cos(turn), length * np.sin(turn)


def test_a_square_lattice_has_its_lines() -> None:
    """Lines lie at the lattice's coordinates, and cover the image."""
    segments = _segments(trace_lattice(Lattice((10, 0), (0, 10), (5, 5)), (30, 40)).lines)
    vertical = sorted({x0 for (x0, _), (x1, _) in segments if x0 == x1})
    horizontal = sorted({y0 for (_, y0), (_, y1) in segments if y0 == y1})
    assert (vertical, horizontal) == ([5, 15, 25, 35], [5, 15, 25])
    assert segments[:, :, 0].min() <= -0.5
    assert segments[:, :, 0].max() >= 39.5


@settings(max_examples=40)
@given(st.floats(6, 30), st.floats(0, 3.14), st.floats(0.6, 2.5), st.floats(1.0, 2.1), st.floats(-50, 50))
def test_every_lattice_point_lies_on_two_lines(
    s: float, turn: float, ratio: float, angle: float, origin: float
) -> None:
    """Each lattice point of the image is an end or a crossing of the lines drawn."""
    ray = lambda length, at: (length * np.cos(at), length * np.sin(at))  # noqa: E731
    lattice = Lattice(ray(s, turn), ray(s * ratio, turn + angle), (origin, 3.0)).reduced()
    starts, ends = np.moveaxis(_segments(trace_lattice(lattice, (64, 48)).lines), 1, 0)
    along = (ends - starts) / np.linalg.norm(ends - starts, axis=1, keepdims=True)
    for point in lattice.points((64, 48)):
        offset = point - starts
        distance = np.abs(offset[:, 0] * along[:, 1] - offset[:, 1] * along[:, 0])
        assert (distance < 0.05).sum() >= 2


def test_too_fine_a_lattice_is_not_drawn() -> None:
    """Lines too close to be seen are left out; the vectors stay."""
    drawing = trace_lattice(Lattice((0.5, 0), (0, 0.5)), (256, 256))
    assert drawing.lines == ""
    assert drawing.vectors == ("t1 = (0.50, 0.00)", "t2 = (0.00, 0.50)")


def test_a_detected_lattice_takes_the_true_basis_and_starting_point() -> None:
    """Another basis and origin of the same lattice is drawn exactly like the true one."""
    truth = Lattice((13.1, 22.7), (-13.1, 22.7), (4.0, 7.0)).reduced()
    other = Lattice((26.2, 0.0), (13.1, 22.7), (0.0, 0.0))
    assert set(trace_lattice(align_basis(other, truth, (64, 64)), (64, 64)).lines.split("M")) == set(
        trace_lattice(truth, (64, 64)).lines.split("M")
    )


def test_a_supercell_keeps_its_own_basis() -> None:
    """A lattice that differs from the true one keeps its basis and passes through a true point."""
    truth = Lattice((10, 0), (0, 10), (5, 5))
    drawing = align_basis(Lattice((20, 0), (0, 10)), truth, (64, 64))
    assert drawing.area == pytest.approx(200)
    assert np.allclose(truth.wrap(np.array(drawing.origin) - truth.origin), 0)


def test_without_a_true_lattice_the_origin_stays() -> None:
    """Without a true lattice the origin stays."""
    assert align_basis(Lattice((10, 0), (0, 10), (3, 4)), None, (64, 64)).origin == (3, 4)
