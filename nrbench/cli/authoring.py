"""The commands check and new, for authors of plugins."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Collection
from pathlib import Path
from typing import Any

import click

from nrbench.cli.options import limit_options
from nrbench.errors import BadInput

KINDS = ("synthesizers", "detectors", "metrics", "datasets", "reports")
ONE_OF = ("synthesizer", "detector", "metric", "dataset", "report")


@click.command("check")
@click.argument("plugin", required=False, metavar="[PLUGIN[:PARAM=VALUE,...]]")
@click.option("--kind", type=click.Choice(KINDS), help="Check the plugin of this kind only.")
@limit_options("clause")
@click.option("--clause", "only", multiple=True, metavar="NAME", help="Check this clause only; repeatable.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON on standard output.")
def check_command(
    plugin: str | None, kind: str | None, timeout: float, memory: float, only: tuple[str, ...], as_json: bool
) -> int:
    """Check that PLUGIN fulfils every clause of its form.

    Each clause runs in a child process, so a plugin that crashes or hangs fails one clause. PLUGIN may also be a file,
    FILE.py: then all plugins that it defines are checked, as they are with `--plugin FILE.py` and no name. The exit
    code is 1 if a clause fails.
    """
    from nrbench import plugins
    from nrbench.authoring.conformance import check_plugin
    from nrbench.plugins.parameters import parse_spec
    from nrbench.running.guard import Limits

    if plugin is not None and plugin.endswith(".py"):
        plugins.add_file(plugin)
        plugin = None
    files = plugins.files()
    if plugin is None and not files:
        raise click.UsageError("name a plugin, or load a file of plugins with --plugin FILE.py")
    name, parameters = parse_spec(plugin) if plugin else ("", {})
    results: list[dict[str, Any]] = []
    failed = 0
    for each, found in _find_plugins(name, kind, files):
        if not as_json:
            print(f"{plugins.FORMS[each].noun} {found}")
        clauses = []
        for checked in check_plugin(each, found, parameters, Limits(timeout, memory), only=only):
            clauses.append(checked)
            if not as_json:
                print(f"  {checked.verdict}  {checked.clause:<13} {checked.reason}", flush=True)
        failures = [checked for checked in clauses if checked.verdict == "fail"]
        failed += len(failures)
        results.append({"kind": each, "name": found, "clauses": [dataclasses.asdict(checked) for checked in clauses]})
        if not as_json:
            _print_failures(failures, len(clauses))
    if as_json:
        print(json.dumps({"plugins": results, "failed": failed}, indent=1))
    return int(failed > 0)


def _find_plugins(name: str, kind: str | None, files: Collection[str]) -> list[tuple[str, str]]:
    """Return the kind and the name of each plugin of a name; without a name, of those that some files define.

    Raises
    ------
    BadInput
        If there is none; the message names the nearest.
    """
    from nrbench import plugins
    from nrbench.plugins.parameters import nearest

    kinds = [kind] if kind else KINDS
    if not name:
        listed = [(each, plugin) for each in kinds for plugin in plugins.inventory(each) if plugin.in_file]
        found = [(each, plugin.name) for each, plugin in listed if plugin.distribution in files]
        if not found:
            raise BadInput("no plugin of that kind in these files; name one")
        return found
    found = [(each, name) for each in kinds if name in plugins.names(each)]
    if not found:
        near = nearest(name, [plugin for each in kinds for plugin in plugins.names(each)])
        raise BadInput(f"plugin {name!r} is not known{near}; load a file with --plugin FILE.py")
    return found


def _print_failures(failures: list[Any], clauses: int) -> None:
    """Print what each violated clause demands, with the end of the log."""
    for checked in failures:
        print(f"\n{checked.clause}: {checked.demand}")
        for line in checked.log.strip().splitlines()[-20:]:
            print(f"    {line}")
    print(f"\n{len(failures)} of {clauses} clauses failed" if failures else f"no clause of {clauses} failed")


@click.command("new")
@click.argument("kind", type=click.Choice(ONE_OF))
@click.argument("name")
@click.option("-o", "folder", type=click.Path(path_type=Path), metavar="DIR", help="The new folder.  [default: NAME]")
def new_command(kind: str, name: str, folder: Path | None) -> None:
    """Write a package with a plugin called NAME to start from.

    The package has a module that works, its test, a README, and a pyproject.toml with the entry point.
    """
    from nrbench.authoring.packages import new_plugin

    for path in new_plugin(kind, name, folder):
        print(path)
    where = folder if folder is not None else Path(name)
    print(f"next: pip install -e {where.absolute()}, then nrbench check {name}")
