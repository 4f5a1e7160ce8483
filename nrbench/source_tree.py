"""Import the package from a source checkout, where the plugin folders lie beside ``nrbench/`` and not inside it."""

from __future__ import annotations

from collections.abc import MutableSequence
from pathlib import Path


def add_plugin_folders(search_path: MutableSequence[str]) -> None:
    """Add the root of a source checkout to the search path of the package; do nothing where it is installed.

    Python puts the working directory first on its path. In the root of a checkout it finds ``nrbench/`` there, which
    lacks ``nrbench.synthesizers`` and the other plugin folders until the root is searched for them too.

    Parameters
    ----------
    search_path
        ``nrbench.__path__``, changed in place.
    """
    root = Path(__file__).resolve().parents[1]
    if (root / "pyproject.toml").is_file() and (root / "synthesizers").is_dir():
        search_path.append(str(root))
