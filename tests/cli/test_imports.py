"""The commands import what they need: a short command is not slowed down by libraries that it does not use."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import nrbench
from nrbench import run
from nrbench.pictures.files import write_image
from nrbench.running.runner import Options
from nrbench.running.worker import DEFERRED

ROOT = Path(__file__).parents[2]
HEAVY = (
    "matplotlib",
    "nrbench.metrics.cost",
    "numba",
    "pandas",
    "pydantic",
    "scipy.interpolate",
    "scipy.linalg",
    "scipy.ndimage",
    "scipy.signal",
    "scipy.stats",
)
SCRIPT = """
import sys
from nrbench.cli.main import main
try:
    main(sys.argv[1:])
finally:
    print("IMPORTED", *[name for name in {heavy!r} if name in sys.modules], file=sys.stderr)
"""


def imported(command: str, folder: Path) -> set[str]:
    """Return which of :data:`HEAVY` a command imports in a new interpreter."""
    script = SCRIPT.format(heavy=HEAVY)
    words = [sys.executable, "-c", script, *command.split()]
    ended = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    line = next(line for line in ended.stderr.splitlines() if line.startswith("IMPORTED"))
    return set(line.split()[1:])


@pytest.mark.parametrize(
    ("command", "allowed"),
    [
        ("--help", ""),
        ("list", "pydantic"),
        ("show rsgf", "pydantic"),
        ("plan core -t brick-mild -m rsgf", "pydantic"),
        ("synth missing.png -m rsgf --size 64x64 -o out.png", ""),
        ("score missing.png missing.png", ""),
    ],
)
def test_a_command_imports_what_it_needs(tmp_path: Path, command: str, allowed: str) -> None:
    """Listings, plans and errors about missing files import no plotting, table, compiler or statistics library."""
    assert imported(command, tmp_path) <= set(allowed.split())


def test_synth_imports_no_tables_and_no_statistics(tmp_path: Path) -> None:
    """To make one picture, numpy and the kernels are enough, which are loaded without the compiler."""
    texture = nrbench.texture("brick", shape=(128, 128))
    write_image(tmp_path / "brick.png", texture.image)
    nrbench.synthesize("rsgf", texture.image, (128, 128), lattice=texture.lattice)  # compiles what has to be compiled
    command = "synth brick.png -m rsgf --size 128x128 --lattice 27.3,0,13.65,12.2 -o out.png"
    assert imported(command, tmp_path) == set()
    assert (tmp_path / "out.png").is_file()


def test_status_of_a_run_imports_no_tables_and_no_statistics(tmp_path: Path) -> None:
    """To count how cells ended, and to read why metrics failed, no metric is imported."""
    run("core", methods=["scatter"], textures="brick-mild", out=tmp_path / "R", options=Options(jobs=0), size="128x128")
    assert imported("status R", tmp_path) == {"pydantic"}


def test_a_worker_imports_all_that_is_imported_on_first_use() -> None:
    """A module of scipy or scikit-image that a plugin imports on first use is imported before children are forked."""
    folders = ("nrbench", "synthesizers", "metrics", "datasets_procedural")
    sources = "".join(file.read_text("utf-8") for folder in folders for file in (ROOT / folder).rglob("*.py"))
    used = set(re.findall(r"(?<![`\w.\"])((?:scipy|skimage)\.[a-z]+)\.\w", sources)) - {"skimage.draw"}
    assert used <= {".".join(name.split(".")[:2]) for name in DEFERRED}
