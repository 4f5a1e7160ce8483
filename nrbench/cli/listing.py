"""The commands list and show."""

from __future__ import annotations

import dataclasses
import inspect
import json
import math
from typing import Any

import click

from nrbench.errors import BadInput

_BETTER = {"one": "nearest to 1", "none": "neither higher nor lower"}
KINDS = ("datasets", "detectors", "synthesizers", "metrics", "reports", "suites")


@click.command("list")
@click.argument("kind", type=click.Choice(KINDS), required=False)
@click.option("--json", "as_json", is_flag=True, help="Print JSON on standard output.")
def list_command(kind: str | None, as_json: bool) -> None:
    """List plugins and suites. A broken plugin is listed with its error."""
    listed = {name: _entries(name, as_json) for name in ([kind] if kind else KINDS)}
    if as_json:
        print(json.dumps(listed, indent=1))
        return
    for name, entries in listed.items():
        print(name)
        for entry in entries:
            print(f"  {entry['name']:<18} {entry['about']}")
            if entry.get("error"):
                print("    " + entry["error"].strip().replace("\n", "\n    "))


def _entries(kind: str, complete: bool) -> list[dict[str, Any]]:
    """Return what is listed of a kind. Suites are read and checked if their versions and hashes are wanted too."""
    if kind == "suites" and not complete:
        from nrbench.suites.installed import builtin, describe_suite

        return [{"name": name, "about": describe_suite(name)} for name in builtin()]
    if kind == "suites":
        from nrbench.suites.suite import builtin, load_suite

        suites = [load_suite(name) for name in builtin()]
        return [{"name": s.name, "about": s.description, "version": s.version, "hash": s.hash} for s in suites]
    from nrbench.plugins.overview import summaries

    entries = []
    for plugin in summaries(kind):
        entry: dict[str, Any] = {"name": plugin.name, "distribution": plugin.distribution, "version": plugin.version}
        if plugin.error:
            entries.append({**entry, "about": "BROKEN", "error": plugin.error})
        else:
            note = " (reference: never ranked)" if plugin.reference else ""
            entries.append({**entry, "about": plugin.about + note, "reference": plugin.reference})
    return entries


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
    from nrbench import plugins
    from nrbench.plugins.parameters import nearest
    from nrbench.suites.suite import builtin

    if as_json and as_toml:
        raise BadInput("--json and --toml: choose one of them")
    if as_toml:
        if name not in builtin():
            raise BadInput(f"--toml {name!r}: no suite has that name{nearest(name, builtin())}")
        print(builtin()[name].read_text("utf-8"), end="")
        return
    pages = _pages(name)
    if not pages:
        known = [each for kind in plugins.FORMS for each in plugins.names(kind)]
        metric = name.partition(".")[0]
        if "." in name and metric in plugins.names("metrics"):
            known += [f"{metric}.{key}" for key in getattr(plugins.find("metrics", metric).cls, "columns", {})]
        near = nearest(name, [*known, *builtin()])
        raise BadInput(f"{name!r}: no plugin or suite has that name{near}")
    print(json.dumps(pages, indent=1) if as_json else "\n\n".join(_text(page) for page in pages))


def _pages(name: str) -> list[dict[str, Any]]:
    """Return the pages of the plugins, of the score and of the suite of a name."""
    from nrbench import plugins
    from nrbench.suites.suite import builtin, load_suite

    pages = [_page(kind, plugins.find(kind, name)) for kind in plugins.FORMS if name in plugins.names(kind)]
    metric, _, column = name.partition(".")
    if column and metric in plugins.names("metrics"):
        page = _page("metrics", plugins.find("metrics", metric))
        if column in page["columns"]:
            about = page["page"].partition("\n")[0]
            pages.append({**page, "page": about, "columns": {column: page["columns"][column]}})
    if name == "limits":
        tables = {metric: _limits(metric) for metric in plugins.names("metrics")}
        pages += [{"kind": name, "name": metric, "limits": rows} for metric, rows in tables.items() if rows]
    if name in builtin():
        suite = load_suite(name)
        pages.append({"kind": "suites", "name": name, "hash": suite.hash, **suite.model_dump(mode="json")})
    return pages


