"""A small run whose outputs are labelled."""

import shutil
from pathlib import Path

import pytest

import nrbench
from nrbench.running.runner import Options
from nrbench.runs.records import Run
from nrbench.suites.suite import load_suite


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a small run once: two textures of known lattice, three methods, two draws."""
    root = tmp_path_factory.mktemp("labels") / "run"
    methods = ("oracle", "tiling", "scatter")
    changes = {"sample": "64x64", "size": "96x96", "replicates": 2, "lattice": ("given",), "methods": methods}
    suite = load_suite("default").with_changes(metrics=["cost"], references_once=False)
    nrbench.run(suite, textures=("brick-strong", "hexagon-strong"), out=root, options=Options(jobs=0), **changes)
    return root


@pytest.fixture
def run(made: Path, tmp_path: Path) -> Run:
    """Return a copy of the run, for one test."""
    return Run(Path(shutil.copytree(made, tmp_path / "run")))
