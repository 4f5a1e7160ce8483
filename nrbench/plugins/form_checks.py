"""What a class must be to be a plugin of a kind, and why it is not."""

from __future__ import annotations

import dataclasses
import inspect
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from nrbench.errors import BadInput
from nrbench.plugins.parameters import LABEL, PRESET, converted, missing, validated

# The forms import numpy, which the names of plugins do not need.
if TYPE_CHECKING:
    from nrbench.plugins.forms import Column


@dataclass(frozen=True)
class Form:
    """The requirements of a kind of plugin.

    Parameters
    ----------
    noun
        The word for one plugin of this kind, for messages.
    methods
        The required methods, each with its number of arguments.
    taken
        Names that no parameter may have, because functions of :mod:`nrbench.api` have arguments of these names.
    """

    noun: str
    methods: Mapping[str, int]
    taken: tuple[str, ...] = ()

    @property
    def method(self) -> str:
        """The first required method, by which the kind of a class is recognized."""
        return next(iter(self.methods))


FORMS: Mapping[str, Form] = {
    "datasets": Form("dataset", {"render": 2, "again": 3}, ("model", "shape", "seed")),
    "detectors": Form("detector", {"detect": 1}, ("image", "detector", "mask")),
    "synthesizers": Form(
        "method",
        {"synthesize": 1},
        ("method", "image", "shape", "lattice", "seed", "progress", "mask", "maps", "keep_alpha", "flatten_light"),
    ),
    "metrics": Form("metric", {"score": 1}),
    "reports": Form("report", {"write": 2}),
}


PATCH_TERMS = ("patch_shape", "patch_placement", "patch_stitching")
"""Optional class variables of a synthesizer: how it works, in the three terms of the table of patch-based methods."""


def kinds_of(cls: type[Any]) -> list[str]:
    """Return the kinds of plugin that a class is, or is meant to be.

    A class with all methods of a kind is of that kind. One that has only the first method of a kind is reported as a
    broken plugin of it, unless it is complete as another kind.
    """
    has = {kind: [callable(getattr(cls, method, None)) for method in form.methods] for kind, form in FORMS.items()}
    return [kind for kind in has if all(has[kind])] or [kind for kind in has if has[kind][0]]


def methods_wanted() -> str:
    """Return the first method of each kind, for a message."""
    return ", ".join(f"{form.method}()" for form in FORMS.values())


def find_fault(kind: str, cls: Any) -> str:
    """Return one sentence about why a class is no valid plugin of a kind; empty if it is valid."""
    checks = (_form_fault, _version_fault, _field_fault, _method_fault, _column_fault, _preset_fault, _patch_fault)
    found = next((found for check in checks if (found := check(kind, cls))), "")
    return f"{FORMS[kind].noun} {getattr(cls, '__name__', cls)!r}{found}" if found else ""


# Each check returns the rest of the sentence, after the noun and the name of the class.
def _form_fault(_: str, cls: Any) -> str:
    if not (inspect.isclass(cls) and dataclasses.is_dataclass(cls)):
        return " is no dataclass; decorate it with @dataclass(frozen=True)"
    if not cls.__dataclass_params__.frozen:  # type: ignore[attr-defined]
        return " is not frozen; decorate it with @dataclass(frozen=True)"
    name = str(getattr(cls, "name", "x"))
    if not re.fullmatch(r"[\w.-]+", name):
        return f": its name {name!r} is not valid; use letters, digits, '.', '-' and '_'"
    own_page = cls.__doc__ and not cls.__doc__.startswith(f"{cls.__name__}(")
    return "" if own_page else " has no docstring; write one, it is the plugin's page"


def _version_fault(_: str, cls: Any) -> str:
    version = getattr(cls, "version", "")
    wrong = f": its version {version!r:.60} is no text and no finite number; set `version: ClassVar[str] = ...`"
    return "" if is_stable(version) else wrong


def is_stable(value: object) -> bool:
    """Return whether a value may be part of a key: text or a finite number, whose text is the same in each process."""
    return isinstance(value, str | int) or (isinstance(value, float) and math.isfinite(value))


