"""Choose methods and textures of a comparison by names and patterns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import TypeVar

from nrbench.errors import BadInput

from .method_comparison import Comparison

T = TypeVar("T")


def match_names(kind: str, patterns: Sequence[str], items: Sequence[tuple[tuple[str, ...], T]]) -> list[T]:
    """Return the items one of whose names is a pattern or matches it, each once, in the order of the patterns.

    Parameters
    ----------
    kind
        What the items are, for the error.
    patterns
        Names, or patterns such as ``brick-*``.
    items
        Each with its names.

    Raises
    ------
    BadInput
        If a pattern names no item.
    """
    found: list[T] = []
    for pattern in patterns:
        known = [item for names, item in items if pattern in names or any(fnmatchcase(n, pattern) for n in names)]
        if not known:
            listed = ", ".join(names[0] for names, _ in items)
            raise BadInput(f"no {kind} {pattern!r} in this run; give some of: {listed}")
        found += [item for item in known if item not in found]
    return found


def restrict_comparison(comparison: Comparison, methods: Sequence[str], textures: Sequence[str]) -> Comparison:
    """Return the columns and rows of a comparison that patterns name, in the order of the comparison.

    Ranks, means and tests remain those of all methods on all textures.

    Parameters
    ----------
    comparison
        The comparison.
    methods, textures
        Names or patterns; empty for all. A method has its name, and its name with the source of the lattice in
        parentheses.

    Raises
    ------
    BadInput
        If a pattern names nothing.
    """
    of_methods = [((one.label, one.name), i) for i, one in enumerate(comparison.methods)]
    of_rows = [((row.texture,), i) for i, row in enumerate(comparison.rows)]
    columns = sorted(match_names("method", methods or "*", of_methods))
    rows = sorted(match_names("texture", textures or "*", of_rows))
    return replace(
        comparison,
        methods=[comparison.methods[i] for i in columns],
        summaries=[comparison.summaries[i] for i in columns],
        rows=[
            replace(row, entries=[row.entries[i] for i in columns]) for row in map(comparison.rows.__getitem__, rows)
        ],
        summary_rows=[
            replace(
                line,
                estimates=[line.estimates[i] for i in columns],
                blanks=[line.blanks[i] for i in columns] if line.blanks else (),
            )
            for line in comparison.summary_rows
        ],
    )
