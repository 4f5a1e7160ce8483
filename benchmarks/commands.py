"""What short commands cost from cold: the CPU time of the whole process, in units u.

Each command runs in a new interpreter, whose modules are compiled already; the least of three is printed.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from unit import cpu_unit

import nrbench
from nrbench.api import run
from nrbench.imaging.files import write_image
from nrbench.running.runner import Options

COMMANDS = (
    "--help",
    "list",
    "show rsgf",
    "plan core",
    "status missing",
    "status R",
    "run missing.toml",
    "synth brick.png -m rsgf --size 256x256 --lattice 27.3,0,13.65,12.2 -o out.png",
    "synth brick.png -m quilting --size 256x256 -o out.png",
)


def cpu_seconds(command: str) -> float:
    """Return the CPU seconds of a command in a new interpreter."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-m", "nrbench", *command.split()], env=environment, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Print one line for each command."""
    os.environ.setdefault("PYTHONPYCACHEPREFIX", tempfile.mkdtemp())
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        write_image(Path("brick.png"), nrbench.texture("brick", shape=(128, 128), color=0.3).image)
        run("core", methods=["scatter"], textures="brick-mild", out="R", options=Options(jobs=0))
        for command in COMMANDS:
            cpu_seconds(command)
            seconds, unit = min(cpu_seconds(command) for _ in range(3)), cpu_unit()
            print(f"{seconds:6.2f} s {seconds / unit:6.0f} u  nrbench {command}", flush=True)


if __name__ == "__main__":
    main()