def _field_fault(kind: str, cls: Any) -> str:
    taken, bare = FORMS[kind].taken, missing(cls, ())
    for field in dataclasses.fields(cls):
        label = f": parameter {field.name!r} has"
        if field.name in taken:
            return f"{label} the name of an argument of the call; rename it (taken: {', '.join(taken)})"
        if field.name in (PRESET, LABEL):
            use = "presets are chosen" if field.name == PRESET else "methods get their names in tables"
            return f"{label} the name by which {use}; rename it"
        if field.name in bare and kind in ("detectors", "metrics", "reports"):
            return f"{label} no default; give it one"
        if field.name not in bare and not _is_plain(field):
            return f"{label} a default that JSON cannot hold; use numbers, text or None"
    return ""


def _is_plain(field: dataclasses.Field[Any]) -> bool:
    """Return whether JSON can hold the default of a parameter, which the keys and the tables need."""
    try:
        made = field.default_factory() if callable(field.default_factory) else field.default
        json.dumps(plain_value(made))
    except (TypeError, ValueError):
        return False
    return True


def _method_fault(kind: str, cls: Any) -> str:
    for method, arguments in FORMS[kind].methods.items():
        function = getattr(cls, method, None)
        if not callable(function):
            return f" lacks the method {method}()"
        try:
            inspect.signature(function).bind(*[None] * (arguments + 1))
        except TypeError as error:
            wanted = f"self and {arguments} argument{'s' * (arguments > 1)}"
            return f": {method}() must take {wanted} ({error})"
    return ""


def _column_fault(kind: str, cls: Any) -> str:
    if kind != "metrics":
        return ""
    from nrbench.plugins.forms import Column

    columns = getattr(cls, "columns", None)
    if not (isinstance(columns, Mapping) and columns and all(isinstance(c, Column) for c in columns.values())):
        return " declares no columns; set `columns: ClassVar = {name: Column(...)}`"
    wrong = (f": column {n!r} is not valid: {c}; see Column" for n, c in columns.items() if not _is_column(n, c))
    return next(wrong, "")


def _is_column(name: Any, column: Column) -> bool:
    from nrbench.plugins.forms import Better

    texts = all(isinstance(text, str) for text in (name, column.meaning, column.unit))
    limits = isinstance(column.range, tuple) and len(column.range) == 2
    numbers = limits and all(isinstance(limit, int | float) for limit in column.range)
    return texts and numbers and column.range[0] <= column.range[1] and column.better in get_args(Better)


def _preset_fault(_: str, cls: Any) -> str:
    """Return what is wrong with the presets of a plugin: an unknown parameter, or a value that it refuses."""
    presets = getattr(cls, "presets", {})
    if not (isinstance(presets, Mapping) and all(isinstance(values, Mapping) for values in presets.values())):
        return ": presets must be a mapping; set `presets: ClassVar = {name: {parameter: value}}`"
    for name, parameters in presets.items():
        try:
            (converted if missing(cls, parameters) else validated)(cls, parameters, f": preset {name!r}")
        except BadInput as error:
            return str(error)
    return ""


def describe_patches(cls: Any, parameters: Mapping[str, Any]) -> list[str]:
    """Return the :data:`PATCH_TERMS` that a method declares, with its parameters in the places of their names."""
    return [str(getattr(cls, term)).format_map(parameters) for term in PATCH_TERMS if hasattr(cls, term)]


def _patch_fault(kind: str, cls: Any) -> str:
    if kind != "synthesizers":
        return ""
    said = [name for name in PATCH_TERMS if hasattr(cls, name)]
    wrong = next((name for name in said if not isinstance(getattr(cls, name), str)), "")
    if wrong:
        return f": {wrong} must be text; set `{wrong}: ClassVar[str] = ...`"
    lacking = ", ".join(name for name in PATCH_TERMS if name not in said)
    return f" has {said[0]}, but not {lacking}; give all or none" if said and lacking else ""


def plain_value(value: Any) -> Any:
    """Return a value of a parameter as one that JSON can hold, if there is one."""
    if isinstance(value, tuple | list):
        return [plain_value(part) for part in value]
    return str(value) if isinstance(value, Path) else value
