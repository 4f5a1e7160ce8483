"""The contract of a method in docs/plugins.md: the tables hold what a task has and what methods declare."""

import dataclasses
import re
from pathlib import Path
from typing import get_type_hints

from nrbench import Task, plugins

PAGE = (Path(__file__).parents[2] / "docs" / "plugins.md").read_text("utf-8")


def listed(heading: str) -> set[str]:
    """Return the names in the first column of the tables whose header begins with a text."""
    tables = re.findall(rf"(?m)^\| {heading}.*\n\|.*\n((?:\|.*\n)+)", PAGE)
    return {name for table in tables for row in table.splitlines() for name in re.findall(r"`(\w+)", row.split("|")[1])}


def test_the_fields_of_a_task_are_listed() -> None:
    """The table of a task has its fields, and no other."""
    assert listed("field of `Task`") == {field.name for field in dataclasses.fields(Task)}


def test_what_methods_declare_is_listed() -> None:
    """Each public class variable of a method is listed, and what is listed beside them belongs to other kinds."""
    classes = [plugin.cls for plugin in plugins.inventory("synthesizers") if plugin.built_in and plugin.cls]
    declared = {
        name
        for cls in classes
        for name, hint in get_type_hints(cls).items()
        if "ClassVar" in str(hint) and not name.startswith("_")
    }
    assert declared <= listed("attribute")
    has = {name for name in listed("attribute") for cls in classes if hasattr(cls, name)}
    assert listed("attribute") - has == {"name", "uses"}
