"""The installed suites: their files, and what they say of themselves, without a check of their content."""

from __future__ import annotations

import re
import tomllib
from functools import cache
from importlib.metadata import EntryPoint
from importlib.resources import files
from importlib.resources.abc import Traversable
from importlib.util import find_spec
from pathlib import Path

from nrbench.plugins.registry import installed_points


@cache
def builtin() -> dict[str, Traversable]:
    """Return the installed suites by name."""
    packages = [_suite_folder(point) for point in installed_points().select(group="nrbench.suites")]
    found = {item.name.removesuffix(".toml"): item for package in packages if package for item in package.iterdir()}
    return {name: item for name, item in sorted(found.items()) if item.name.endswith(".toml")}


def _suite_folder(point: EntryPoint) -> Traversable | None:
    """Return the folder of suites that an entry point names. No package of others is imported, only found."""
    if point.dist is not None and point.dist.name == "nrbench":
        return files(point.value)
    top, *inner = point.value.split(".")
    spec = find_spec(top)
    places = [Path(place, *inner) for place in (spec.submodule_search_locations if spec else None) or ()]
    return next((place for place in places if place.is_dir()), None)


def describe_suite(name: str) -> str:
    """Return the description of an installed suite, from the keys before its first table; empty if they hold none."""
    try:
        head = re.split(r"^\[", builtin()[name].read_text("utf-8"), maxsplit=1, flags=re.MULTILINE)[0]
        return str(tomllib.loads(head).get("description", ""))
    except ValueError:
        return ""
