"""The error for input that the user can correct, and the words for the errors of plugins."""

from __future__ import annotations

import errno
import math
import re
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")


class BadInput(ValueError):
    """Input that cannot be used: the message says what, where, and what to do.

    The command line prints it on one line and exits with code 2.

    Examples
    --------
    >>> from nrbench import BadInput, texture
    >>> try:
    ...     texture("bricks")
    ... except BadInput as error:
    ...     print(error)
    dataset 'bricks' is not known (did you mean 'brick'?); see `nrbench list datasets`
    """


def require(holds: bool, message: str) -> None:
    """Raise :class:`BadInput` with a message unless a condition holds."""
    if not holds:
        raise BadInput(message)


def require_ranges(owner: object, **ranges: tuple[float, float]) -> None:
    """Raise :class:`BadInput` unless each attribute is None, or a finite number from the lowest to the highest one."""
    for name, (low, high) in ranges.items():
        value = getattr(owner, name)
        allowed = f"from {low:g} to {high:g}" if high < math.inf else f"{low:g} or more"
        require(value is None or (low <= value <= high and value < math.inf), f"{name} {value}; choose {allowed}")


def checker(who: str) -> Callable[[bool, str], None]:
    """Return a check, which raises :class:`BadInput` with ``who`` in front if a condition does not hold."""

    def check(holds: bool, message: str) -> None:
        if not holds:
            raise BadInput(f"{who}: {message}")

    return check


_CONTROL = re.compile(
    r"\x1b\[[0-?]*[ -/]*[@-~]|\x1b\][^\x07\x1b]*(?:\x07|\x1b\\)"
    r"|[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]"
)
_CALLERS = [Path(__file__).parent / folder for folder in ("running", "suites", "plugins", "authoring", "calling")]
_STORAGE = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EROFS) if sys.platform != "win32" else (errno.ENOSPC,)


def strip_control(content: T) -> T:
    """Return text without terminal escapes, control characters and marks that turn the direction of text.

    Line breaks and tabs stay. Of a list or mapping, as JSON holds them, all texts in it are so treated.
    """
    stripped: Any = content
    if isinstance(content, str):
        stripped = _CONTROL.sub("", content.replace("\r\n", "\n"))
    elif isinstance(content, list):
        stripped = [strip_control(part) for part in content]
    elif isinstance(content, dict):
        stripped = {strip_control(key): strip_control(part) for key, part in content.items()}
    return stripped  # type: ignore[no-any-return]


def describe_error(error: BaseException) -> str:
    """Return the type and the message of an error, and the line of the plugin that raised it.

    The line is the last one in the first file that the modules which call plugins (:data:`_CALLERS`) have entered. The
    message may itself raise an error.
    """
    try:
        text = strip_control(str(error))
    except BaseException as second:
        text = f"its message raised {type(second).__name__}"
    frames = traceback.extract_tb(error.__traceback__)
    last = max((i for i, frame in enumerate(frames) if Path(frame.filename).parent in _CALLERS), default=-1)
    own = [frame for frame in frames[last + 1 :] if last >= 0 and frame.filename == frames[last + 1].filename]
    where = f" ({Path(own[-1].filename).name}, line {own[-1].lineno})" if own else ""
    return f"{type(error).__name__}{': ' if text else ''}{text}{where}"


def storage_fault(error: BaseException) -> OSError | None:
    """Return the error of a full, broken or read-only disk that is, or led to, an error; None if there is none."""
    seen: BaseException | None = error
    while seen is not None:
        if isinstance(seen, OSError) and seen.errno in _STORAGE:
            return seen
        seen = seen.__cause__ or seen.__context__
    return None
