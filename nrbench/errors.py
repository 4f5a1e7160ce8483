"""The error for input that the user can correct."""

from __future__ import annotations

from collections.abc import Callable


class BadInput(ValueError):
    """Input that cannot be used: the message says what, where, and what to do.

    The command line prints it on one line and exits with code 2.
    """


def checker(who: str) -> Callable[[bool, str], None]:
    """Return a check, which raises :class:`BadInput` with ``who`` in front if a condition does not hold."""

    def check(holds: bool, message: str) -> None:
        if not holds:
            raise BadInput(f"{who}: {message}")

    return check
