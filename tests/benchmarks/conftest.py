"""The scripts of benchmarks/, which pytest finds as if they were started in their folder."""

import importlib
from types import ModuleType

import pytest


@pytest.fixture
def script(request: pytest.FixtureRequest) -> ModuleType:
    """Import the script that the module of a test is named after."""
    return importlib.import_module(request.path.stem.removeprefix("test_"))