def _limits(metric: str) -> list[dict[str, Any]]:
    """Return the rows of a metric's class variable ``limits``; none if it has none or does not load."""
    from nrbench import plugins

    try:
        limits = getattr(plugins.find("metrics", metric).cls, "limits", ())
    except BadInput:
        return []
    return [{key: getattr(limit, key) for key in ("name", "value", "unit", "origin")} for limit in limits]


def _page(kind: str, plugin: Any) -> dict[str, Any]:
    from nrbench.plugins import PATCH_TERMS, describe_patches
    from nrbench.plugins.parameters import fields_by_call

    cls = plugin.cls
    page = {
        "kind": kind,
        "name": plugin.name,
        "distribution": plugin.distribution,
        "version": plugin.version,
        "page": inspect.getdoc(cls) or "",
        "parameters": {field.name: _default(field) for field in fields_by_call(cls)},
        "presets": {name: dict(values) for name, values in getattr(cls, "presets", {}).items()},
        "bibtex": inspect.cleandoc(getattr(cls, "paper", "")),
    }
    if kind == "synthesizers":
        page["patches"] = dict(zip(PATCH_TERMS, describe_patches(cls, page["parameters"]), strict=False))
    if kind == "metrics":
        page["columns"] = {key: _declared(column) for key, column in cls.columns.items()}
    return page


def _declared(column: Any) -> dict[str, Any]:
    """Return the declaration of a column for JSON; an infinite end of its range is null."""
    ends = [end if math.isfinite(end) else None for end in column.range]
    return {**dataclasses.asdict(column), "range": ends}


def _default(field: dataclasses.Field[Any]) -> Any:
    if field.default is not dataclasses.MISSING:
        return field.default if isinstance(field.default, bool | int | float | str | None) else str(field.default)
    if field.default_factory is not dataclasses.MISSING:
        return str(field.default_factory())
    return "(must be given)"


def _text(page: dict[str, Any]) -> str:
    if page["kind"] == "suites":
        rows = [f"  {row['name']:<24} {row['dataset']}  {row['description']}" for row in page["texture"]]
        head = f"{page['name']} (suite, version {page['version']}, {page['hash']})\n{page['description']}"
        axes = f"methods: {', '.join(page['methods'])}\nlattice: {', '.join(page['lattice'])}"
        return "\n".join([head, f"sample {page['sample']}, size {page['size']}, seed {page['seed']}", axes, *rows])
    if page["kind"] == "limits":
        rows = [f"  {row['name']:<20} {row['value']:<6g} {row['unit']:<7} {row['origin']}" for row in page["limits"]]
        return "\n".join([f"limits of {page['name']}", *rows])
    lines = [f"{page['name']} ({page['kind']}, {page['distribution']}, version {page['version']})", page["page"]]
    presets = {f"preset={preset}": values for preset, values in page["presets"].items()}
    for title, values in {"defaults": page["parameters"], **presets, "patches": page.get("patches")}.items():
        if values:
            lines += ["", f"{title}:", *(f"  {key} = {value}" for key, value in values.items())]
    if page.get("columns"):
        lines += ["", "columns:", *(_column_text(page["name"], key, c) for key, c in page["columns"].items())]
    return "\n".join([*lines, *(["", page["bibtex"]] if page["bibtex"] else [])])


def _column_text(metric: str, key: str, column: dict[str, Any]) -> str:
    low, high = column["range"]
    span = f"{'-inf' if low is None else f'{low:g}'} to {'inf' if high is None else f'{high:g}'}"
    better = _BETTER.get(column["better"], column["better"])
    return f"  {metric}.{key}: {column['meaning']} [unit: {column['unit'] or 'none'}; range: {span}; better: {better}]"
