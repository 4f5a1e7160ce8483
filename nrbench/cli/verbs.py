"""Commands whose options are the parameters of Python functions, with their defaults and their docstrings."""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import Any

import click

from nrbench.errors import BadInput, require
from nrbench.flags import ARGUMENT, Flag
from nrbench.running.options import Options
from nrbench.storage import find_path, make_writable

_ENTRY = re.compile(r"^(\w[\w, ]*)\n((?:    .*\n|\n)+)", re.MULTILINE)


class Verb(click.Command):
    """A command that is declared by a Python function, and shows what the function returns.

    The parameters of the function that have a :class:`~nrbench.flags.Flag` are the options of the command. So are the
    fields of :class:`~nrbench.Options` if ``show`` has a parameter ``options``, and the parameters of ``show`` itself.

    Parameters
    ----------
    function
        The Python function.
    show
        The function that is called by the command. Its docstring is the help. Besides its own options it may have the
        parameters ``call``, the function with the given arguments, ``options``, and any argument of the function.
    without
        Options that the command does not have.
    """

    def __init__(self, function: Callable[..., Any], show: Callable[..., int | None], without: Collection[str]) -> None:
        self.function, self.wanted = function, list(inspect.signature(show).parameters)
        self.shared = {name: each for name, each in read_flags(function) if name not in without}
        how = read_flags(Options) if "options" in self.wanted else ()
        self.options = {name: each for name, each in how if name not in without}
        self.command_options = dict(read_flags(show))
        declared = {**self.shared, **self.options, **self.command_options}
        about = inspect.getdoc(show) or ""
        name = show.__name__.removesuffix("_command")
        super().__init__(name, callback=show, params=[*declared.values()], help=about.partition("\n\nParameters\n")[0])

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Read the command line into the arguments of ``show``."""
        rest = super().parse_args(ctx, [*self._complete(args)])
        given = {name: value for name, value in ctx.params.items() if value is not None}

        def chosen(names: Collection[str]) -> dict[str, Any]:
            return {name: given[name] for name in names if name in given}

        values: dict[str, Any] = {name: ctx.params[name] for name in {*self.wanted} & {*self.shared}}
        values |= chosen(self.command_options)
        values["call"] = partial(self.function, **chosen(self.shared))
        values["options"] = Options(**chosen(self.options))
        ctx.params = {name: values[name] for name in self.wanted if name in values}
        return rest

    def _complete(self, args: list[str]) -> Iterator[str]:
        """Yield the words of a command line, each option that may stand alone with its value."""
        options: list[Any] = [each for each in self.params if isinstance(each, click.Option)]
        alone = {each.opts[0]: each for each in options if isinstance(each.flag_value, str)}
        for word, following in zip_longest(args, args[1:]):
            yield word
            if word in alone and following not in alone[word].type.choices:
                yield alone[word].flag_value


def verb(
    function: Callable[..., Any] | None = None, without: Collection[str] = ()
) -> Callable[[Callable[..., int | None]], Verb]:
    """Return a decorator that makes a :class:`Verb` of the function that shows the results of a Python function."""
    return lambda show: Verb(function or show, show, without)


def read_flags(function: Callable[..., Any]) -> Iterator[tuple[str, click.Parameter]]:
    """Yield the name of each parameter with a flag, and its option: with its default and its help."""
    aliases, texts = vars(sys.modules[function.__module__]), _first_paragraphs(inspect.getdoc(function) or "")
    for name, parameter in inspect.signature(function).parameters.items():
        alias = aliases.get(str(parameter.annotation))
        for flag in getattr(alias, "__metadata__", ()):
            yield name, _make_option(name, flag, parameter.default, texts.get(name, ""))


def _first_paragraphs(docstring: str) -> Mapping[str, str]:
    """Return the first paragraph of the description of each parameter in a NumPy docstring."""
    found = {}
    for names, text in _ENTRY.findall(f"{docstring}\n"):
        paragraph = inspect.cleandoc(text).partition("\n\n")[0].replace("\n", " ").replace("``", "`")
        found.update(dict.fromkeys(names.split(", "), paragraph))
    return found


def _make_option(name: str, flag: Flag, default: Any, text: str) -> click.Parameter:
    required = default is inspect.Parameter.empty
    kind = _InputPath() if flag.names == ARGUMENT and flag.kind is Path else _click_type(flag)
    given: dict[str, Any] = {"type": kind, "required": required, "metavar": flag.metavar}
    plain = isinstance(default, int | float | str) and default != "" and not flag.alone
    if plain:
        given["default"] = default
    if flag.names == ARGUMENT:
        return click.Argument([name], nargs=-1 if flag.many else 1, **given)
    spelled = [*(flag.names.split() or [f"--{name.replace('_', '-')}"]), name]
    if flag.kind is bool:
        return click.Option(spelled, is_flag=True, help=text)
    if flag.alone:
        given |= {"is_flag": False, "flag_value": flag.alone}
    return click.Option(spelled, multiple=flag.many, help=text, show_default=plain, **given)


class _InputPath(click.Path):
    """A path that is read, see :func:`~nrbench.storage.find_path`."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path that exists."""
        return find_path(Path(str(super().convert(value, param, ctx))))


def _click_type(flag: Flag) -> Any:
    if flag.choices:
        return click.Choice(flag.choices)
    if flag.kind is Path:
        return click.Path(path_type=Path)
    if flag.least is None or flag.kind is str:
        return flag.kind
    limits: dict[str, Any] = {"min": flag.least, "max": flag.most, "min_open": flag.above}
    return click.IntRange(**limits) if flag.kind is int else click.FloatRange(**limits)


def choose_one(given: Mapping[str, object]) -> None:
    """Raise :class:`~nrbench.errors.BadInput` if more than one of some options is given."""
    names = [name for name, value in given.items() if value]
    require(len(names) < 2, f"{' and '.join(names)}: choose one of them")


def check_output(path: Path, *suffixes: str) -> None:
    """Raise :class:`~nrbench.errors.BadInput` unless a file of one of these endings can be written to ``path``.

    A temporary file is made beside it, because the rights of a directory do not tell whether its file system takes
    files.
    """
    if path.suffix.lower() not in suffixes:
        raise BadInput(f"{path}: cannot be written in this format; end the name in {' or '.join(suffixes)}")
    require(path.absolute().parent.is_dir(), f"{path}: its directory does not exist; make it first")
    require(not path.is_dir(), f"{path}: is a directory; give the name of a file")
    make_writable(path.absolute().parent, f"choose another directory for {path.name}")
