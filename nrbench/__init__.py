"""nrbench: a benchmark for near-regular texture synthesis."""

from typing import Any

import lazy_loader

from nrbench.source_tree import add_plugin_folders

add_plugin_folders(__path__)
_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    """Return a public name, which is imported on first use; the old name of one that has changed is deprecated."""
    if name == "Sheet":
        import warnings

        warnings.warn("nrbench.Sheet is called nrbench.Scores now", DeprecationWarning, stacklevel=2)
        name = "Scores"
    return _load(name)
