"""The one error that is the user's to mend."""

from __future__ import annotations

from collections.abc import Callable


class BadInput(ValueError):
    """Input that cannot be used: the message says what, where, and what to do.

    The command line prints it on one line and exits with code 2.
    """


def checker(who: str) -> Callable[[bool, str], None]:
    """Return a function that raises :class:`BadInput`, naming ``who``, where what it is told does not hold."""

    def check(holds: bool, message: str) -> None:
        if not holds:
            raise BadInput(f"{who}: {message}")

    return check
