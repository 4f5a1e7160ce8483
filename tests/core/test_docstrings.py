"""The docstrings: sections are complete where users and authors of plugins read them, and all examples run."""

import doctest
import importlib
import inspect
from collections.abc import Iterator
from pathlib import Path
from types import FunctionType
from typing import Any

import pytest
from numpydoc.validate import validate

import nrbench
from nrbench import plugins

ROOT = Path(__file__).parents[2]
TOPS = ("nrbench", "synthesizers", "metrics", "datasets_procedural", "reports")
ERRORS = {
    *("GL03", "GL06", "GL07", "GL08", "SS01", "SS02", "SS03", "SS05", "PR01", "PR02", "PR03", "PR06", "PR07", "PR10"),
    *("RT01", "RT03", "RT05", "YD01", "RF02"),
}
"""Errors of numpydoc: missing or wrong summaries, parameters, and what is returned or yielded."""


def public_names() -> Iterator[str]:
    """Yield each function and class of ``nrbench``, and the public methods of the classes."""
    for name in sorted({*nrbench.__all__} - {"Deformation"}):
        value = getattr(nrbench, name)
        if inspect.isclass(value) or inspect.isfunction(value):
            yield f"{value.__module__}.{value.__qualname__}"
        for method, function in vars(value).items() if inspect.isclass(value) else ():
            is_default = method in getattr(value, "__dataclass_fields__", {})
            if isinstance(function, classmethod | FunctionType) and not method.startswith("_") and not is_default:
                yield f"{value.__module__}.{value.__qualname__}.{method}"


def own_plugins() -> Iterator[Any]:
    """Yield the class of each plugin of nrbench."""
    return (plugin.cls for kind in plugins.FORMS for plugin in plugins.inventory(kind) if plugin.built_in)


def find_errors(name: str, errors: set[str]) -> list[str]:
    """Return what numpydoc objects to in a docstring."""
    return [f"{name}: {message}" for code, message in validate(name)["errors"] if code in errors]


def test_the_docstrings_of_public_names_are_complete() -> None:
    """Each has a summary, all parameters and what it returns; functions and classes have an example."""
    found = []
    for name in public_names():
        is_method = name.rpartition(".")[0].rpartition(".")[2][0].isupper()
        found += find_errors(name, ERRORS if is_method else {*ERRORS, "EX01"})
    assert found == []


def test_the_docstrings_of_plugins_are_complete() -> None:
    """The page of each plugin has a summary and all parameters; that of a paper's plugin names the paper."""
    found = []
    for cls in own_plugins():
        found += find_errors(f"{cls.__module__}.{cls.__qualname__}", ERRORS)
        if getattr(cls, "paper", "") and "\nReferences\n" not in inspect.getdoc(cls):
            found.append(f"{cls.__name__}: no References")
    assert found == []


def modules_with_examples() -> list[str]:
    """Return the modules of the product whose source has an example."""
    files = [file for top in TOPS for file in (ROOT / top).rglob("*.py") if ">>> " in file.read_text("utf-8")]
    parts = [file.relative_to(ROOT).with_suffix("").parts for file in files]
    return sorted(".".join(each if each[0] == "nrbench" else ("nrbench", *each)) for each in parts)


@pytest.mark.parametrize("name", modules_with_examples())
def test_examples_run(name: str) -> None:
    """Each example in a docstring gives what it shows."""
    failed, tried = doctest.testmod(importlib.import_module(name), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert not failed
    assert tried
