"""The command ``nrbench``: a group of verbs. The module of a verb is imported when the verb is used."""

from __future__ import annotations

import contextlib
import gc
import importlib
import io
import itertools
import os
import sys
import warnings
from collections.abc import Mapping
from typing import Any, TextIO, cast

import click

COLLECT_AFTER = 500_000
"""New objects after which garbage is collected. Imports alone make about 300 000, and none of them is garbage."""
VERBS: Mapping[str, str] = {
    **dict.fromkeys(("run", "plan", "report", "status", "label", "compare", "site", "audit"), "run_commands"),
    **dict.fromkeys(("list", "show"), "plugin_commands"),
    "synth": "picture_commands",
    "sheet": "run_commands",
    **dict.fromkeys(("lattice", "score", "render"), "picture_commands"),
    **dict.fromkeys(("check", "new"), "plugin_commands"),
}
"""Each verb, and the module of :mod:`nrbench.cli` that holds its function ``VERB_command``."""


class Verbs(click.Group):
    """A group that imports the module of a verb only when the verb is used."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the verbs in the order of :data:`VERBS`."""
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a verb's module and return its command."""
        if cmd_name not in VERBS:
            return None
        module = importlib.import_module(f"nrbench.cli.{VERBS[cmd_name]}")
        return getattr(module, f"{cmd_name}_command")  # type: ignore[no-any-return]

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write what each verb does: the first sentence of its help."""
        commands = {verb: self.get_command(ctx, verb) for verb in VERBS}
        texts = {verb: " ".join((command.help or "").split()) for verb, command in commands.items() if command}
        with formatter.section("Commands"):
            formatter.write_dl([(verb, f"{text.partition('. ')[0].rstrip('.')}.") for verb, text in texts.items()])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command of the verb; for an unknown verb, raise an error that names the nearest one."""
        if args and not args[0].startswith("-") and args[0] not in VERBS:
            from nrbench.plugins.parameters import nearest

            raise click.UsageError(f"verb {args[0]!r} is not known{nearest(args[0], VERBS)}")
        return super().resolve_command(ctx, args)


def _show_version(context: click.Context, _: click.Parameter, wanted: bool) -> None:
    if wanted:
        from nrbench.version import describe_version

        click.echo(f"nrbench, version {describe_version()}")
        context.exit()


@click.group(cls=Verbs, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.option(
    "--version", is_flag=True, is_eager=True, expose_value=False, callback=_show_version, help="Show the version."
)
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
@click.option(
    "--plugin", "plugin_files", multiple=True, metavar="FILE.py", help="Load plugins from FILE.py; repeatable."
)
def nrbench(debug: bool, plugin_files: tuple[str, ...]) -> None:
    """Compare methods of near-regular texture synthesis.

    nrbench draws textures whose lattices are known, runs methods on them, and scores the regularity, the randomness
    and the cost of the outputs.
    """
    if plugin_files:
        from nrbench import plugins

        for file in plugin_files:
            plugins.add_file(file)


class _TerminalText:
    """Standard output without control characters, which names, messages and logs of strangers may hold.

    Parameters
    ----------
    stream
        Where the text goes.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write text without what would control a terminal."""
        from nrbench.errors import strip_control

        return self._stream.write(strip_control(text))


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit.

    The exit code is 0 on success, 1 if a cell, report or detector failed, 2 for wrong usage or bad input, and 130
    after an interruption. ``arguments`` are those of the process if None.
    """
    if arguments is None:
        gc.set_threshold(COLLECT_AFTER)  # only in the process of a command: a program that calls main keeps its own
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # it is closed
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w"))
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    words = move_global_options(list(sys.argv[1:] if arguments is None else arguments))
    try:
        if any("\0" in word for word in words):
            raise click.UsageError("an argument holds a zero byte, which no name has")
        with warnings.catch_warnings(), contextlib.redirect_stdout(cast("TextIO", _TerminalText(sys.stdout))):
            warnings.showwarning = _print_warning
            code = nrbench.main(args=words, prog_name="nrbench", standalone_mode=False)
    except (KeyboardInterrupt, click.Abort):
        code = _print_error("interrupted" + "; run the same command again to resume" * ("run" in words), 130)
    except click.exceptions.NoArgsIsHelpError as help_text:
        print(help_text.format_message())
        code = 0
    except click.ClickException as error:
        code = _print_error(f"{error.format_message().rstrip('.')}; see `{_command_path(error)} --help`", 2)
    except Exception as error:
        code = _report_exception(error, "--debug" in words)
    sys.exit(code if isinstance(code, int) else 0)


def move_global_options(arguments: list[str]) -> list[str]:
    """Return the arguments with every ``--debug`` and ``--plugin FILE`` moved before the verb."""
    front: list[str] = []
    rest: list[str] = []
    words = iter(arguments)
    for word in words:
        if word == "--":
            rest += [word, *words]
        elif word == "--debug" or word.startswith("--plugin="):
            front.append(word)
        elif word == "--plugin":
            front += [word, *itertools.islice(words, 1)]
        else:
            rest.append(word)
    return front + rest


def _command_path(error: click.ClickException) -> str:
    context: Any = getattr(error, "ctx", None)
    return context.command_path if context is not None else "nrbench"


def _report_exception(error: Exception, debug: bool) -> int:
    from nrbench.calling.method_calls import InvalidOutput
    from nrbench.errors import BadInput, describe_error
    from nrbench.plugins.forms import Refused

    if debug:
        import traceback

        traceback.print_exc()
    if isinstance(error, BadInput | Refused):
        return _print_error(str(error), 2)
    if isinstance(error, InvalidOutput):
        return _print_error(f"the method {error}", 1)
    if isinstance(error, OSError):
        return _print_error(f"{error.filename or 'output'}: {error.strerror or error}", 2)
    return _print_error(f"internal error: {describe_error(error)}; run with --debug for the traceback", 1)


def _print_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    _print_error(f"warning: {message}", 0)


def _print_error(message: str, code: int) -> int:
    from nrbench.errors import strip_control

    with contextlib.suppress(OSError):  # nobody can read it: the disk is full, or the reader has gone
        print(f"nrbench: {' '.join(strip_control(message).split())}", file=sys.stderr)
    return code
