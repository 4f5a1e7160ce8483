"""The version of the installed distribution."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, metadata, version
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


def find_project(info: Mapping[str, Any]) -> dict[str, Any]:
    """Return the commit that made a run, and the pages of the project and of this commit.

    The pages are those of the metadata of the distribution, and empty while it names none.

    Parameters
    ----------
    info
        The content of ``run.json``.
    """
    source = info.get("git") if isinstance(info.get("git"), dict) else None
    commit = str((source or {}).get("commit", ""))
    try:
        named = dict(each.split(", ", 1) for each in metadata("nrbench").get_all("Project-URL") or [])
    except (PackageNotFoundError, ValueError):
        named = {}
    pages = {label.lower(): page for label, page in named.items() if page.startswith("https://")}
    home = next((pages[label] for label in ("repository", "source", "homepage") if label in pages), "").rstrip("/")
    page = f"{home}/commit/{commit}" if home and re.fullmatch("[0-9a-f]{40}", commit) else ""
    return {"home": home, "commit": commit, "clean": bool((source or {}).get("clean", True)), "commit_page": page}
