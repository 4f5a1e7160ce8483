"""Checks of parameters: one clear error, which says what to give."""

from __future__ import annotations

from typing import Any

from nrbench.errors import BadInput
from nrbench.plugins.forms import Shape

LARGEST_AREA = 1 << 26
"""px^2 of the largest picture that a model draws: some 8000 x 8000, which takes a few GiB."""


def check(holds: bool, message: str) -> None:
    """Raise :class:`BadInput` with ``message`` unless ``holds``."""
    if not holds:
        raise BadInput(message)


def check_sizes(model: Any, **least: float) -> None:
    """Refuse lengths (fields of ``model``, by name, each with its least value) that are too small, huge or NaN."""
    for name, low in least.items():
        size = getattr(model, name)
        check(low <= size < 1e4, f"{name} is {size} px; give at least {low:g}, less than 10000")


def check_strengths(model: Any, *names: str) -> None:
    """Refuse strengths outside [0, 1]."""
    for name in names:
        check(0 <= getattr(model, name) <= 1, f"{name} is {getattr(model, name)}; give a strength from 0 to 1")


def check_choice(model: Any, name: str, known: Any) -> None:
    """Refuse a word that is none of the known ones."""
    word = getattr(model, name)
    check(word in known, f"{name} is {word!r}; give one of: {', '.join(map(str, known))}")


def check_shape(shape: Shape) -> None:
    """Refuse a picture without pixels, or with more than can be drawn."""
    height, width = shape
    what = f"shape {width}x{height} px"
    check(min(shape) >= 1, f"{what} has no pixels; give at least 1 a side")
    check(height * width <= LARGEST_AREA, f"{what} is too large to draw; give at most {LARGEST_AREA} px in all")
