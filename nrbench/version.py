"""The version of the installed distribution."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("nrbench")
except PackageNotFoundError:  # a source checkout that is not installed
    __version__ = "unknown"
