"""What all tests share."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

FAULTS = Path(__file__).parent / "plugins" / "faulty_plugins.py"


@pytest.fixture
def faulty() -> Iterator[Path]:
    """Register the plugins that misbehave in every way, for one test."""
    from nrbench import plugins

    plugins.add_file(FAULTS)
    yield FAULTS
    plugins.registry._files.pop(FAULTS.resolve())


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run every test in an empty directory of its own."""
    monkeypatch.chdir(tmp_path)
    os.environ.setdefault("MPLBACKEND", "Agg")
