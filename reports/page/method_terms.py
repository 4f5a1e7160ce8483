"""What the methods of a run declare about themselves: their classes, and how they copy patches."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from nrbench import plugins
from nrbench.runs.records import CellRecord, Run

from ..statistics.summaries import MethodSummary
from ..statistics.verdicts import PERILS


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


def group_by_family(run: Run, summaries: Sequence[MethodSummary]) -> dict[str, list[MethodSummary]]:
    """Return the ranked methods by the family that each declares, the best first; those without one come last."""
    plugin = {record.method: record.cell.method for record in run.cells}
    classes = method_classes(run.cells)
    groups: dict[str, list[MethodSummary]] = {}
    for one in sorted((each for each in summaries if each.rank), key=lambda each: each.rank or 0):
        family = str(getattr(classes.get(plugin[one.method.name]), "family", "")) or "other methods"
        groups.setdefault(family, []).append(one)
    return dict(sorted(groups.items(), key=lambda group: group[0] == "other methods"))


def order_by_peril(summaries: Sequence[MethodSummary]) -> dict[str, list[MethodSummary]]:
    """Return the methods that are no references by each peril, those that keep most first; unmeasured ones last."""
    own = [one for one in summaries if not one.method.reference]

    def kept(one: MethodSummary, peril: str) -> float:
        value = one.means[peril].value if peril in one.means else None
        return -1.0 if value is None else value

    measured = [peril for peril in PERILS if any(kept(one, peril) >= 0 for one in own)]
    return {peril: sorted(own, key=lambda one: -kept(one, peril)) for peril in measured}
