"""Ruff finds each import and call in the product that may run or fetch what a file or a stranger says."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
RISKS = {
    "import pickle": "TID251",
    "from urllib.request import urlopen": "TID251",
    "import http.client": "TID251",
    "eval(x)": "S307",
    "exec(x)": "S102",
    "import os; os.system(x)": "S605",
    "import subprocess; subprocess.run(x, shell=True)": "S602",
    "import numpy as np; np.load(x)": "TID251",
    "import pandas as pd; pd.read_pickle(x)": "TID251",
}


@pytest.mark.parametrize("line", RISKS)
def test_each_risk_is_seen(line: str) -> None:
    """Each line is an error in a module of the product."""
    command = [
        sys.executable,
        "-m",
        "ruff",
        "check",
        "--stdin-filename",
        "nrbench/module.py",
        "--output-format",
        "json",
    ]
    found = subprocess.run([*command, "-"], input=line, cwd=ROOT, capture_output=True, text=True, check=False)
    assert f'"{RISKS[line]}"' in found.stdout
