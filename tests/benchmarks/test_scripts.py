"""The scripts in benchmarks/ fit the present names of the package."""

import importlib
from pathlib import Path

import all as benchmarks
import pytest

NAMES = sorted(path.stem for path in Path(benchmarks.__file__).parent.glob("*.py"))


@pytest.mark.parametrize("name", NAMES)
def test_every_script_can_be_imported(name: str) -> None:
    """A script that imports a name which is gone fails here, not after half an hour of benchmarks."""
    assert importlib.import_module(name).__doc__


def test_the_list_names_every_script() -> None:
    """`make benchmark` starts each script of the folder but helpers and `make soak`'s, and none that does not exist."""
    listed = {command.split()[0] for command in benchmarks.BENCHMARKS}
    helpers = {"all.py", "unit.py", "edits.py", "texture_kinds.py", "trivial_cells.py", "studies.py"}
    helpers |= {"soak.py", "gallery.py", "pictures.py"}  # which draw the pictures of the docs
    assert listed == {f"{name}.py" for name in NAMES} - helpers
