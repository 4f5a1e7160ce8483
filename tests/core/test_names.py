"""The package's public names."""

from __future__ import annotations

import subprocess
import sys

import pytest


@pytest.mark.parametrize(
    "first", ["import nrbench.texture", "from nrbench import plugins", "from nrbench.texture import Texture", "pass"]
)
def test_a_function_keeps_its_name_beside_a_module(first: str) -> None:
    """``nrbench.texture`` is the function, whatever was imported before."""
    code = f"{first}; import nrbench; print(nrbench.texture('brick', shape=(16, 16)).image.shape)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "(16, 16, 3)", done.stderr
