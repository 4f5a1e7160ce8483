"""The plugin registry: plugins from entry points and from plain files.

A module with plugins is imported when one of them is needed, and third-party plugins are then checked. An error of an
import is an error of that plugin alone.
"""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import hashlib
import importlib.util
import inspect
import itertools
import re
import sys
import traceback
import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.machinery import SourceFileLoader
from importlib.metadata import Distribution, EntryPoint, entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final

from nrbench.errors import BadInput, require
from nrbench.plugins.form_checks import FORMS, find_fault, is_stable, kinds_of, methods_wanted, plain_value
from nrbench.plugins.parameters import converted, nearest, parse_spec, validated

# The forms import numpy, which the names of plugins do not need.
if TYPE_CHECKING:
    from nrbench.imaging.convert import Image
    from nrbench.imaging.masks import Mask
    from nrbench.plugins.forms import Detection


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
    def built_in(self) -> bool:
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
            wrong = "" if self.built_in else fault(self.kind, cls)  # the tests of nrbench check its own plugins
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
    def in_session(self) -> bool:
        """Whether a running program defines it, such as a notebook: no other process can import it."""
        return self.distribution == SESSION

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
        uses = (*getattr(self.cls, "uses", ()), *(bent_finders() if hasattr(self.cls, "geometry") else ()))
        called = (f"+{name}-{find('detectors', name).full_version}" for name in uses)
        return "".join([self.version, *called])


SESSION = "this session"
"""The distribution of a method that :func:`add_method` has registered."""
_files: dict[Path, list[Plugin]] = {}
_session: dict[str, Plugin] = {}


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
    require(file.is_file(), f"plugin {file}: there is no such file")
    found = _file_plugins(file, _import_file(file))
    require(bool(found), f"plugin {path}: defines no plugin; write a frozen dataclass with one of: {methods_wanted()}")
    for plugin in found:
        if wrong := fault(plugin.kind, plugin.cls):
            raise BadInput(f"plugin {path}: {wrong}")
        if plugin.name in names(plugin.kind) and plugin.name not in _session:
            raise BadInput(f"plugin {path}: the name {plugin.name!r} is taken; give the class another `name`")
    for plugin in found:  # a class that moves from a notebook to a file keeps its name
        _session.pop(plugin.name, None)
    _files[file] = found


def add_method(cls: type[Any]) -> str:
    """Register a method that this program defines, as a cell of a notebook does, and return its name.

    A class of a file that :func:`add_file` has loaded is registered already, also if it was imported in another way.
    Its version is a hash of the file that defines it. Without such a file, or if it is defined again, each definition
    is a version of its own, because what it calls may have changed.

    Raises
    ------
    BadInput
        When it is no valid method, or another plugin has its name.
    """
    name = str(getattr(cls, "name", cls.__name__.lower()))
    if wrong := fault("synthesizers", cls):
        raise BadInput(wrong)
    content, file = uuid.uuid4().bytes, Path()
    with contextlib.suppress(OSError, TypeError):
        file = Path(inspect.getfile(cls)).resolve()
        content = content if name in _session else file.read_bytes()
    known = {plugin.name: plugin.distribution for plugin in inventory("synthesizers")}
    if known.get(name) == str(file):
        return name
    if name in known and name not in _session:
        raise BadInput(f"method {cls.__name__}: the name {name!r} is taken; give the class another `name`")
    digest = hashlib.blake2b(content, digest_size=8).hexdigest()
    _session[name] = Plugin("synthesizers", name, SESSION, digest, cls)
    return name


def files() -> list[str]:
    """Return the paths of the plain files whose plugins are registered."""
    return [str(file) for file in _files]


@cache
def installed_points() -> Any:
    """Return the entry points of all installed distributions, which take long to read."""
    return entry_points()


