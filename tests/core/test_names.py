"""The package's public names, and where the package can be imported."""

import subprocess
import sys
from pathlib import Path

import pytest

import nrbench

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("first", ["import nrbench.plugins.forms", "from nrbench import plugins", "pass"])
def test_a_function_keeps_its_name_beside_a_module(first: str) -> None:
    """``nrbench.texture`` is the function, whatever was imported before."""
    code = f"{first}; import nrbench; print(nrbench.texture('brick', shape=(16, 16)).image.shape)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "(16, 16, 3)", done.stderr


def test_the_package_imports_in_the_root_of_a_checkout() -> None:
    """In the repository's root, where the source folder shadows the installed package, methods load."""
    code = (
        "import nrbench, numpy; image = numpy.random.default_rng(0).random((64, 64)); "
        "print(nrbench.synthesize('scatter', image, (16, 16), block=8).image.shape)"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=ROOT, env={}, capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "(16, 16)", done.stderr


def test_a_name_that_has_changed_is_deprecated() -> None:
    """``nrbench.Sheet`` is ``nrbench.Scores``, with a warning."""
    with pytest.warns(DeprecationWarning, match="Scores"):
        assert nrbench.Sheet is nrbench.Scores
