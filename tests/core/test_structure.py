"""The structure of the source tree: where plugins lie, and which folder may import which."""

import ast
import importlib
import inspect
import re
import tomllib
from collections import Counter
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from typing import get_type_hints

import pytest

from nrbench.jit import KERNELS

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
WINGS = ("synthesizers", "metrics", "datasets_procedural", "reports")
PLUGIN_FOLDERS = {
    "nrbench.datasets": "nrbench.datasets_procedural",
    "nrbench.detectors": "nrbench.detectors",
    "nrbench.synthesizers": "nrbench.synthesizers",
    "nrbench.metrics": "nrbench.metrics",
    "nrbench.reports": "nrbench.reports",
}
FLOORS = (
    ("nrbench.cli", "nrbench.__main__"),
    ("nrbench.api",),
    ("nrbench.reports",),
    ("nrbench.labelling", "nrbench.authoring"),
    ("nrbench.running",),
    ("nrbench.runs",),
    ("nrbench.suites",),
    ("nrbench.synthesizers", "nrbench.metrics", "nrbench.datasets_procedural", "nrbench.detectors"),
    ("nrbench.calling",),
    ("nrbench.displacement",),
    ("nrbench.plugins",),
    ("nrbench.spectra",),
    ("nrbench.pictures",),
    ("nrbench.imaging", "nrbench.streams"),
    ("nrbench.lattice",),
    (
        "nrbench.errors",
        "nrbench.flags",
        "nrbench.storage",
        "nrbench.jit",
        "nrbench.work",
        "nrbench.source_tree",
        "nrbench.version",
    ),
)
"""From the highest to the lowest. A module imports its own floor and those below; docs/structure.md shows the same."""


@cache
def modules() -> dict[str, Path]:
    """Return the files of all modules by their dotted names."""
    folders = {"nrbench": ROOT / "nrbench"} | {f"nrbench.{wing}": ROOT / wing for wing in WINGS}
    found = {}
    for package, folder in folders.items():
        for file in folder.rglob("*.py"):
            parts = file.relative_to(folder).with_suffix("").parts
            found[".".join((package, *(parts[:-1] if parts[-1] == "__init__" else parts)))] = file
    return found


def package_of(module: str) -> str:
    """Return the package that a module lies in; a package lies in itself."""
    return module if modules()[module].name == "__init__.py" else module.rpartition(".")[0]


@cache
def imports(module: str) -> frozenset[str]:
    """Return the modules of the project that a module imports, inside functions too."""
    return frozenset(found for found in _imports(module) if found != module)


