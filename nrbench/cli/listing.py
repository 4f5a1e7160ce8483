"""The commands list and show."""

from __future__ import annotations

import json

import click

from nrbench.api.catalog import KINDS, entries, show_plugin
from nrbench.errors import BadInput


@click.command("list")
@click.argument("kind", type=click.Choice(KINDS), required=False)
@click.option("--json", "as_json", is_flag=True, help="Print JSON on standard output.")
def list_command(kind: str | None, as_json: bool) -> None:
    """List plugins and suites. A broken plugin is listed with its error."""
    listed = {name: entries(name, as_json) for name in ([kind] if kind else KINDS)}
    if as_json:
        print(json.dumps(listed, indent=1))
        return
    for name, rows in listed.items():
        print(name)
        for entry in rows:
            print(f"  {entry['name']:<18} {entry['about']}")
            if entry.get("error"):
                print("    " + entry["error"].strip().replace("\n", "\n    "))


@click.command("show")
@click.argument("name")
@click.option("--json", "as_json", is_flag=True, help="Print JSON on standard output.")
@click.option("--toml", "as_toml", is_flag=True, help="Print the file of a suite, to start one of your own from.")
def show_command(name: str, as_json: bool, as_toml: bool) -> None:
    """Show a plugin or a suite.

    For a plugin, print its page, its parameters with defaults, its presets, its columns, and the BibTeX entry of its
    paper. NAME may also be a single score, METRIC.COLUMN, or "limits": all numbers by which outputs are judged, each
    with its unit and where it comes from.
    """
    if as_json and as_toml:
        raise BadInput("--json and --toml: choose one of them")
    if as_toml:
        from nrbench.plugins.parameters import nearest
        from nrbench.suites.installed import builtin

        if name not in builtin():
            raise BadInput(f"--toml {name!r}: no suite has that name{nearest(name, builtin())}")
        print(builtin()[name].read_text("utf-8"), end="")
        return
    shown = show_plugin(name)
    print(json.dumps(shown.pages, indent=1) if as_json else shown)
