"""The plugin registry: plugins from entry points and from plain files.

A module with plugins is imported when one of them is needed, and third-party plugins are then checked. An error of an
import is an error of that plugin alone.
"""

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
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.metadata import Distribution, EntryPoint, entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from nrbench.errors import BadInput
from nrbench.plugins.parameters import PRESET, converted, missing, nearest, parse_spec, validated

# The forms import numpy, which the names of plugins do not need.
if TYPE_CHECKING:
    from nrbench.imaging.convert import Image
    from nrbench.plugins.forms import Column, Detection

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


class DoesNotLoad(BadInput):
    """A plugin is registered, but cannot be imported, or is not valid. The message names it, and says why."""


@dataclass(frozen=True, eq=False)
class Plugin:
    """A registered plugin. Its module is imported when :attr:`cls` or :attr:`version` is first read.

    Parameters
    ----------
    kind, name
        A key of :data:`FORMS`, and the name of the plugin.
    distribution, release
        The installed distribution that defines it, and its version; or the file that defines it, and a hash of it.
    source
        The entry point, or the class that a file defines.
    duplicate
        Whether another plugin of the kind has taken the name; this one is then not used.
    """

    kind: str
    name: str
    distribution: str
    release: str
    source: EntryPoint | type[Any]
    duplicate: bool = False

    @property
    def own(self) -> bool:
        """Whether nrbench itself defines it. Third-party plugins run in child processes of their own."""
        return self.distribution == "nrbench"

    @property
    def cls(self) -> type[Any] | None:
        """The frozen dataclass; None if the plugin does not load."""
        return self._loaded[0]

    @property
    def error(self) -> str:
        """The traceback or a message if the plugin does not load, or is a duplicate; else empty."""
        return self._loaded[1]

    @cached_property
    def _loaded(self) -> tuple[type[Any] | None, str]:
        if isinstance(self.source, type):
            return self.source, ""
        if self.duplicate:
            used = f"the name {self.name!r} was registered before; this one ({self.source.value}) is not used"
            return None, f"duplicate: {used}"
        try:
            with contextlib.redirect_stdout(sys.stderr):  # what an import prints is no part of the answer
                cls = self.source.load()
            wrong = "" if self.own else fault(self.kind, cls)  # the tests of nrbench check its own plugins
        except KeyboardInterrupt:
            raise
        except BaseException:
            return None, traceback.format_exc()
        return (None, wrong) if wrong else (cls, "")

    @property
    def in_file(self) -> bool:
        """Whether a plain file defines it."""
        return isinstance(self.source, type)

    @property
    def is_loaded(self) -> bool:
        """Whether this process has imported it."""
        return "_loaded" in vars(self) and self.cls is not None

    @property
    def shared(self) -> bool:
        """Whether a worker may import it for all cells; a plugin whose ``isolation`` is "cell" is imported in each."""
        return bool(getattr(self.cls, "isolation", "worker") != "cell")

    @property
    def version(self) -> str:
        """The ``version`` of the class, else that of the distribution; for a plain file also the hash of the file."""
        if self.in_file:
            return f"{getattr(self.cls, 'version', '0')}+{self.release}"
        return str(getattr(self.cls, "version", self.release))

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
    """Import a plain Python file, and register the plugins that it defines (``--plugin mine.py``).

    A plugin's name is its class variable ``name``, else the class's name in lower case.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    BadInput
        When the file is missing, cannot be imported, or defines no valid plugin, or when a name is taken.
    """
    file = Path(path).resolve()
    if file in _files:
        return
    if not file.is_file():
        raise BadInput(f"plugin {file}: there is no such file")
    found = _file_plugins(file, _import_file(file))
    if not found:
        raise BadInput(f"plugin {path}: defines no plugin; write a frozen dataclass with one of: {_methods_wanted()}")
    for plugin in found:
        if wrong := fault(plugin.kind, plugin.cls):
            raise BadInput(f"plugin {path}: {wrong}")
        if plugin.name in names(plugin.kind):
            raise BadInput(f"plugin {path}: the name {plugin.name!r} is taken; give the class another `name`")
    _files[file] = found


def files() -> list[str]:
    """Return the paths of the plain files whose plugins are registered."""
    return [str(file) for file in _files]


@cache
def _installed(kind: str) -> list[Plugin]:
    """Return the plugins of a kind that entry points name; of the same name, those of nrbench come first."""
    known = [(point, *_name_and_version(point.dist)) for point in entry_points(group=f"nrbench.{kind}")]
    grouped: dict[str, list[Plugin]] = {}
    for point, distribution, version in sorted(known, key=lambda each: each[1] != "nrbench"):
        group = grouped.setdefault(point.name, [])
        group.append(Plugin(kind, point.name, distribution, version, point, duplicate=bool(group)))
    return [plugin for group in grouped.values() for plugin in group]


@cache  # its metadata are a text, which is parsed for each of the two
def _name_and_version(distribution: Distribution | None) -> tuple[str, str]:
    return (distribution.name, distribution.version) if distribution else ("unknown", "0")


def inventory(kind: str) -> list[Plugin]:
    """Return every plugin of a kind, duplicates included. None is imported before its class is read."""
    return [*_installed(kind), *(plugin for found in _files.values() for plugin in found if plugin.kind == kind)]


def names(kind: str) -> list[str]:
    """Return the names of all plugins of a kind. None is imported."""
    return list(dict.fromkeys(plugin.name for plugin in inventory(kind)))


