"""The plugin registry: plugins from entry points and from plain files, checked at registration.

The plugins of nrbench are imported where they are needed. Those of others are imported by the process that runs them; a
process that coordinates a run asks its children what they are (:func:`asking`), and gets stand-ins of plain values.
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
import threading
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import Distribution, EntryPoint, entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from nrbench.errors import BadInput
from nrbench.plugins.parameters import PRESET, converted, missing, nearest, parse_spec, validated
from nrbench.storage import outside_user_folder

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
    def shared(self) -> bool:
        """Whether a worker may import it for all cells; a plugin whose ``isolation`` is "cell" is imported in each."""
        return bool(getattr(self.cls, "isolation", "worker") != "cell")

    @property
    def full_version(self) -> str:
        """The version in the keys of cells and scores: the plugin's own, and those of the detectors that it calls.

        Its class variable ``uses`` names these detectors. They run with their default parameters. A method with a
        ``geometry`` calls those that find the lattice of a bent sample.
        """
        uses = (*getattr(self.cls, "uses", ()), *(BENT_FINDERS if hasattr(self.cls, "geometry") else ()))
        called = (f"+{name}-{find('detectors', name).full_version}" for name in uses)
        return "".join([self.version, *called])


Ask = Callable[[Mapping[str, Any]], Any]
"""Answers a question about plugins of others, see :func:`nrbench.plugins.answers.answer`; raises BadInput."""
_files: dict[Path, list[Plugin]] = {}
_loaded: dict[tuple[str, EntryPoint, bool, bool], Plugin] = {}
_asks: list[Ask | None] = []


@contextlib.contextmanager
def asking(ask: Ask | None) -> Iterator[None]:
    """Let other processes import the plugins of others for a while; None: import them in this process.

    Parameters
    ----------
    ask
        Sends a question to a child process, and returns its answer.
    """
    _asks.append(ask)  # several threads may do so at the same time
    try:
        yield
    finally:
        _asks.remove(ask)


def _asked() -> Ask | None:
    return _asks[-1] if _asks else None


def add_file(path: str | Path, later: Iterable[Sequence[str]] | None = None) -> None:
    """Register the plugins that a plain Python file defines (``--plugin mine.py``).

    A plugin's name is its class variable ``name``, else the class's name in lower case.

    Parameters
    ----------
    path
        The file.
    later
        Kind and name of its plugins, if they are known; it is then read when one of them is needed.

    Raises
    ------
    BadInput
        When the file is missing, cannot be imported, or defines no plugin, or when a name is taken.
    """
    file = Path(path).resolve()
    if file in _files:
        return
    if later is not None:
        _files[file] = [Plugin(kind, name, None, str(file), "") for kind, name in later]
        return
    found = _plugins_of(file)
    if not found:
        raise BadInput(f"plugin {path}: defines no plugin; write a frozen dataclass with one of: {_methods_wanted()}")
    for plugin in found:
        if plugin.error:
            raise BadInput(f"plugin {path}: {plugin.error}")
        if plugin.name in names(plugin.kind):
            raise BadInput(f"plugin {path}: the name {plugin.name!r} is taken; give the class another `name`")
    _files[file] = found


def _plugins_of(file: Path) -> list[Plugin]:
    """Return the plugins of a file: imported, or stand-ins of those that another process imports."""
    if not file.is_file():
        raise BadInput(f"plugin {file}: there is no such file")
    ask = _asked()
    if ask is None:
        return _file_plugins(file, _import_file(file))
    return _described(ask({"file": str(file)}), str(file))


def _described(facts: Any, distribution: str) -> list[Plugin]:
    """Return the plugins that another process has described, with stand-ins for their classes."""
    from nrbench.plugins import stand_ins

    found = []
    for each in stand_ins.checked_facts(facts):
        if each.threads and each.variables.isolation != "cell":
            warnings.warn(
                f"{FORMS[each.kind].noun} {each.name!r} starts threads when it is imported, so each cell imports it "
                'anew, in a process of its own; `isolation: ClassVar[str] = "cell"` says that this is meant',
                stacklevel=2,
            )
        found.append(Plugin(each.kind, each.name, stand_ins.make_class(each), distribution, each.version))
    return found


def files(shared: bool = False) -> dict[str, list[tuple[str, str]]]:
    """Return kind and name of the plugins of each plain file registered so far, by its path (for other processes).

    Parameters
    ----------
    shared
        Whether they are those that a worker may import for all cells: all, or none if a plugin of one is not to be.
    """
    apart = shared and not all(plugin.shared for each in _files.values() for plugin in each)
    known = {} if apart else _files
    return {str(path): [(plugin.kind, plugin.name) for plugin in found] for path, found in known.items()}


def shared_plugins() -> list[tuple[str, str]]:
    """Return kind and name of the installed plugins of others that this process knows and workers may import."""
    known = (plugin for plugin in _loaded.values() if plugin.cls is not None and not plugin.own and plugin.shared)
    return sorted({(plugin.kind, plugin.name) for plugin in known})


def loaded_methods() -> list[str]:
    """Return the names of the synthesizers of nrbench that this process has loaded, such as those of its plan."""
    return sorted({each.name for each in _loaded.values() if each.kind == "synthesizers" and each.own and each.cls})


def names(kind: str) -> list[str]:
    """Return the names of all plugins of a kind, without loading them."""
    in_files = (plugin.name for found in _files.values() for plugin in found if plugin.kind == kind)
    return list(dict.fromkeys([*entry_points_of(kind), *in_files]))


def installed(kind: str) -> list[Plugin]:
    """Return all plugins of a kind without loading those of others, whose version is that of their distribution."""
    found = []
    for points in entry_points_of(kind).values():
        for later, point in enumerate(points):
            distribution, version = distribution_of(point)
            loads = later > 0 or distribution == "nrbench" or (kind, point, False, _asked() is None) in _loaded
            unread = Plugin(kind, point.name, None, distribution, version)
            found.append(load_plugin(kind, point, later > 0) if loads else unread)
    return [*found, *from_files(kind)]


def origins() -> list[dict[str, str]]:
    """Return kind and name of every plugin, and its distribution with its version. No installed plugin is imported."""
    found = []
    for kind in FORMS:
        points = [(point.name, *distribution_of(point)) for each in entry_points_of(kind).values() for point in each]
        points += [(plugin.name, plugin.distribution, plugin.version) for plugin in from_files(kind)]
        found += [dict(zip(("kind", "name", "distribution", "version"), (kind, *each), strict=True)) for each in points]
    return found


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
    points = entry_points_of(kind).get(name)
    if not points:
        for plugin in from_files(kind, name):
            if plugin.name == name:
                return plugin
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
    ask = _asked()
    if ask is not None and is_stand_in(cls):
        from nrbench.plugins import stand_ins

        given = {key: _plain(value) for key, value in (parameters or {}).items()}
        try:
            return stand_ins.make_instance(cls, ask({"kind": kind, "name": name, "parameters": given}))
        except BadInput as error:
            where = f"{FORMS[kind].noun} {name}"
            raise BadInput(str(error) if str(error).startswith(where) else f"{where}: {error}") from None
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


def build_with(kind: str, method: str, parameters: Mapping[str, Any] | None = None) -> Any:
    """Return an instance of the first plugin of a kind that has an optional method of its form.

    Raises
    ------
    BadInput
        If no plugin has the method, or as for :func:`build`.
    """
    for name in names(kind):
        cls = None
        with contextlib.suppress(BadInput):  # a broken plugin has no method
            cls = find(kind, name).cls
        if hasattr(cls, method):
            return build(kind, name, parameters)
    raise BadInput(f"no installed {FORMS[kind].noun} has a method {method}; see `nrbench list {kind}`")


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


@cache
def entry_points_of(kind: str) -> dict[str, list[EntryPoint]]:
    """Return the entry points of a kind by name; of the same name, those of nrbench come first."""
    found = sorted(entry_points(group=f"nrbench.{kind}"), key=lambda point: distribution_of(point)[0] != "nrbench")
    grouped: dict[str, list[EntryPoint]] = {}
    for point in found:
        grouped.setdefault(point.name, []).append(point)
    return grouped


def from_files(kind: str, name: str = "") -> Iterator[Plugin]:
    """Return the plugins of a kind that plain files define; files that were registered for later are read.

    Parameters
    ----------
    kind
        The kind.
    name
        Only files with a plugin of this name are read; empty: all.
    """
    for file, found in _files.items():
        wanted = not name or any((plugin.kind, plugin.name) == (kind, name) for plugin in found)
        if wanted and not (found and all(plugin.cls and (_asked() or not is_stand_in(plugin.cls)) for plugin in found)):
            _files[file] = _plugins_of(file)
    return (plugin for found in _files.values() for plugin in found if plugin.kind == kind)


def count_threads() -> int:
    """Return the number of threads of this process: also those that Python does not know, on Linux."""
    with contextlib.suppress(OSError):
        return len(list(Path("/proc/self/task").iterdir()))
    return threading.active_count()


def is_stand_in(cls: Any) -> bool:
    """Return whether a class stands for one that another process has imported, see :mod:`nrbench.plugins.stand_ins`."""
    return hasattr(cls, "stand_in")


def distribution_of(point: EntryPoint) -> tuple[str, str]:
    """Return the name and the version of the distribution that an entry point belongs to."""
    return _name_and_version(point.dist) if point.dist else ("unknown", "0")


@cache  # its metadata are a text, which is parsed for each of the two
def _name_and_version(distribution: Distribution) -> tuple[str, str]:
    return distribution.name, distribution.version


def load_plugin(kind: str, point: EntryPoint, duplicate: bool) -> Plugin:
    """Import the plugin of an entry point and check it, or let another process do so; see :func:`asking`.

    A duplicate is reported without an import. The plugins of nrbench are checked by its tests, not each time they are
    loaded.
    """
    key = (kind, point, duplicate, _asked() is None)
    if key not in _loaded:
        _loaded[key] = _load(kind, point, duplicate)
    return _loaded[key]


def _load(kind: str, point: EntryPoint, duplicate: bool) -> Plugin:
    distribution, version = distribution_of(point)
    if duplicate:
        error = f"duplicate: the name {point.name!r} was registered before; this one ({point.value}) is not used"
        return Plugin(kind, point.name, None, distribution, version, error)
    own = distribution == "nrbench"
    try:
        ask = None if own else _asked()
        if ask is not None:
            (found,) = _described(ask({"kind": kind, "name": point.name}), distribution)
            return dataclasses.replace(found, kind=kind, name=point.name)
        with contextlib.nullcontext() if own else _importing():
            cls = point.load()
        error = "" if own else fault(kind, cls)
    except BadInput as told:
        return Plugin(kind, point.name, None, distribution, version, str(told))
    except KeyboardInterrupt:
        raise
    except BaseException:
        return Plugin(kind, point.name, None, distribution, version, traceback.format_exc())
    return Plugin(kind, point.name, None if error else cls, distribution, str(getattr(cls, "version", version)), error)


@contextlib.contextmanager
def _importing() -> Iterator[None]:
    """Import a plugin of others: outside of the user's folder, and without a word on standard output."""
    with outside_user_folder(), contextlib.redirect_stdout(sys.stderr):
        yield


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
    with _importing():
        try:
            spec.loader.exec_module(module)
        except KeyboardInterrupt:
            raise
        except BaseException as error:
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