def _imports(module: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(modules()[module].read_text("utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in modules())
        elif isinstance(node, ast.ImportFrom):
            above = package_of(module).split(".")
            above = above[: len(above) - node.level + 1] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            for alias in node.names:
                name = f"{base}.{alias.name}"
                yield from (found for found in (name if name in modules() else base,) if found in modules())


def floor_of(module: str) -> int | None:
    """Return the number of a module's floor from above; None for the package's own public names."""
    for number, packages in enumerate(FLOORS):
        if any(module == package or module.startswith(f"{package}.") for package in packages):
            return number
    assert module == "nrbench", f"{module} stands on no floor: add it to FLOORS and to docs/structure.md"
    return None


@pytest.mark.parametrize(("group", "folder"), PLUGIN_FOLDERS.items())
def test_the_top_level_of_a_plugin_folder_holds_plugins_alone(group: str, folder: str) -> None:
    """Each plugin's file is named like the plugin, and each file beside ``__init__.py`` is a plugin's."""
    declared = PROJECT["project"]["entry-points"][group]
    files = {name.rpartition(".")[2] for name in modules() if package_of(name) == folder and name != folder}
    assert {name.replace("-", "_") for name in declared} == files
    for name, value in declared.items():
        assert value.partition(":")[0] == f"{folder}.{name.replace('-', '_')}"


def test_no_plugin_folder_imports_another() -> None:
    """Methods, metrics, models and reports share the core only; all of them may import detectors."""
    for module in modules():
        own = [folder for folder in PLUGIN_FOLDERS.values() if f"{module}.".startswith(f"{folder}.")]
        for imported in imports(module) if own else ():
            others = set(PLUGIN_FOLDERS.values()) - {*own, "nrbench.detectors"}
            assert not any(f"{imported}.".startswith(f"{other}.") for other in others), f"{module} imports {imported}"


def test_imports_run_down() -> None:
    """No module imports one of a higher floor, and the core names no plugin."""
    for module in modules():
        floor = floor_of(module)
        for imported in imports(module) if floor is not None else ():
            below = floor_of(imported)
            assert below is not None and below >= floor, f"{module} imports {imported}, which stands above it"


def test_the_core_names_no_plugin() -> None:
    """Only plugin folders import from plugin folders: the core finds plugins by their entry points."""
    for module in modules():
        if not f"{module}.".startswith(tuple(f"{folder}." for folder in PLUGIN_FOLDERS.values())):
            named = [name for name in imports(module) if name.startswith(tuple(PLUGIN_FOLDERS.values()))]
            assert not named, f"{module} imports {named}"


WORDS = {"figure", "json", "noise", "site", "text"}
"""Names of plugins that also are words of the core; they count only where a plugin is looked up."""
LOOKUPS = {"build", "find", "NamedDetector", "Recipe"}


def test_the_core_builds_no_plugin_by_name() -> None:
    """No text of the core is a plugin's name: suites, roles of ``pyproject.toml`` and plugins themselves name plugins.

    Metrics are words of all tables; they count only where a plugin is looked up.
    """
    points = PROJECT["project"]["entry-points"]
    metrics = {*points["nrbench.metrics"], *WORDS}
    others = {name for group in PLUGIN_FOLDERS for name in points[group]} - metrics
    found = set()
    for module, file in modules().items():
        if module.startswith(tuple(PLUGIN_FOLDERS.values())):
            continue
        nodes = list(ast.walk(ast.parse(file.read_text("utf-8"))))
        calls = (node for node in nodes if isinstance(node, ast.Call))
        lookups = [call for call in calls if getattr(call.func, "attr", getattr(call.func, "id", "")) in LOOKUPS]
        looked_up = [each for call in lookups for argument in call.args for each in ast.walk(argument)]
        for wanted, texts in ((others, nodes), (metrics, looked_up)):
            names = (node.value.partition(":")[0] for node in texts if isinstance(getattr(node, "value", 0), str))
            found |= {(module, name) for name in names if name in wanted}
    assert not found


def test_no_two_packages_import_each_other() -> None:
    """The packages can be read one after another: their imports have no circle."""
    graph: dict[str, set[str]] = {}
    for module in modules():
        own = package_of(module)
        if own != "nrbench":
            graph.setdefault(own, set()).update(
                package for package in map(package_of, imports(module)) if package not in (own, "nrbench")
            )
    tuple(TopologicalSorter(graph).static_order())


def test_no_two_modules_import_each_other() -> None:
    """Nor have the modules' imports a circle, inside functions either."""
    tuple(TopologicalSorter({module: set(imports(module)) for module in modules()}).static_order())


def test_an_init_file_holds_imports_only() -> None:
    """A package's ``__init__.py`` computes nothing but the names it exports."""
    for module, file in modules().items():
        if file.name == "__init__.py" and module != "nrbench":
            first, *rest = ast.parse(file.read_text("utf-8")).body
            assert isinstance(first, ast.Expr), f"{module} has no docstring"
            for node in rest:
                assert isinstance(node, ast.ImportFrom | ast.Import | ast.Assign), f"{module}, line {node.lineno}"


def test_every_package_is_declared_for_the_wheel() -> None:
    """``pyproject.toml`` lists the packages and their folders of templates, so that a wheel lacks none."""
    there = {name for name, file in modules().items() if file.name == "__init__.py"}
    there |= {f"{name}.templates" for name in there if (modules()[name].parent / "templates").is_dir()}
    assert set(PROJECT["tool"]["setuptools"]["packages"]) == there


# fmt: off
CLASHES: dict[str, set[str]] = {"modules": set(), "classes": set(), "functions": set()}
"""Names that still have two meanings. A name that is mended leaves this list."""
LONG: set[str] = set()
"""Functions that still have more than :data:`LONGEST` lines."""
# fmt: on
LONGEST = 90


@cache
def definitions(kind: str) -> list[str]:
    """Return the names of all modules, of all classes, or of all public functions at the top level of modules."""
    if kind == "modules":
        return [module.rpartition(".")[2] for module, file in modules().items() if file.name != "__init__.py"]
    wanted = ast.ClassDef if kind == "classes" else ast.FunctionDef
    nodes = (node for file in modules().values() for node in ast.parse(file.read_text("utf-8")).body)
    names = [node.name for node in nodes if isinstance(node, wanted)]
    return [name.lstrip("_") for name in names] if kind == "classes" else [n for n in names if not n.startswith("_")]


@pytest.mark.parametrize("kind", CLASHES)
def test_a_name_has_one_meaning(kind: str) -> None:
    """No two modules, classes or public functions of the product have the same name."""
    twice = {name for name, count in Counter(definitions(kind)).items() if count > 1}
    assert twice <= CLASHES[kind]


def test_functions_are_short() -> None:
    """No function of the product has more than 90 lines, from its ``def`` to its end."""
    for module, file in modules().items():
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if isinstance(node, ast.FunctionDef) and node.name not in LONG:
                lines = (node.end_lineno or 0) - node.lineno + 1
                assert lines <= LONGEST, f"{module}.{node.name} has {lines} lines"


def test_long_kernels_state_their_recurrence() -> None:
    """The docstring of a kernel of more than 30 lines has notes: its recurrence or its steps, and their source."""
    silent = []
    for name, file in modules().items():
        if not name.endswith("_kernels"):
            continue
        for node in ast.parse(file.read_text("utf-8")).body:
            if isinstance(node, ast.FunctionDef) and "Notes\n-----" not in (ast.get_docstring(node) or ""):
                statements = node.body[1:] if ast.get_docstring(node) else node.body
                body = ast.unparse(ast.Module(statements, []))
                if len(body.splitlines()) > 30:
                    silent.append(f"{name}.{node.name}")
    assert not silent


def test_kernels_with_records_count_references_only_if_they_make_arrays() -> None:
    """To count references to the arrays of a record at each step takes longer than the steps."""
    for name in modules():
        if name.endswith("_kernels"):
            importlib.import_module(name)
    taken = 0
    for declared in (each for each in KERNELS if each.function.__module__ in modules() and not each.inlined):
        if any(hasattr(hint, "_fields") for hint in get_type_hints(declared.function).values()):
            makes = re.search(r"np\.(empty|zeros|ones|full|arange|array)\b", inspect.getsource(declared.function))
            assert declared.allocates == (makes is not None), declared.function.__name__
            taken += 1
    assert taken > 10