def name_of(kind: str, cls: type[Any]) -> str:
    """Return the name under which a class is registered; empty if it is not. No plugin is imported."""
    value = f"{cls.__module__}:{cls.__qualname__}"
    known = (each for each in inventory(kind) if cls is each.source or getattr(each.source, "value", "") == value)
    return next((plugin.name for plugin in known if not plugin.duplicate), "")


@cache
def in_role(role: str) -> str:
    """Return the name of the plugin that nrbench declares for a role.

    Parameters
    ----------
    role
        ``detector``, which finds a lattice where no detector is named; ``quick-detector``, which proposes lattices of
        bent pictures; ``pictures``, which reads files; ``comparison``, which compares two runs; ``run-site``;
        ``tables``, which has the frames of a run; ``plot``, which has the plot of a run.
    """
    declared = entry_points(group="nrbench.roles", name=role)
    value = next(point.value for point in declared if _name_and_version(point.dist)[0] == "nrbench")
    points = (point for kind in FORMS for point in entry_points(group=f"nrbench.{kind}"))
    return next(point.name for point in points if point.value == value)


def lookup(kind: str, name: str) -> Plugin:
    """Return the plugin called ``name``, which is not imported, and may not load.

    Raises
    ------
    BadInput
        When there is no such plugin; the message names the nearest.
    """
    for plugin in inventory(kind):
        if plugin.name == name:
            return plugin
    raise BadInput(f"{FORMS[kind].noun} {name!r} is not known{nearest(name, names(kind))}; see `nrbench list {kind}`")


def find(kind: str, name: str) -> Plugin:
    """Import the plugin called ``name``, and return it.

    Raises
    ------
    BadInput
        When there is no such plugin; the message names the nearest.
    DoesNotLoad
        When it does not load.
    """
    plugin = lookup(kind, name)
    if plugin.cls is None:
        last = plugin.error.strip().splitlines()[-1]
        raise DoesNotLoad(f"{FORMS[kind].noun} {name!r} of {plugin.distribution} does not load: {last}")
    return plugin


def build(kind: str, name: str, parameters: Mapping[str, Any] | None = None) -> Any:
    """Return an instance of a plugin, its parameters converted to their declared types and checked.

    The entry ``preset`` of ``parameters`` chooses a preset of the plugin, whose values the other entries override.

    Raises
    ------
    BadInput
        For an unknown plugin, preset or parameter (the message names the nearest), or a value of the wrong type or
        range.
    DoesNotLoad
        When the plugin does not load.
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


def read_fingerprint(plugin: Any, where: str) -> str | int | float | None:
    """Return a hash of the files that a plugin reads, from its own ``fingerprint()``; None if it has none.

    Raises
    ------
    BadInput
        When it is no text and no finite number, whose text would be the same in each process.
    """
    function = getattr(plugin, "fingerprint", None)
    value: Any = None if function is None else function()
    if value is not None and not is_stable(value):
        raise BadInput(f"{where}: fingerprint() returned {value!r:.60}; it must return text or a finite number")
    return value  # type: ignore[no-any-return]


def parameters_of(plugin: Any) -> dict[str, Any]:
    """Return all parameters of a plugin instance, including defaults, as values that JSON can hold."""
    return {field.name: _plain(getattr(plugin, field.name)) for field in dataclasses.fields(plugin)}


def _plain(value: Any) -> Any:
    if isinstance(value, tuple | list):
        return [_plain(part) for part in value]
    return str(value) if isinstance(value, Path) else value


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
    from nrbench.plugins.forms import Column

    columns = getattr(cls, "columns", None)
    if not (isinstance(columns, Mapping) and columns and all(isinstance(c, Column) for c in columns.values())):
        return f"metric {cls.__name__!r} declares no columns; set `columns: ClassVar = {{name: Column(...)}}`"
    wrong = next((name for name, column in columns.items() if not _is_column(name, column)), None)
    if wrong is not None:
        return f"metric {cls.__name__!r}: column {wrong!r} is not valid: {columns[wrong]}; see Column"
    return ""


def _is_column(name: Any, column: Column) -> bool:
    from nrbench.plugins.forms import Better

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
    path_hash = hashlib.blake2b(str(file).encode(), digest_size=4).hexdigest()
    spec = importlib.util.spec_from_file_location(f"nrbench_plugin_{file.stem}_{path_hash}", file)
    if spec is None or spec.loader is None:
        raise BadInput(f"plugin {file}: is no Python file; its name must end in .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[module.__name__] = module
    try:
        with contextlib.redirect_stdout(sys.stderr):
            spec.loader.exec_module(module)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise BadInput(f"plugin {file}: does not import: {type(error).__name__}: {error}") from error
    return module


def _file_plugins(file: Path, module: Any) -> list[Plugin]:
    digest = hashlib.blake2b(file.read_bytes(), digest_size=8).hexdigest()
    return [
        Plugin(kind, str(getattr(cls, "name", cls.__name__.lower())), str(file), digest, cls)
        for cls in vars(module).values()
        if inspect.isclass(cls) and cls.__module__ == module.__name__
        for kind in _kinds_of(cls)
    ]


def _kinds_of(cls: type[Any]) -> list[str]:
    """Return the kinds of plugin that a class is, or is meant to be.

    A class with all methods of a kind is of that kind. One that has only the first method of a kind is reported as a
    broken plugin of it, unless it is complete as another kind.
    """
    has = {kind: [callable(getattr(cls, method, None)) for method in form.methods] for kind, form in FORMS.items()}
    return [kind for kind in has if all(has[kind])] or [kind for kind in has if has[kind][0]]


def _methods_wanted() -> str:
    return ", ".join(f"{form.method}()" for form in FORMS.values())
