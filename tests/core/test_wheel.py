"""The wheel: all that a stranger needs is in it, and nothing of ours lies beside the one package."""

import csv
import os
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
METRICS = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["entry-points"]["nrbench.metrics"]
PARTS = (
    "nrbench",
    "synthesizers",
    "metrics",
    "datasets_procedural",
    "reports",
    "pyproject.toml",
    "README.md",
    "LICENSE",
)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel from a copy of the sources."""
    place = tmp_path_factory.mktemp("wheel")
    for part in PARTS:
        copy = shutil.copytree if (ROOT / part).is_dir() else shutil.copy
        copy(ROOT / part, place / part)
    options = ["--no-deps", "--no-build-isolation", "--quiet", "--wheel-dir", str(place / "dist")]
    subprocess.run([sys.executable, "-m", "pip", "wheel", str(place), *options], check=True, capture_output=True)
    return next((place / "dist").glob("*.whl"))


def test_only_one_package_is_installed(wheel: Path) -> None:
    """The wheel holds `nrbench` and its metadata alone, templates, suites and type marker included."""
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0].split("-")[0] for name in names} == {"nrbench"}
    for needed in ("nrbench/py.typed", "nrbench/__init__.pyi", "nrbench/datasets_procedural/suites/core.toml"):
        assert needed in names
    assert any(name.startswith("nrbench/reports/page/templates/") and name.endswith(".html") for name in names)


SUITE = """
name = "small"
sample = "48x48"
size = "48x48"
methods = ["scatter"]
texture = [{ name = "brick", dataset = "brick" }]
"""
PROGRAM = """
import sys
import nrbench
from nrbench.cli.main import main

print(nrbench.__file__)
for line in sys.argv[1:]:
    print("$ nrbench", line)
    try:
        main(line.split())
    except SystemExit as left:
        assert not left.code, (line, left.code)
"""


def test_it_runs_from_an_empty_directory(wheel: Path, tmp_path: Path) -> None:
    """Installed into an empty environment the wheel lists, runs with all metrics, and reports.

    A path file adds the dependencies. Kernels run as plain Python: numba would compile all of them for the new path,
    which takes a minute. On so small a texture plain Python is as fast as compiling the few kernels that it needs.
    """
    place = tmp_path / "environment"
    venv.create(place, with_pip=False)
    python = place / ("Scripts" if os.name == "nt" else "bin") / "python"
    paths = sysconfig.get_paths(vars={"base": str(place), "platbase": str(place)})
    zipfile.ZipFile(wheel).extractall(paths["purelib"])
    installed = "\n".join(folder for folder in sys.path if folder.endswith("-packages"))
    (Path(paths["purelib"]) / "dependencies.pth").write_text(installed)
    empty = tmp_path / "empty"
    empty.mkdir()
    (empty / "small.toml").write_text(SUITE)
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [python, "-c", PROGRAM, "list", "run small.toml --out run --jobs 1", "report run --format html"],
        cwd=empty,
        env={**environment, "NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    where, listed, run, report = done.stdout.split("$ nrbench")
    assert str(place) in where
    assert "BROKEN" not in listed and "rsgf" in listed
    assert "report:" in run
    (row,) = csv.DictReader((empty / "run" / "tables" / "cells.csv").read_text("utf-8").splitlines())
    assert row["status"] == "ok"
    assert {name.partition(".")[0] for name in row if "." in name} == set(METRICS)
    assert row["regularity.score"] and row["appearance.whole"] and row["source.used"]
    assert "report.html" in report


def test_the_source_distribution_gives_the_same_wheel(wheel: Path, tmp_path: Path) -> None:
    """The sdist holds all that the wheel is built from: the wheel that is built from it has the same files."""
    pytest.importorskip("build", reason="build is not installed: pip install nrbench[test]")
    source = wheel.parents[1]
    command = [sys.executable, "-m", "build", "--sdist", "--no-isolation", "--outdir", str(tmp_path), str(source)]
    subprocess.run(command, check=True, capture_output=True)
    archive = next(tmp_path.glob("*.tar.gz"))
    shutil.unpack_archive(archive, tmp_path / "unpacked")
    place = next((tmp_path / "unpacked").iterdir())
    assert (place / "LICENSE").is_file() and (place / "README.md").is_file()
    options = ["--no-deps", "--no-build-isolation", "--quiet", "--wheel-dir", str(tmp_path / "dist")]
    subprocess.run([sys.executable, "-m", "pip", "wheel", str(place), *options], check=True, capture_output=True)
    rebuilt = next((tmp_path / "dist").glob("*.whl"))
    assert zipfile.ZipFile(rebuilt).namelist() == zipfile.ZipFile(wheel).namelist()
