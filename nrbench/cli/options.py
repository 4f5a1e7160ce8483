"""What the options of several commands share: limits, lists of names, and paths of outputs."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from nrbench.errors import BadInput

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


def split_names(names: str | None) -> list[str]:
    """Return the names of a list with commas; an empty list for None."""
    return [name.strip() for name in (names or "").split(",") if name.strip()]


def check_output(path: Path) -> None:
    """Raise :class:`~nrbench.errors.BadInput` unless a picture can be written to ``path``.

    A temporary file is made beside it, because the rights of a directory do not tell whether its file system takes
    files.
    """
    if path.suffix.lower() != ".png":
        raise BadInput(f"{path}: outputs are PNG; end the name in .png")
    if not path.absolute().parent.is_dir():
        raise BadInput(f"{path}: its directory does not exist; make it first")
    if path.is_dir():
        raise BadInput(f"{path}: is a directory; give the name of a file")
    try:
        with tempfile.TemporaryFile(dir=path.absolute().parent):
            pass
    except OSError as error:
        raise BadInput(f"{path}: cannot be written: {error.strerror or error}; choose another directory") from None
