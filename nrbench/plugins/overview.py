"""An overview of the plugins of a kind, without importing those of nrbench: importing all of them takes seconds."""

from __future__ import annotations

import ast
import importlib.util
import inspect
import re
from dataclasses import dataclass
from functools import cache
from importlib.machinery import SourceFileLoader
from typing import Any

from nrbench.plugins.registry import Plugin, inventory


@dataclass(frozen=True)
class Summary:
    """A plugin in short.

    Parameters
    ----------
    name, distribution, version, error
        As in :class:`~nrbench.plugins.registry.Plugin`.
    about
        The first line of its page; empty if it is broken.
    reference
        Whether it is a reference method, which is never ranked.
    """

    name: str
    distribution: str
    version: str
    about: str = ""
    reference: bool = False
    error: str = ""


def summaries(kind: str) -> list[Summary]:
    """Return the summaries of all plugins of a kind, broken and duplicate ones included.

    Plugins of nrbench are read from their source. Third-party plugins are imported.
    """
    return [_read_source(plugin) or _of_plugin(plugin) for plugin in inventory(kind)]


def _of_plugin(plugin: Plugin) -> Summary:
    about = (inspect.getdoc(plugin.cls) or "").partition("\n")[0] if plugin.cls else ""
    reference = bool(getattr(plugin.cls, "reference", False))
    return Summary(plugin.name, plugin.distribution, plugin.version, about, reference, plugin.error)


def _read_source(plugin: Plugin) -> Summary | None:
    """Return the summary of a plugin of nrbench, or None if it cannot be read without an import."""
    if not plugin.own:
        return None
    try:
        page, constants = _read_class(plugin.source.module, plugin.source.attr)
    except LookupError:
        return None
    about, reference = page.partition("\n")[0], bool(constants.get("reference", False))
    version = str(constants.get("version", plugin.release))
    return Summary(plugin.name, plugin.distribution, version, about, reference)


@cache
def _read_class(module: str, name: str) -> tuple[str, dict[str, Any]]:
    """Return the docstring of a class, and its constants with those that it inherits; LookupError if it has none."""
    found = importlib.util.find_spec(module)
    if found is None or not isinstance(found.loader, SourceFileLoader):
        raise LookupError(module)
    # Only the part before the first method is parsed: all sources together would take longer than the command.
    before, line, body_text = (found.loader.get_source(module) or "").partition(f"\nclass {name}")
    tree = ast.parse(before + line + re.split(r"^    (?:def |@)", body_text, maxsplit=1, flags=re.MULTILINE)[0])
    body = next((node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == name), None)
    page = ast.get_docstring(body) if body else None
    if body is None or not page:
        raise LookupError(name)
    places = {alias.name: node for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    constants: dict[str, Any] = {}
    for base in map(ast.unparse, reversed(body.bases)):
        place = places.get(base)
        if place is None:
            constants |= _read_class(module, base)[1]
        elif place.level or (place.module or "").startswith("nrbench"):
            origin = importlib.util.resolve_name("." * place.level + (place.module or ""), found.parent)
            constants |= _read_class(origin, base)[1]
    for node in body.body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.value, ast.Constant):
            constants[ast.unparse(node.target)] = node.value.value
    return page, constants
