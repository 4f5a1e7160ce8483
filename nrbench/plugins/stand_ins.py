"""Stand-ins for plugins of others: what a process that does not import them knows of them.

A child process imports a plugin and answers with plain values (:mod:`nrbench.plugins.answers`). They are checked here,
and become a class with the same parameters and class variables, whose methods are missing.
"""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, JsonValue, TypeAdapter, ValidationError

from nrbench.errors import BadInput
from nrbench.plugins.forms import Column

Word = Annotated[str, Field(max_length=200)]
Number = Annotated[int | float, Field(ge=-1e300, le=1e300)]


class _Plain(BaseModel):
    """Values of the declared types, none converted and none more."""

    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)


class _ColumnFacts(_Plain):
    """A column of a score; None is an infinite end of its range."""

    meaning: str
    unit: Word
    range: tuple[Number | None, Number | None]
    better: Literal["higher", "lower", "one", "none"]


class _LimitFacts(_Plain):
    """A number by which outputs are judged."""

    name: Word
    value: Number
    unit: Word
    origin: str


class _ParameterFacts(_Plain):
    """A parameter, and its default unless it must be given."""

    name: Word
    required: bool
    default: JsonValue


class VariableFacts(_Plain):
    """The class variables of a plugin that other code reads."""

    reference: bool = False
    needs_lattice: bool = True
    procedural: bool = True
    terminal: bool = False
    isolation: Literal["worker", "cell"] = "worker"
    folder: Word = ""
    paper: str = ""
    family: Word = ""
    geometry: Word = ""
    uses: tuple[Word, ...] = ()
    always_shown: tuple[Word, ...] = ()
    right_on: tuple[Word, ...] = ()
    presets: dict[Word, dict[Word, JsonValue]] = {}
    columns: dict[Word, _ColumnFacts] = {}
    limits: tuple[_LimitFacts, ...] = ()
    patch_shape: str = ""
    patch_placement: str = ""
    patch_stitching: str = ""


class Facts(_Plain):
    """What is known of a plugin."""

    kind: Literal["datasets", "detectors", "synthesizers", "metrics", "reports"]
    name: Annotated[str, Field(pattern=r"^[\w.-]+$", max_length=200)]
    version: Word
    page: str
    threads: bool
    parameters: list[_ParameterFacts]
    variables: VariableFacts


class InstanceFacts(_Plain):
    """What is known of a plugin with its parameters."""

    parameters: dict[Word, JsonValue]
    label: Word
    uses_lattice: bool
    finder: Word | None
    fingerprint: Word | Number | None


def checked_facts(facts: Any) -> list[Facts]:
    """Return the facts of plugins as a child sent them.

    Raises
    ------
    BadInput
        When they are not such facts; the message names the first value that is not as it must be.
    """
    return _checked(list[Facts], facts)  # type: ignore[no-any-return]


def _checked(wanted: Any, content: Any) -> Any:
    try:
        return TypeAdapter(wanted).validate_json(json.dumps(content))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"] if part != "variables" and not isinstance(part, int))
        why = first["msg"]
        raise BadInput(f"{where or 'its answer'}: {why[:1].lower()}{why[1:]}") from None


def make_class(facts: Facts) -> type[Any]:
    """Return a stand-in for a class: a frozen dataclass with its parameters and class variables.

    A plugin that starts threads when it is imported gets the ``isolation`` "cell".

    Raises
    ------
    BadInput
        When a parameter has a name that none can have.
    """
    said = facts.variables
    variables: dict[str, Any] = {name: getattr(said, name) for name in said.model_fields_set}
    if said.columns:
        variables["columns"] = {key: _make_column(column) for key, column in said.columns.items()}
    if facts.threads:
        variables["isolation"] = "cell"
    fields = [(each.name, Any, _make_field(each)) for each in facts.parameters]
    content = {**variables, "__doc__": facts.page, "stand_in": True}
    try:
        return dataclasses.make_dataclass(facts.name, fields, namespace=content, frozen=True, kw_only=True)
    except (TypeError, ValueError) as error:
        raise BadInput(f"parameters: {error}") from None


def _make_column(column: _ColumnFacts) -> Column:
    low, high = column.range
    span = (-math.inf if low is None else low, math.inf if high is None else high)
    return Column(column.meaning, column.unit, span, column.better)


def _make_field(parameter: _ParameterFacts) -> Any:
    default = parameter.default
    if parameter.required:
        return dataclasses.field()
    if isinstance(default, dict):
        return dataclasses.field(default_factory=lambda: dict(default))
    return dataclasses.field(default=tuple(default) if isinstance(default, list) else default)


def make_instance(cls: type[Any], answered: Any) -> Any:
    """Return an instance of a stand-in from what a child told of the plugin with its parameters.

    Raises
    ------
    BadInput
        When that is not as it must be; the message names the first wrong value.
    """
    facts: InstanceFacts = _checked(InstanceFacts, answered)
    try:
        instance = cls(**facts.parameters)
    except TypeError as error:
        raise BadInput(f"parameters: {error}") from None
    for key in ("label", "uses_lattice", "finder"):
        object.__setattr__(instance, key, getattr(facts, key))
    if facts.fingerprint is not None:
        object.__setattr__(instance, "fingerprint", lambda: facts.fingerprint)
    return instance
