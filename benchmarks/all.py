"""Run every benchmark in a short form, and print what each answers and costs.

``make benchmark``, or ``python benchmarks/all.py [NAME ...]``. Each script runs in a process of its own, on one thread.
The table at the end has the first sentence of its page, its CPU seconds, also in units w, and the command of the full
figures.
"""

import ast
import os
import subprocess
import sys
from pathlib import Path

from unit import cpu_unit

from nrbench.work import cpu_seconds

FOLDER = Path(__file__).parent
BENCHMARKS = {
    "speed.py methods models cells scores": "speed.py",
    "speed.py commands overhead": "the same",
    "speed.py pictures --sides 2000": "speed.py pictures --sides 500 1000 2000 4000 8000",
    "speed.py outputs --largest 1024 --methods rsgf tile-set representative-tile fftm-patch": "speed.py outputs",
    "fftm_time.py --sides 128 --repeats 1": "fftm_time.py",
    "geometry.py --seeds 0 --bends 0.5 --models brick": "geometry.py",
    "peers.py --textures brick-middle weave-middle hexagon-middle": "peers.py",
    "resample.py rare": "resample.py elements",
    "detector_accuracy.py --count 1 --stochastic 14 consensus gncc ssdn dominance": "detector_accuracy.py",
    "consensus_calibration.py --count 1 --kinds 0": "consensus_calibration.py",
    "bent_lattices.py bent --count 1 --bends 0.5 --tilts 20": "bent_lattices.py",
    "wallpaper_groups.py --count 1": "wallpaper_groups.py",
    "texture_statistics.py brick": "texture_statistics.py",
    "validation.py fresh --count 1 --textures brick weave": "validation.py fresh",
    "validation.py planted --count 1": "validation.py planted --count 6",
    "validation.py ladder --textures brick-strong": "validation.py ladder",
    "validation.py baselines --textures brick-strong": "validation.py baselines",
    "validation.py bases --textures brick-strong": "validation.py bases",
    "zoo.py fresh --count 1 --kinds dots net": "zoo.py fresh",
    "zoo.py prints --count 1 --kinds dots": "zoo.py prints",
    "zoo.py faults --count 1 --kinds dots": "zoo.py faults",
    "prints.py colors --names dots-two --seeds 1": "prints.py colors",
    "elsewhere.py edges --count 1": "elsewhere.py edges",
    "elsewhere.py defects --count 1": "elsewhere.py defects --count 2",
    "doses.py plot doses.svg": "the same",
    "sensitivity.py runs/default --textures brick-strong --limits JND": "sensitivity.py runs/default",
    "seeds.py --seeds 1 2 --textures brick-strong": "seeds.py",
    "table_errors.py --short --runs 50": "table_errors.py --runs 400",
    "labels.py --sets models-2": "labels.py --photographs FOLDER",
    "graders.py": "the same",
}
"""The command of each short form, and that of the full figures, as the docs quote them."""


def question(script: str) -> str:
    """Return the first line of a script's page."""
    page = ast.get_docstring(ast.parse((FOLDER / script).read_text("utf-8"))) or ""
    return page.partition("\n")[0].rstrip(".")


def main() -> int:
    """Run the benchmarks whose file names begin with one of the arguments, or all, and print the table."""
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    environment = {**os.environ, **threads}
    environment.pop("PYTHONSAFEPATH", None)
    unit, lines, failed = cpu_unit(), [], 0
    for short, full in BENCHMARKS.items():
        if sys.argv[1:] and not short.startswith(tuple(sys.argv[1:])):
            continue
        print(f"\n== {short}", flush=True)
        script, *arguments = short.split()
        before = cpu_seconds()
        code = subprocess.run([sys.executable, FOLDER / script, *arguments], env=environment, check=False).returncode
        seconds = cpu_seconds() - before
        failed += code != 0
        state = f"**failed with exit code {code}**; " if code else ""
        lines.append(f"| {question(script)} | `{short}` | {state}{seconds:.0f} s, {seconds / unit:.0f} w | `{full}` |")
    print(f"\nu = {unit * 1e3:.2f} ms\n\n| question | short form | CPU | full form |\n| --- | --- | --- | --- |")
    print("\n".join(lines))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
