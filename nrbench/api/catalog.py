"""The Python functions that list and show plugins and suites."""

from __future__ import annotations

import dataclasses
import inspect
import math
from typing import TYPE_CHECKING, Annotated, Any

from nrbench.errors import BadInput
from nrbench.flags import ARGUMENT, Flag

# A list on the command line needs no table.
if TYPE_CHECKING:
    import pandas as pd

_BETTER = {"one": "nearest to 1", "none": "neither higher nor lower"}
KINDS = ("datasets", "detectors", "synthesizers", "metrics", "reports", "suites")
ListedKind = Annotated[str, Flag(ARGUMENT, choices=KINDS)]
ShownName = Annotated[str, Flag(ARGUMENT)]


def list_plugins(kind: ListedKind = "") -> pd.DataFrame:
    """List plugins and suites.

    Parameters
    ----------
    kind
        One of ``datasets``, ``detectors``, ``synthesizers``, ``metrics``, ``reports`` and ``suites``; empty for all.

    Returns
    -------
    pandas.DataFrame
        One row for each: its ``kind``, ``name``, version and so on, and what it is ``about``. A broken plugin has its
        ``error``.

    Raises
    ------
    BadInput
        For an unknown kind.

    Examples
    --------
    >>> from nrbench import list_plugins
    >>> "gncc" in set(list_plugins("detectors")["name"])
    True
    """
    import pandas as pd

    from nrbench.plugins.parameters import nearest

    if kind and kind not in KINDS:
        raise BadInput(f"kind {kind!r} is not known{nearest(kind, KINDS)}; give one of {', '.join(KINDS)}")
    kinds = [kind] if kind else KINDS
    return pd.DataFrame([{"kind": each, **entry} for each in kinds for entry in entries(each, True)])


def show_plugin(name: ShownName) -> Shown:
    """Show a plugin or a suite.

    Parameters
    ----------
    name
        The name of a plugin or a suite; a score, ``metric.column``; or ``"limits"``: all numbers by which outputs are
        judged.

    Returns
    -------
    Shown
        Its page, its parameters with defaults, its presets, its columns, and the BibTeX entry of its paper. It prints
        as a text; ``pages`` holds the same for programs.

    Raises
    ------
    BadInput
        If no plugin or suite has the name; the message names the nearest.

    Examples
    --------
    >>> from nrbench import show_plugin
    >>> show_plugin("rsgf").pages[0]["kind"]
    'synthesizers'
    """
    from nrbench import plugins
    from nrbench.plugins.parameters import nearest
    from nrbench.suites.installed import builtin

    pages = _pages(name)
    if not pages:
        known = [each for kind in plugins.FORMS for each in plugins.names(kind)]
        metric = name.partition(".")[0]
        if "." in name and metric in plugins.names("metrics"):
            known += [f"{metric}.{key}" for key in getattr(plugins.find("metrics", metric).cls, "columns", {})]
        near = nearest(name, [*known, *builtin()])
        raise BadInput(f"{name!r}: no plugin or suite has that name{near}")
    return Shown(pages)


@dataclasses.dataclass(frozen=True)
class Shown:
    """What is known of a plugin or a suite.

    Parameters
    ----------
    pages
        One entry for each plugin or suite of the name.

    Examples
    --------
    >>> from nrbench import show_plugin
    >>> repr(show_plugin("cost")).startswith("cost (metrics, nrbench")
    True
    """

    pages: list[dict[str, Any]]

    def __repr__(self) -> str:
        """Return the pages as text."""
        return "\n\n".join(_text(page) for page in self.pages)


def entries(kind: str, complete: bool) -> list[dict[str, Any]]:
    """Return what is listed of a kind. Suites are read and checked if their versions and hashes are wanted too."""
    if kind == "suites" and not complete:
        from nrbench.suites.installed import builtin, describe_suite

        return [{"name": name, "about": describe_suite(name)} for name in builtin()]
    if kind == "suites":
        from nrbench.suites.suite import builtin, load_suite

        suites = [load_suite(name) for name in builtin()]
        return [{"name": s.name, "about": s.description, "version": s.version, "hash": s.hash} for s in suites]
    from nrbench.plugins import summaries

    entries = []
    for plugin in summaries(kind):
        entry: dict[str, Any] = {"name": plugin.name, "distribution": plugin.distribution, "version": plugin.version}
        if plugin.error:
            entries.append({**entry, "about": "BROKEN", "error": plugin.error})
        else:
            note = " (reference: never ranked)" if plugin.reference else ""
            entries.append({**entry, "about": plugin.about + note, "reference": plugin.reference})
    return entries


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
        page["columns"] = {key: dataclasses.asdict(column) for key, column in cls.columns.items()}
        for column in page["columns"].values():
            column["range"] = [end if math.isfinite(end) else None for end in column["range"]]  # JSON has no infinity
    return page


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
