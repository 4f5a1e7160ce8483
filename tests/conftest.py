"""What all tests share."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from faults import registered_faults
from hypothesis import HealthCheck, settings

from nrbench.plugins import registry

# A busy machine takes any time for an example, so no time limit says anything about the code.
settings.register_profile("nrbench", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("nrbench")


@pytest.fixture
def faulty() -> Iterator[Path]:
    """Register the plugins that misbehave, for one test."""
    with registered_faults() as path:
        yield path


@pytest.fixture(scope="module")
def faulty_run(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Any, Any], Any]:
    """Return a function that runs a suite with the plugins that misbehave, and reads the run back."""
    from nrbench import run

    def execute(suite: Any, options: Any) -> Any:
        with registered_faults():
            done = run(suite, out=tmp_path_factory.mktemp("faulty") / "run", options=options)
            assert done.cells  # read while the plugins are registered
        return done

    return execute


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run every test in an empty directory of its own, and forget the plugins of files that it has added."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(registry, "_files", dict(registry._files))
    os.environ.setdefault("MPLBACKEND", "Agg")
