"""Answers of a child process about plugins of others, for a process that does not import them."""

from __future__ import annotations

import dataclasses
import inspect
import math
from collections.abc import Mapping
from typing import Any

from nrbench.errors import BadInput
from nrbench.plugins import registry
from nrbench.plugins.parameters import fields_by_call
from nrbench.plugins.stand_ins import VariableFacts


def answer(question: Mapping[str, Any]) -> Any:
    """Import a plugin, and return what a process that does not import it asks.

    Parameters
    ----------
    question
        A ``file``, or ``kind`` and ``name`` of a plugin; with ``parameters`` if it is to be built.

    Returns
    -------
    list of dict, or dict
        For JSON: the facts of the plugins of the file, or of the one plugin, or of the instance.

    Raises
    ------
    BadInput
        When the plugin is not known, or is broken, or refuses its parameters.
    """
    threads = registry.count_threads()
    if "file" in question:
        registry.add_file(question["file"])
        named = [plugin for kind in registry.FORMS for plugin in registry.from_files(kind)]
        found = [plugin for plugin in named if plugin.distribution == question["file"]]
    elif "parameters" in question:
        where = f"{registry.FORMS[question['kind']].noun} {question['name']}"
        return _describe_instance(registry.build(question["kind"], question["name"], question["parameters"]), where)
    else:
        (point, *_) = registry.entry_points_of(question["kind"])[question["name"]]
        found = [registry.load_plugin(question["kind"], point, False)]
    for plugin in found:
        if plugin.cls is None:
            raise BadInput(plugin.error)
    return [_describe(plugin, registry.count_threads() > threads) for plugin in found]


def _describe(plugin: registry.Plugin, threads: bool) -> dict[str, Any]:
    cls: Any = plugin.cls
    own = {field.name for field in dataclasses.fields(cls)}
    variables = {
        name: _plain(getattr(cls, name))
        for name in VariableFacts.model_fields
        if name not in own and hasattr(cls, name)
    }
    parameters = [
        {"name": field.name, "required": default is dataclasses.MISSING, "default": None}
        | ({} if default is dataclasses.MISSING else {"default": _plain(default)})
        for field in fields_by_call(cls)
        for default in [field.default_factory() if callable(field.default_factory) else field.default]
    ]
    facts = {"kind": plugin.kind, "name": plugin.name, "version": plugin.version, "page": inspect.getdoc(cls) or ""}
    return {**facts, "threads": threads, "parameters": parameters, "variables": variables}


def _describe_instance(instance: Any, where: str) -> dict[str, Any]:
    return {
        "parameters": registry.parameters_of(instance),
        "label": getattr(instance, "label", ""),
        "uses_lattice": getattr(instance, "uses_lattice", True),
        "finder": getattr(instance, "finder", None),
        "fingerprint": registry.read_fingerprint(instance, where),
    }


def _plain(value: Any) -> Any:
    """Return a value for JSON: tables and columns as mappings, an infinite end of a range as None."""
    if dataclasses.is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, tuple | list | set | frozenset):
        return [_plain(part) for part in value]
    if isinstance(value, float) and math.isinf(value):
        return None
    return value if isinstance(value, bool | int | float | str | None) else str(value)
