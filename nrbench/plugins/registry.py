"""The plugin registry: plugins from entry points and from plain files, checked at registration."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import importlib.util
import inspect
import json
import math
import re
import sys
import traceback
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import Distribution, EntryPoint, entry_points
from pathlib import Path
from typing import Any, get_args

from nrbench.errors import BadInput
from nrbench.imaging.convert import Image
from nrbench.plugins.forms import Better, Column, Detection
from nrbench.plugins.parameters import PRESET, converted, missing, nearest, parse_spec, validated
from nrbench.storage import outside_user_folder

BENT_FINDERS = ("consensus", "gncc")
"""The detectors that find the lattice of a bent sample: one that confirms lattices, and a quick one."""


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
    "detectors": Form("detector", {"detect": 1}, ("image", "detector")),
    "synthesizers": Form("method", {"synthesize": 1}, ("method", "image", "shape", "lattice", "seed", "progress")),
    "metrics": Form("metric", {"score": 1}),
    "reports": Form("report", {"write": 2}),
}


PATCH_TERMS = ("patch_shape", "patch_placement", "patch_stitching")
"""Optional class variables of a synthesizer: how it works, in the three terms of the table of patch-based methods."""


@dataclass(frozen=True)
class Plugin:
    """A registered plugin, or one that is broken.

    Parameters
    ----------
    kind, name
        A key of :data:`FORMS`, and the name of the plugin.
    cls
        The frozen dataclass; None if the plugin is broken.
    distribution
        The installed distribution or the file that defines it.
    version
        The ``version`` of the class, else that of the distribution; for a plain file also a hash of the file.
    error
        The traceback or a message if the plugin is broken or a duplicate; else empty.
    """

    kind: str
    name: str
    cls: type[Any] | None
    distribution: str
    version: str
    error: str = ""

    @property
    def own(self) -> bool:
        """Whether nrbench itself defines it; all others run in processes of their own."""
        return self.distribution == "nrbench"

    @property
    def full_version(self) -> str:
        """The version in the keys of cells and scores: the plugin's own, and those of the detectors that it calls.

        Its class variable ``uses`` names these detectors. They run with their default parameters. A method with a
        ``geometry`` calls those that find the lattice of a bent sample.
        """
        uses = (*getattr(self.cls, "uses", ()), *(BENT_FINDERS if hasattr(self.cls, "geometry") else ()))
        called = (f"+{name}-{find('detectors', name).full_version}" for name in uses)
        return "".join([self.version, *called])


_files: dict[Path, list[Plugin]] = {}


def add_file(path: str | Path) -> None:
    """Register the plugins that a plain Python file defines (``--plugin mine.py``).

    A plugin's name is its class variable ``name``, else the class's name in lower case.

    Raises
    ------
    BadInput
        When the file is missing, cannot be imported, or defines no plugin, or when a name is taken.
    """
    file = Path(path).resolve()
    if file in _files:
        return
    found = _file_plugins(file, _import_file(file))
    if not found:
        raise BadInput(f"plugin {path}: defines no plugin; write a frozen dataclass with one of: {_methods_wanted()}")
    for plugin in found:
        if plugin.error:
            raise BadInput(f"plugin {path}: {plugin.error}")
        if plugin.name in names(plugin.kind):
            raise BadInput(f"plugin {path}: the name {plugin.name!r} is taken; give the class another `name`")
    _files[file] = found


def files() -> list[str]:
    """Return the paths of the plain files registered so far (for worker processes)."""
    return [str(path) for path in _files]


def names(kind: str) -> list[str]:
    """Return the names of all plugins of a kind, without loading them."""
    return list(dict.fromkeys([*entry_points_of(kind), *(plugin.name for plugin in from_files(kind))]))


def name_of(kind: str, cls: type[Any]) -> str:
    """Return the name under which a class is registered; empty if it is not. No other plugin is loaded."""
    value = f"{cls.__module__}:{cls.__qualname__}"
    named = (name for name, points in entry_points_of(kind).items() if points[0].value == value)
    return next(named, next((plugin.name for plugin in from_files(kind) if plugin.cls is cls), ""))


def inventory(kind: str) -> list[Plugin]:
    """Load every plugin of a kind. Broken and duplicate plugins are included, with their errors."""
    groups = entry_points_of(kind).values()
    listed = [load_plugin(kind, point, later > 0) for points in groups for later, point in enumerate(points)]
    return listed + list(from_files(kind))


def find(kind: str, name: str) -> Plugin:
    """Return the working plugin called ``name``.

    Raises
    ------
    BadInput
        When there is no such plugin (the message names the nearest), or it is broken.
    """
    for plugin in from_files(kind):
        if plugin.name == name:
            return plugin
    points = entry_points_of(kind).get(name)
    if not points:
        raise BadInput(
            f"{FORMS[kind].noun} {name!r} is not known{nearest(name, names(kind))}; see `nrbench list {kind}`"
        )
    plugin = load_plugin(kind, points[0], False)
    if plugin.cls is None:
        last = plugin.error.strip().splitlines()[-1]
        raise BadInput(f"{FORMS[kind].noun} {name!r} of {plugin.distribution} does not load: {last}")
    return plugin


def build(kind: str, name: str, parameters: Mapping[str, Any] | None = None) -> Any:
    """Return an instance of a plugin, its parameters converted to their declared types and checked.

    The entry ``preset`` of ``parameters`` chooses a preset of the plugin, whose values the other entries override.

    Raises
    ------
    BadInput
        For an unknown plugin, preset or parameter (the message names the nearest), or a value of the wrong type or
        range.
    """
    cls = find(kind, name).cls
    assert cls is not None
    return validated(cls, parameters or {}, f"{FORMS[kind].noun} {name}")


@dataclass(frozen=True)
class NamedDetector:
    """A registered detector, which is imported when it detects: a method to which a lattice is given does not need it.

    Parameters
    ----------
    spec
        ``name`` or ``name:param=value,...``.

    Examples
    --------
    >>> from nrbench import NamedDetector, texture
    >>> brick = texture("brick", shape=(96, 96))
    >>> NamedDetector("gncc").detect(brick.image).lattice.is_equivalent(brick.lattice, tolerance=0.5)
    True
    """

    spec: str

    def detect(self, image: Image) -> Detection:
        """Return what the detector finds; see :class:`~nrbench.plugins.forms.Detector`.

        Parameters
        ----------
        image
            The image.

        Returns
        -------
        Detection
            The lattice and its confidence.

        Raises
        ------
        NoLatticeFound
            If the detector finds none.
        """
        name, parameters = parse_spec(self.spec)
        found: Detection = build("detectors", name, parameters).detect(image)
        return found


def parameters_of(plugin: Any) -> dict[str, Any]:
    """Return all parameters of a plugin instance, including defaults, as values that JSON can hold."""
    return {field.name: _plain(getattr(plugin, field.name)) for field in dataclasses.fields(plugin)}


def _plain(value: Any) -> Any:
    if isinstance(value, tuple | list):
        return [_plain(part) for part in value]
    return str(value) if isinstance(value, Path) else value


@cache
def entry_points_of(kind: str) -> dict[str, list[EntryPoint]]:
    """Return the entry points of a kind by name; of the same name, those of nrbench come first."""
    found = sorted(entry_points(group=f"nrbench.{kind}"), key=lambda point: distribution_of(point)[0] != "nrbench")
    grouped: dict[str, list[EntryPoint]] = {}
    for point in found:
        grouped.setdefault(point.name, []).append(point)
    return grouped


def from_files(kind: str) -> Iterator[Plugin]:
    """Return the plugins of a kind that plain files define."""
    return (plugin for plugins in _files.values() for plugin in plugins if plugin.kind == kind)


def distribution_of(point: EntryPoint) -> tuple[str, str]:
    """Return the name and the version of the distribution that an entry point belongs to."""
    return _name_and_version(point.dist) if point.dist else ("unknown", "0")


@cache  # its metadata are a text, which is parsed for each of the two
def _name_and_version(distribution: Distribution) -> tuple[str, str]:
    return distribution.name, distribution.version


@cache
def load_plugin(kind: str, point: EntryPoint, duplicate: bool) -> Plugin:
    """Import the plugin of an entry point and check it; a duplicate is reported without an import.

    The plugins of nrbench are checked by its tests, not each time they are loaded.
    """
    distribution, version = distribution_of(point)
    if duplicate:
        error = f"duplicate: the name {point.name!r} was registered before; this one ({point.value}) is not used"
        return Plugin(kind, point.name, None, distribution, version, error)
    try:
        own = distribution == "nrbench"
        with contextlib.nullcontext() if own else outside_user_folder():
            cls = point.load()
        error = "" if own else fault(kind, cls)
    except (Exception, SystemExit):
        return Plugin(kind, point.name, None, distribution, version, traceback.format_exc())
    return Plugin(kind, point.name, None if error else cls, distribution, str(getattr(cls, "version", version)), error)


def fault(kind: str, cls: Any) -> str:
    """Return one sentence about why a class is no valid plugin of a kind; empty if it is valid."""
    checks = (_form_fault, _version_fault, _field_fault, _method_fault, _column_fault, _preset_fault, _patch_fault)
    return next((found for check in checks if (found := check(kind, cls))), "")


def _form_fault(kind: str, cls: Any) -> str:
    label = f"{FORMS[kind].noun} {getattr(cls, '__name__', cls)!r}"
    if not (inspect.isclass(cls) and dataclasses.is_dataclass(cls)):
        return f"{label} is no dataclass; decorate it with @dataclass(frozen=True)"
    if not cls.__dataclass_params__.frozen:  # type: ignore[attr-defined]
        return f"{label} is not frozen; decorate it with @dataclass(frozen=True)"
    name = str(getattr(cls, "name", "x"))
    if not re.fullmatch(r"[\w.-]+", name):
        return f"{label}: its name {name!r} is not valid; use letters, digits, '.', '-' and '_'"
    own_page = cls.__doc__ and not cls.__doc__.startswith(f"{cls.__name__}(")
    return "" if own_page else f"{label} has no docstring; write one, it is the plugin's page"


def _version_fault(kind: str, cls: Any) -> str:
    label = f"{FORMS[kind].noun} {cls.__name__!r}"
    version, uses = getattr(cls, "version", ""), getattr(cls, "uses", ())
    if not is_stable(version):
        return (
            f"{label}: its version {version!r:.60} is no text and no finite number; set `version: ClassVar[str] = ...`"
        )
    unknown = next((name for name in uses if name not in names("detectors")), None)
    return f"{label}: it uses {unknown!r}, which is no detector; see `nrbench list detectors`" if unknown else ""


def is_stable(value: object) -> bool:
    """Return whether a value may be part of a key: text or a finite number, whose text is the same in each process."""
    return isinstance(value, str | int) or (isinstance(value, float) and math.isfinite(value))


def _field_fault(kind: str, cls: Any) -> str:
    form = FORMS[kind]
    label = f"{form.noun} {cls.__name__!r}: parameter"
    for field in dataclasses.fields(cls):
        if field.name in form.taken:
            taken = ", ".join(form.taken)
            return f"{label} {field.name!r} has the name of an argument of the call; rename it (taken: {taken})"
        if field.name == PRESET:
            return f"{label} {PRESET!r} has the name by which presets are chosen; rename it"
        if not _has_default(field) and kind in ("detectors", "metrics", "reports"):
            return f"{label} {field.name!r} has no default; give it one"
        if _has_default(field) and not _is_plain(field):
            return f"{label} {field.name!r} has a default that JSON cannot hold; use numbers, text or None"
    return ""


def _has_default(field: dataclasses.Field[Any]) -> bool:
    return field.default is not dataclasses.MISSING or field.default_factory is not dataclasses.MISSING


def _is_plain(field: dataclasses.Field[Any]) -> bool:
    """Return whether JSON can hold the default of a parameter, which the keys and the tables need."""
    try:
        made = field.default_factory() if callable(field.default_factory) else field.default
        json.dumps(_plain(made))
    except (TypeError, ValueError):
        return False
    return True


def _method_fault(kind: str, cls: Any) -> str:
    for method, arguments in FORMS[kind].methods.items():
        function = getattr(cls, method, None)
        if not callable(function):
            return f"{FORMS[kind].noun} {cls.__name__!r} lacks the method {method}()"
        try:
            inspect.signature(function).bind(*[None] * (arguments + 1))
        except TypeError as error:
            wanted = f"self and {arguments} argument{'s' * (arguments > 1)}"
            return f"{FORMS[kind].noun} {cls.__name__!r}: {method}() must take {wanted} ({error})"
    return ""


def _column_fault(kind: str, cls: Any) -> str:
    if kind != "metrics":
        return ""
    columns = getattr(cls, "columns", None)
    if not (isinstance(columns, Mapping) and columns and all(isinstance(c, Column) for c in columns.values())):
        return f"metric {cls.__name__!r} declares no columns; set `columns: ClassVar = {{name: Column(...)}}`"
    wrong = next((name for name, column in columns.items() if not _is_column(name, column)), None)
    if wrong is not None:
        return f"metric {cls.__name__!r}: column {wrong!r} is not valid: {columns[wrong]}; see Column"
    return ""


def _is_column(name: Any, column: Column) -> bool:
    texts = all(isinstance(text, str) for text in (name, column.meaning, column.unit))
    limits = isinstance(column.range, tuple) and len(column.range) == 2
    numbers = limits and all(isinstance(limit, int | float) for limit in column.range)
    return texts and numbers and column.range[0] <= column.range[1] and column.better in get_args(Better)


def _preset_fault(kind: str, cls: Any) -> str:
    """Return what is wrong with the presets of a plugin: an unknown parameter, or a value that it refuses."""
    presets = getattr(cls, "presets", {})
    label = f"{FORMS[kind].noun} {cls.__name__!r}"
    if not (isinstance(presets, Mapping) and all(isinstance(values, Mapping) for values in presets.values())):
        return f"{label}: presets must be a mapping; set `presets: ClassVar = {{name: {{parameter: value}}}}`"
    for name, parameters in presets.items():
        where = f"{label}: preset {name!r}"
        try:
            (converted if missing(cls, parameters) else validated)(cls, parameters, where)
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
        return f"method {cls.__name__!r}: {wrong} must be text; set `{wrong}: ClassVar[str] = ...`"
    lacking = ", ".join(name for name in PATCH_TERMS if name not in said)
    return f"method {cls.__name__!r} has {said[0]}, but not {lacking}; give all or none" if said and lacking else ""


def _import_file(file: Path) -> Any:
    if not file.is_file():
        raise BadInput(f"plugin {file}: there is no such file")
    path_hash = hashlib.blake2b(str(file).encode(), digest_size=4).hexdigest()
    spec = importlib.util.spec_from_file_location(f"nrbench_plugin_{file.stem}_{path_hash}", file)
    if spec is None or spec.loader is None:
        raise BadInput(f"plugin {file}: is no Python file; its name must end in .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[module.__name__] = module
    with outside_user_folder():
        try:
            spec.loader.exec_module(module)
        except (Exception, SystemExit) as error:
            raise BadInput(f"plugin {file}: does not import: {type(error).__name__}: {error}") from error
    return module


def _file_plugins(file: Path, module: Any) -> list[Plugin]:
    digest = hashlib.blake2b(file.read_bytes(), digest_size=8).hexdigest()
    found = []
    for cls in vars(module).values():
        if not (inspect.isclass(cls) and cls.__module__ == module.__name__):
            continue
        for kind in _kinds_of(cls):
            name = getattr(cls, "name", cls.__name__.lower())
            version = f"{getattr(cls, 'version', '0')}+{digest}"
            found.append(Plugin(kind, str(name), cls, str(file), version, fault(kind, cls)))
    return found


def _kinds_of(cls: type[Any]) -> list[str]:
    """Return the kinds of plugin that a class is, or is meant to be.

    A class with all methods of a kind is of that kind. One that has only the first method of a kind is reported as a
    broken plugin of it, unless it is complete as another kind.
    """
    has = {kind: [callable(getattr(cls, method, None)) for method in form.methods] for kind, form in FORMS.items()}
    return [kind for kind in has if all(has[kind])] or [kind for kind in has if has[kind][0]]


def _methods_wanted() -> str:
    return ", ".join(f"{form.method}()" for form in FORMS.values())
