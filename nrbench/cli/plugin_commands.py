"""The commands about plugins and suites: list and show them, check one, and start a new one."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Annotated, Any

import click

from nrbench.api import catalog
from nrbench.authoring import packages
from nrbench.cli.verbs import choose_one, verb
from nrbench.errors import BadInput, require
from nrbench.flags import ARGUMENT, Flag, Json, Mebibytes, Seconds, Switch

PLUGIN_KINDS = ("synthesizers", "detectors", "metrics", "datasets", "reports")
CheckedPlugin = Annotated[str, Flag(ARGUMENT, "[PLUGIN[:PARAM=VALUE,...]]")]
CheckedKind = Annotated[str | None, Flag("--kind", choices=PLUGIN_KINDS)]
Clauses = Annotated["tuple[str, ...]", Flag("--clause", "NAME", many=True)]


@verb(catalog.list_plugins)
def list_command(kind: str | None, as_json: Json = False) -> None:
    """List plugins and suites. A broken plugin is listed with its error.

    Parameters
    ----------
    as_json
        Print JSON on standard output.
    """
    listed = {name: catalog.entries(name, as_json) for name in ([kind] if kind else catalog.KINDS)}
    if as_json:
        print(json.dumps(listed, indent=1))
        return
    for name, rows in listed.items():
        print(name)
        for entry in rows:
            print(f"  {entry['name']:<18} {entry['about']}")
            if entry.get("error"):
                print("    " + entry["error"].strip().replace("\n", "\n    "))


@verb(catalog.show_plugin)
def show_command(call: Callable[[], catalog.Shown], name: str, as_json: Json = False, toml: Switch = False) -> None:
    """Show a plugin or a suite.

    For a plugin, print its page, its parameters with defaults, its presets, its columns, and the BibTeX entry of its
    paper. NAME may also be a single score, METRIC.COLUMN, or "limits": all numbers by which outputs are judged, each
    with its unit and where it comes from.

    Parameters
    ----------
    as_json
        Print JSON on standard output.
    toml
        Print the file of a suite, to start one of your own from.
    """
    choose_one({"--json": as_json, "--toml": toml})
    if toml:
        from nrbench.plugins.parameters import nearest
        from nrbench.suites.installed import builtin

        if name not in builtin():
            raise BadInput(f"--toml {name!r}: no suite has that name{nearest(name, builtin())}")
        print(builtin()[name].read_text("utf-8"), end="")
        return
    shown = call()
    print(json.dumps(shown.pages, indent=1) if as_json else shown)


@verb()
def check_command(
    plugin: CheckedPlugin = "",
    kind: CheckedKind = None,
    only: Clauses = (),
    timeout: Seconds = 120.0,
    memory: Mebibytes = 4096.0,
    as_json: Json = False,
) -> int:
    """Check that PLUGIN fulfils every clause of its form.

    Each clause runs in a child process, so a plugin that crashes or hangs fails one clause. PLUGIN may also be a file,
    FILE.py: then all plugins that it defines are checked, as they are with `--plugin FILE.py` and no name. The exit
    code is 1 if a clause fails.

    Parameters
    ----------
    kind
        Check the plugin of this kind only.
    only
        Check this clause only; repeatable.
    timeout
        Limit of the wall time of one clause, seconds.
    memory
        Limit of the memory of one clause, in addition to that of an idle worker.
    as_json
        Print JSON on standard output.
    """
    from nrbench import plugins
    from nrbench.authoring.conformance import check_plugin
    from nrbench.plugins.parameters import parse_spec
    from nrbench.running.guard import Limits

    if plugin and plugin.endswith(".py"):
        plugins.add_file(plugin)
        plugin = ""
    files = plugins.files()
    if not plugin and not files:
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

    kinds = [kind] if kind else PLUGIN_KINDS
    if not name:
        listed = [(each, plugin) for each in kinds for plugin in plugins.inventory(each) if plugin.in_file]
        found = [(each, plugin.name) for each, plugin in listed if plugin.distribution in files]
        require(bool(found), "no plugin of that kind in these files; name one")
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


@verb(packages.new_plugin)
def new_command(call: Callable[[], list[Path]], name: str, folder: Path | None) -> None:
    """Write a package with a plugin called NAME to start from.

    The package has a module that works, its test, a README, and a pyproject.toml with the entry point.
    """
    print(*call(), sep="\n")
    where = folder if folder is not None else Path(name)
    print(f"next: pip install -e {where.absolute()}, then nrbench check {name}")
