"""The package's public names: a function keeps its name though a module of the package is called the same."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any


class Package(ModuleType):
    """A package whose public functions are not replaced by submodules of the same name when those are imported.

    ``nrbench.texture`` is a function of the Python API, and ``nrbench/texture.py`` the module of what it returns:
    ``from nrbench.texture import Texture`` finds the module, whatever the attribute is.
    """

    def __setattr__(self, name: str, value: Any) -> None:
        """Bind a name, unless it is public and the value a submodule."""
        if not (isinstance(value, ModuleType) and name in self.__dict__.get("__all__", ())):
            super().__setattr__(name, value)


def keep_public(package: str) -> None:
    """Make a package keep its public names (``__all__``)."""
    sys.modules[package].__class__ = Package
