"""What `nrbench lattice` costs on large images: `python benchmarks/large_images.py [SIDE ...]`, without sides 8000 px.

Each side is that of a square picture of a brick wall. The whole command is measured: reading the file, the detector,
and drawing the overlay. Columns: wall seconds, CPU seconds, the same in u, the peak of the memory, and the error of the
vectors. The wall is a draw of 2000 x 2000 px, repeated as often as needed; its lattice fits into the draw.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from unit import cpu_unit

from nrbench import Lattice, texture
from nrbench.imaging.files import write_image
from nrbench.lattice.relation import lattice_error

DRAW, PERIOD = 2000, 25.0


def main() -> None:
    """Print one line for each side."""
    sides = [int(word) for word in sys.argv[1:]] or [8000]
    wall = texture("brick", (DRAW, DRAW), 1, width=PERIOD, height=PERIOD / 2, color=0.3, noise=0.05)
    u = cpu_unit()
    print(f"u = {1000 * u:.2f} ms\n{'side':>6} {'wall s':>7} {'CPU s':>7} {'u':>7} {'GiB':>6}  lattice, error px")
    for side in sides:
        times = -(-side // DRAW)
        image = np.tile(wall.image, (times, times, 1))[:side, :side]
        with tempfile.TemporaryDirectory() as place:
            picture = write_image(Path(place) / "wall.png", image)
            del image
            _measure(picture, side, wall.lattice, u)


def _measure(picture: Path, side: int, truth: Lattice | None, u: float) -> None:
    """Run the command in a process of its own, and print its line."""
    assert truth is not None
    code = "import sys; from nrbench.cli.main import main; main(sys.argv[1:])"
    overlay = picture.with_name("overlay.png")
    line = [sys.executable, "-c", code, "lattice", str(picture), "-o", str(overlay), "--json"]
    start = time.perf_counter()
    with subprocess.Popen(line, stdout=subprocess.PIPE, env={**os.environ, "PYTHONSAFEPATH": "1"}) as process:
        assert process.stdout is not None
        answer = json.loads(process.stdout.read())
        _, _, usage = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - start
        process.returncode = 0
    cpu = usage.ru_utime + usage.ru_stime
    said = "no lattice"
    if "t1" in answer:
        error = lattice_error(Lattice(answer["t1"], answer["t2"]), truth, (side, side))
        said = f"{error.label}, {error.vector:.4f}, confidence {answer['confidence']:.3f}"
    print(f"{side:>6} {seconds:>7.1f} {cpu:>7.1f} {cpu / u:>7.0f} {usage.ru_maxrss / 2**20:>6.2f}  {said}", flush=True)


if __name__ == "__main__":
    main()