@cache
def _installed(kind: str) -> list[Plugin]:
    """Return the plugins of a kind that entry points name; of the same name, those of nrbench come first."""
    known = [(point, *_name_and_version(point.dist)) for point in installed_points().select(group=f"nrbench.{kind}")]
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
    added = itertools.chain(*_files.values(), _session.values())
    return [*_installed(kind), *(plugin for plugin in added if plugin.kind == kind)]


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
        bent pictures; ``judge-detector``, which finds a lattice for scores; ``pictures``, which reads files;
        ``comparison``, which compares two runs; ``run-site``; ``tables``, which has the frames of a run; ``plot``,
        which has the plot of a run.
    """
    declared = installed_points().select(group="nrbench.roles", name=role)
    value = next(point.value for point in declared if _name_and_version(point.dist)[0] == "nrbench")
    points = (point for kind in FORMS for point in installed_points().select(group=f"nrbench.{kind}"))
    return str(next(point.name for point in points if point.value == value))


def bent_finders() -> tuple[str, str]:
    """Return the detectors that find the lattice of a bent sample: one that confirms lattices, and a quick one."""
    return in_role("detector"), in_role("quick-detector")


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
    masks: ClassVar[bool] = True

    def detect(self, image: Image, known: Mask | None = None) -> Detection:
        """Return what the detector finds; see :class:`~nrbench.plugins.forms.Detector`.

        Parameters
        ----------
        image
            The image.
        known
            The pixels that count. A detector that cannot leave out the others gets the filled image.

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
        from nrbench.plugins.forms import detect_known

        return detect_known(build("detectors", name, parameters), image, known)


ABILITIES: Final = {
    "wraps": "--tileable: {} cannot make an output that repeats without a seam",
    "masks": "{} cannot leave out transparent or masked pixels",
    "maps": "--with, --keep-alpha: {} cannot lay out other maps as its output",
    "fills": "--fill: {} cannot fill holes",
}
"""What a plugin lacks whose class variable of this name is not true."""


def describe_lack(kind: str, cls: type[Any], ability: str) -> str:
    """Return that a plugin's class lacks one of :data:`ABILITIES`, and which ones have it; empty if it has it."""
    if getattr(cls, ability, False):
        return ""
    able = ", ".join(one.name for one in inventory(kind) if getattr(one.cls, ability, False))
    return f"{ABILITIES[ability].format(name_of(kind, cls) or cls.__name__)}; {able or 'none'} can"


def require_abilities(kind: str, plugin: Any, **wanted: bool) -> None:
    """Raise :class:`BadInput` if a plugin lacks a wanted one of :data:`ABILITIES`; the message names those that can."""
    for lack in (describe_lack(kind, type(plugin), ability) for ability, needed in wanted.items() if needed):
        require(not lack, lack)


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
    return {field.name: plain_value(getattr(plugin, field.name)) for field in dataclasses.fields(plugin)}


def usual_parameters(kind: str, name: str, preset: str = "") -> dict[str, Any]:
    """Return the default parameters of a plugin, or those with a preset, as :func:`parameters_of` does.

    A parameter without a default is :data:`dataclasses.MISSING`.

    Raises
    ------
    BadInput
        When there is no such plugin, or it does not load.
    """
    cls: Any = find(kind, name).cls
    usual = {
        field.name: field.default_factory() if callable(field.default_factory) else field.default
        for field in dataclasses.fields(cls)
    }
    usual |= converted(cls, getattr(cls, "presets", {}).get(preset, {}), name)
    return {key: plain_value(value) for key, value in usual.items()}


def fault(kind: str, cls: Any) -> str:
    """Return one sentence about why a class is no valid plugin of a kind; empty if it is valid."""
    unknown = next((name for name in getattr(cls, "uses", ()) if name not in names("detectors")), None)
    if unknown is None or find_fault(kind, cls):
        return find_fault(kind, cls)
    noun = FORMS[kind].noun
    return f"{noun} {cls.__name__!r}: it uses {unknown!r}, which is no detector; see `nrbench list detectors`"


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
        for kind in kinds_of(cls)
    ]


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
    if not plugin.built_in:
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
