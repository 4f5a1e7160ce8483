"""How the process of a command starts sooner: less garbage collection, and libraries' modules that it does not use."""

from __future__ import annotations

import gc
import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from types import ModuleType

POSTPONED = frozenset({"numpy.f2py", "numpy.testing", "scipy.spatial.transform", "yaml"})
"""Modules that scipy and numba import, and of which commands use nothing."""
COLLECT_AFTER = 500_000
"""New objects after which garbage is collected. Imports alone make about 300 000, and none of them is garbage."""


def start_quickly() -> None:
    """Collect garbage less often, and run the modules :data:`POSTPONED` only when an attribute of theirs is read.

    This changes the state of the interpreter. Only the process of a command calls it, never a program that imports
    nrbench. Modules that are imported already stay as they are.
    """
    gc.set_threshold(COLLECT_AFTER, *gc.get_threshold()[1:])
    if not any(isinstance(finder, _Postponing) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Postponing())


class _Postponing(MetaPathFinder):
    """Finds the modules :data:`POSTPONED`, with a loader that runs them on first use."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the specification of a module; None for a module that is not postponed."""
        spec = PathFinder.find_spec(fullname, path, target) if fullname in POSTPONED else None
        if spec is not None and spec.loader is not None:
            spec.loader = LazyLoader(spec.loader)
        return spec
