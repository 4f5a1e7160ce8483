"""The command ``nrbench``: one verb a function, loaded when it is called."""

from __future__ import annotations

import importlib
import io
import sys
from collections.abc import Mapping
from typing import Any

import click

VERBS: Mapping[str, str] = {
    "run": "nrbench.cli.running",
    "plan": "nrbench.cli.running",
    "report": "nrbench.cli.running",
    "status": "nrbench.cli.running",
    "label": "nrbench.cli.labelling",
    "list": "nrbench.cli.listing",
    "show": "nrbench.cli.listing",
    "synth": "nrbench.cli.pictures",
    "lattice": "nrbench.cli.lattices",
    "score": "nrbench.cli.pictures",
    "render": "nrbench.cli.rendering",
}
"""Each verb, and the module that holds its function ``VERB_command``."""


class Verbs(click.Group):
    """A group that knows its verbs by name, and imports one only when it is needed."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the verbs in the order of a user's work."""
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a verb's module and return its command."""
        if cmd_name not in VERBS:
            return None
        command: click.Command = getattr(importlib.import_module(VERBS[cmd_name]), f"{cmd_name}_command")
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the verb, or name the nearest one."""
        if args and not args[0].startswith("-") and args[0] not in VERBS:
            from nrbench.plugins.parameters import nearest

            raise click.UsageError(f"verb {args[0]!r} is not known{nearest(args[0], VERBS)}")
        return super().resolve_command(ctx, args)


@click.group(cls=Verbs, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="nrbench")
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
@click.option("--plugin", "plugin_files", multiple=True, metavar="FILE.py", help="Also use the plugins of this file.")
def nrbench(debug: bool, plugin_files: tuple[str, ...]) -> None:
    """Benchmark of near-regular texture synthesis: known lattices, measured verdicts, cost beside quality."""
    if plugin_files:
        from nrbench import plugins

        for file in plugin_files:
            plugins.add_file(file)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line: exit code 0 fine, 1 some cells failed, 2 usage or bad input, 130 interrupted."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    given = hoisted(list(sys.argv[1:] if arguments is None else arguments))
    try:
        code = nrbench.main(args=given, prog_name="nrbench", standalone_mode=False)
    except KeyboardInterrupt:
        code = _complain("interrupted; the same command goes on where this one stopped", 130)
    except click.Abort:
        code = _complain("interrupted; the same command goes on where this one stopped", 130)
    except click.exceptions.NoArgsIsHelpError as help_text:
        print(help_text.format_message())
        code = 0
    except click.ClickException as error:
        code = _complain(f"{error.format_message()}; see `{_path(error)} --help`", 2)
    except Exception as error:
        code = _failure(error, "--debug" in given)
    sys.exit(code if isinstance(code, int) else 0)


def hoisted(arguments: list[str]) -> list[str]:
    """Return the arguments with ``--debug`` and ``--plugin FILE`` moved before the verb: they may stand anywhere."""
    front: list[str] = []
    rest: list[str] = []
    words = iter(arguments)
    for word in words:
        if word == "--":
            rest += [word, *words]
        elif word == "--debug" or word.startswith("--plugin="):
            front.append(word)
        elif word == "--plugin":
            front += [word, *[following for following in [next(words, None)] if following is not None]]
        else:
            rest.append(word)
    return front + rest


def _path(error: click.ClickException) -> str:
    context: Any = getattr(error, "ctx", None)
    return context.command_path if context is not None else "nrbench"


def _failure(error: Exception, debug: bool) -> int:
    from nrbench.errors import BadInput
    from nrbench.plugins.forms import Refused
    from nrbench.running.outputs import InvalidOutput

    if debug:
        import traceback

        traceback.print_exc()
    if isinstance(error, BadInput | Refused):
        return _complain(str(error), 2)
    if isinstance(error, InvalidOutput):
        return _complain(f"the method {error}", 1)
    if isinstance(error, OSError):
        return _complain(f"{error.filename or 'file'}: {error.strerror or error}", 2)
    return _complain(f"internal error: {type(error).__name__}: {error}; run with --debug for the traceback", 1)


def _complain(message: str, code: int) -> int:
    print(f"nrbench: {' '.join(message.split())}", file=sys.stderr)
    return code
