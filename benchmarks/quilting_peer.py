"""CPU time and quality of quilting beside another program, on the same samples, in one run.

``python benchmarks/quilting_peer.py [--peer COMMAND] [--block PX] [--overlap PX]``

``--peer`` is the command line of the other program. ``{sample}`` and ``{output}`` become paths of PNG files;
``{width}``, ``{height}``, ``{seed}``, ``{block}`` and ``{overlap}`` become numbers. For bmquilting (MIT, needs Python
3.12 or later), install it into an environment of its own, and give a program that reads the sample, calls
``bmquilting.square.generate_texture`` with this block and overlap, and writes the output. Without ``--peer``, G'MIC's
``syntexturize_matchpatch`` is the peer, which has no blocks (Debian: ``apt install gmic``). If there is no peer, the
script says so and ends.

``quilting`` is shown twice: the synthesis alone, which is what a cell of a run costs, and the process
``nrbench synth``, which includes the start of Python and all imports, as the peer's time does.
"""

from __future__ import annotations

import argparse
import resource
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from unit import cpu_unit

from nrbench import plugins, run
from nrbench.api.runs import changed
from nrbench.jit import load_kernels
from nrbench.pictures.files import write_image
from nrbench.running.runner import Options
from nrbench.runs.records import CellRecord
from nrbench.suites.plan import draw_samples
from nrbench.suites.suite import load_suite

GMIC = "gmic {sample} syntexturize_matchpatch {width},{height} -o {output}"
SIDE = 256
"""px: side of the outputs."""


def find_peer(command: str | None) -> str | None:
    """Return the peer's command line; None, after a sentence that says why, if its program is missing."""
    command = command or GMIC
    program = command.split()[0]
    if shutil.which(program) or Path(program).is_file():
        return command
    print(f"skipped: the peer's program {program!r} is not installed; give another one with --peer (see --help)")
    return None


def child_seconds(words: list[str]) -> float:
    """Run a program, and return the CPU seconds that it took."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(words, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def print_row(
    name: str, seconds: list[float], unit: float, base: float, records: list[CellRecord] | None = None
) -> None:
    """Print the mean CPU time, also in u and over that of quilting, and the mean quality; none counts as 0."""
    mean = sum(seconds) / len(seconds)
    scores = [float(one.values["quality.score"] or 0) for one in records or ()]
    quality = f"{sum(scores) / len(scores):8.3f}" if scores else ""
    print(f"{name:46} {mean:8.3f} s {mean / unit:8.1f} u {mean / base:8.1f} x {quality}", flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peer", help="command line of the other program")
    parser.add_argument("--block", type=int, default=64)
    parser.add_argument("--overlap", type=int, default=11)
    parser.add_argument("--textures", nargs="*", default=["*"], help="textures of the suite core")
    options = parser.parse_args()
    peer = find_peer(options.peer)
    if peer is None:
        return
    for name in ("block", "overlap"):
        peer = peer.replace(f"{{{name}}}", str(getattr(options, name)))
    plugins.inventory("synthesizers")
    load_kernels()
    unit = cpu_unit()
    ours = f"quilting:block={options.block},overlap={options.overlap}"
    names = ["regularity", "integrity", "randomness", "quality", "cost"]
    suite = changed(load_suite("core"), [ours, f"command:run={peer}"], ["given"], size=f"{SIDE}x{SIDE}", metrics=names)
    with tempfile.TemporaryDirectory() as folder:
        cells = run(suite, out=Path(folder, "run"), textures=options.textures, options=Options(jobs=0)).cells
        sample, output = Path(folder, "sample.png"), Path(folder, "output.png")
        write_image(sample, draw_samples(suite, options.textures)[0].recipe.render().image)
        synth = [sys.executable, "-c", "from nrbench.cli.main import main; main()", "synth", str(sample), "-m", ours]
        process = [child_seconds([*synth, "--size", f"{SIDE}x{SIDE}", "-o", str(output)]) for _ in range(3)]
    records = {name: [cell for cell in cells if cell.cell.method == name] for name in ("quilting", "command")}
    taken = {name: [float(cell.values["cost.cpu_seconds"] or 0) for cell in each] for name, each in records.items()}
    base = sum(taken["quilting"]) / len(taken["quilting"])
    print(f"u = {unit * 1e3:.2f} ms; {len(records['command'])} textures of core, 128 x 128 to {SIDE} x {SIDE}")
    print(f"{'':46} {'CPU':>10} {'':10} {'':10} {'quality':>8}")
    print_row(ours, taken["quilting"], unit, base, records["quilting"])
    print_row("the same, as a process", process, unit, base)
    print_row(f"the peer {peer.split()[0]}, as a process", taken["command"], unit, base, records["command"])


if __name__ == "__main__":
    main()
