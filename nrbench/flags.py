"""How parameters of Python functions are written on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, NamedTuple


class Flag(NamedTuple):
    """How a parameter is written on the command line: ``--size WxH``.

    A parameter whose type is an alias with a flag is an option, see :mod:`nrbench.cli.verbs`. Its default is that of
    the signature, and its help is the first paragraph of its description in the docstring.

    Parameters
    ----------
    names
        The option, such as ``"-o --output"``; if empty, ``--`` and the name of the parameter.
    metavar
        The word for the value in the help.
    kind
        The type of the value; a ``bool`` is an option without a value.
    least, most
        The range of a number.
    above
        Whether ``least`` itself is no value.
    many
        Whether it may be given several times.
    choices
        The words of which one is given.
    alone
        The one that is meant if the option has no value.
    """

    names: str = ""
    metavar: str | None = None
    kind: type = str
    least: float | None = None
    most: float | None = None
    above: bool = False
    many: bool = False
    choices: tuple[str, ...] = ()
    alone: str = ""


ARGUMENT = "(position)"
"""The name of a flag that has none: its value is known by its position."""
Switch = Annotated[bool, Flag(kind=bool)]
Json = Annotated[bool, Flag("--json", kind=bool)]
Number = Annotated[int, Flag(kind=int, least=0)]
OptionalNumber = Annotated[int | None, Flag(kind=int, least=0)]
Count = Annotated[int | None, Flag(kind=int, least=1)]
Jobs = Annotated[int, Flag(kind=int, least=0)]
Seconds = Annotated[float, Flag(metavar="S", kind=float, least=0, most=1e7, above=True)]
Mebibytes = Annotated[float, Flag(metavar="MiB", kind=float, least=1, most=1e7)]
Address = Annotated[str | None, Flag(metavar="tcp://HOST:PORT")]
OtherRun = Annotated[Path | None, Flag(metavar="RUN", kind=Path)]
Names = Annotated[str, Flag(metavar="NAME,...")]
