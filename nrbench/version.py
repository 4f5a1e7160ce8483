"""The version of the installed distribution."""

from __future__ import annotations

import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

try:
    __version__ = version("nrbench")
except PackageNotFoundError:  # a source checkout that is not installed
    __version__ = "unknown"


def read_checkout() -> dict[str, Any] | None:
    """Return the commit of the package's checkout, and whether it is unchanged; None without a checkout."""
    package = Path(__file__).parent
    if not (package.parent / ".git").exists():
        return None

    def run_git(*words: str) -> str:
        command = ["git", "-C", str(package), *words]
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()

    try:
        return {"commit": run_git("rev-parse", "HEAD"), "clean": not run_git("status", "--porcelain")}
    except (OSError, subprocess.SubprocessError):
        return None


def describe_version() -> str:
    """Return the version, with the commit where the package runs from a checkout."""
    found = read_checkout()
    if found is None:
        return __version__
    return f"{__version__} (commit {found['commit'][:12]}{'' if found['clean'] else ', with changes'})"
