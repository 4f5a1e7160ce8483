"""The options that limit the wall time and the memory of one call of a plugin."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

F = TypeVar("F", bound=Callable[..., Any])


def limit_options(work: str) -> Callable[[F], F]:
    """Return a decorator that adds ``--timeout`` and ``--memory`` to a command. ``work`` names what they limit."""

    def add(command: F) -> F:
        memory = click.option(
            "--memory",
            type=click.FloatRange(1, 1e7),
            default=4096.0,
            show_default=True,
            metavar="MiB",
            help=f"Limit of the memory of one {work}, in addition to that of an idle worker.",
        )
        timeout = click.option(
            "--timeout",
            type=click.FloatRange(0, 1e7, min_open=True),
            default=120.0,
            show_default=True,
            metavar="S",
            help=f"Limit of the wall time of one {work}, seconds.",
        )
        return timeout(memory(command))

    return add
