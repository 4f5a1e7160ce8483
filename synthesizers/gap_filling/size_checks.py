"""What methods that work with square blocks ask of their parameters and of the sample."""

from __future__ import annotations

from nrbench.errors import BadInput
from nrbench.plugins.forms import Refused

from ..sampling.equal_places import Room, room_for


def check_border(block: int, border: int) -> None:
    """Raise :class:`BadInput` unless ``border`` is from 1 px to half a block."""
    if not 1 <= border <= block // 2:
        raise BadInput(f"border {border} with block {block}; choose a border from 1 to half a block")


def room_with_border(shape: tuple[int, ...], block: int, border: int) -> Room:
    """Return the room that a block with its borders has in a sample of ``shape``.

    Raises
    ------
    Refused
        When the sample does not hold it.
    """
    height, width = shape[:2]
    side = block + 2 * border
    if side > min(height, width):
        raise Refused(
            f"the sample is {width}x{height} px, a block with its borders {side}x{side} px; "
            f"choose block + 2 border <= {min(height, width)}"
        )
    return room_for(side, (height, width))
