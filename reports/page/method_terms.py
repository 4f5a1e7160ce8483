"""What the methods of a run declare about themselves: their classes, and how they copy patches."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from nrbench import plugins
from nrbench.runs.records import CellRecord, Run


def method_classes(cells: Iterable[CellRecord]) -> dict[str, type | None]:
    """Return the class of each installed method of some cells by its name, in the order of the cells."""
    names = dict.fromkeys(record.cell.method for record in cells)
    installed = set(plugins.names("synthesizers"))
    return {name: plugins.find("synthesizers", name).cls for name in names if name in installed}


def list_patch_terms(run: Run) -> list[tuple[str, ...]]:
    """Return the rows of table 1 of the report of 2004, as the methods that copy patches declare for their parameters.

    Returns
    -------
    list of tuple
        The method, what a patch is, how its place is chosen, and how it is joined to the others.
    """
    records = {record.method: record for record in run.cells if not record.cell.reference}
    classes = method_classes(records.values())
    found = {
        name: plugins.describe_patches(cls, {**_defaults(cls), **record.parameters})
        for name, record in records.items()
        if (cls := classes.get(record.cell.method)) is not None
    }
    return [(name, *terms) for name, terms in found.items() if len(terms) == len(plugins.PATCH_TERMS)]


def _defaults(cls: type) -> dict[str, Any]:
    return {name: getattr(cls, name, "") for name in getattr(cls, "__dataclass_fields__", {})}
