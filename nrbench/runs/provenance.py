"""Provenance: what a run was made with."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Sequence
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

import psutil

from nrbench import plugins
from nrbench.suites.cell import RESULTS_VERSION


def provenance(argv: Sequence[str]) -> dict[str, Any]:
    """Return argv, versions of all that is installed, the plugins, the machine and the state of the source tree."""
    return {
        "argv": list(argv),
        "results_version": RESULTS_VERSION,
        "versions": {"python": platform.python_version(), **_versions()},
        "plugins": [_plugin(plugin) for kind in plugins.FORMS for plugin in plugins.inventory(kind)],
        "machine": _machine(),
        "git": _git(Path(__file__).parent),
    }


def _versions() -> dict[str, str]:
    found = {str(item.metadata["Name"]).lower(): item.version for item in distributions() if item.metadata["Name"]}
    return dict(sorted(found.items()))


def _plugin(plugin: plugins.Plugin) -> dict[str, str]:
    shown = {"kind": plugin.kind, "name": plugin.name, "distribution": plugin.distribution, "version": plugin.version}
    return {**shown, "error": plugin.error} if plugin.error else shown


def _machine() -> dict[str, Any]:
    memory = psutil.virtual_memory().total
    cores = os.cpu_count()
    return {
        "system": platform.platform(),
        "processor": _processor(),
        "cores": cores,
        "memory_gib": round(memory / 2**30, 1),
    }


def _processor() -> str:
    if sys.platform.startswith("linux"):
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as info:  # noqa: PTH123
            models = [line.partition(":")[2].strip() for line in info if line.startswith("model name")]
        if models:
            return models[0]
    return platform.processor() or platform.machine()


def _git(directory: Path) -> dict[str, Any] | None:
    """Return commit and cleanness of the source tree that this package runs from; None where it is installed."""
    if not (directory.parent / ".git").exists():
        return None
    try:
        commit = _git_answer(directory, "rev-parse", "HEAD")
        return {"commit": commit, "clean": not _git_answer(directory, "status", "--porcelain")}
    except (OSError, subprocess.SubprocessError):
        return None


def _git_answer(directory: Path, *words: str) -> str:
    done = subprocess.run(["git", "-C", str(directory), *words], capture_output=True, text=True, check=True, timeout=10)
    return done.stdout.strip()
