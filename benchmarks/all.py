"""Run every benchmark in a short form, and print a list of what each answers and costs.

``make benchmark``, or ``python benchmarks/all.py [NAME ...]``. Each script runs in a process of its own, on one thread;
the list at the end has its CPU seconds, also in units u. The command in the list's last column gives the full figures.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from unit import cpu_unit

FOLDER = Path(__file__).parent


@dataclass(frozen=True)
class Benchmark:
    """One benchmark.

    Parameters
    ----------
    script
        File and short arguments.
    question
        What it answers.
    full
        Arguments for the full figures, as the docs quote them.
    """

    script: str
    question: str
    full: str = ""


BENCHMARKS = (
    Benchmark(
        "speed.py methods lattices models cells scores", "What methods, texture models and scores cost", "speed.py"
    ),
    Benchmark(
        "speed.py outputs --largest 1024 --methods rsgf tile-set representative-tile fftm-patch",
        "How cost and memory grow with the output",
        "speed.py outputs --largest 4096",
    ),
    Benchmark(
        "geometry.py --seeds 0 --bends 0.5 --models brick",
        "What straightening and bending again keeps of displacements, and what it gains",
        "geometry.py",
    ),
    Benchmark("commands.py", "What short commands cost from cold"),
    Benchmark("overhead.py", "What a cell costs beyond its method and metrics"),
    Benchmark("correlation.py", "The autocorrelation beside scikit-image's masked correlation"),
    Benchmark(
        "quilting_peer.py --textures brick-middle weave-middle hexagon-middle",
        "Quilting beside another program",
        "quilting_peer.py",
    ),
    Benchmark("representative_tile.py", "The exact tile search beside brute force"),
    Benchmark(
        "detector_accuracy.py --count 1 --stochastic 14 consensus gncc ssdn dominance",
        "How often detectors find the lattice, and find one where there is none",
        "detector_accuracy.py",
    ),
    Benchmark(
        "consensus_calibration.py --count 1 --kinds 0",
        "What consensus's confidence is worth",
        "consensus_calibration.py",
    ),
    Benchmark(
        "large_images.py 2000", "What detection costs on large images", "large_images.py 500 1000 2000 4000 8000"
    ),
    Benchmark(
        "bent_lattices.py bent --count 1 --bends 0.5 --tilts 20",
        "How often the lattice of a bent picture is found, and a straight one counts as bent",
        "bent_lattices.py",
    ),
    Benchmark(
        "texture_statistics.py brick",
        "Whether models have the statistics that the truth states",
        "texture_statistics.py",
    ),
    Benchmark(
        "validation.py alarms detection without-model --count 6 --replicates 1",
        "False alarms, margins and detection of regularity and integrity",
        "validation.py alarms detection without-model --count 108 --replicates 3 --sides 256 512 1024",
    ),
    Benchmark(
        "validation.py response silence invariance departures --replicates 1 --sides 192",
        "How each column responds to each defect",
        "validation.py response silence invariance departures --replicates 8",
    ),
    Benchmark(
        "validation.py references --count 2 --replicates 3",
        "Where fresh draws and baselines lie",
        "validation.py references --count 43 --replicates 100",
    ),
    Benchmark("labels.py", "Whether labels given by eye agree with the scores"),
    Benchmark(
        "variation_band.py score runs/variation.csv --replicates 1 --draws 2 --textures core/brick-*",
        "Whether methods vary as the texture does",
        "variation_band.py score runs/variation.csv, then variation_band.py table runs/variation.csv",
    ),
)


def cpu_seconds() -> float:
    """Return the CPU seconds of all processes that have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def run(benchmark: Benchmark) -> tuple[float, int]:
    """Run one benchmark, and return its CPU seconds and exit code."""
    script, *arguments = benchmark.script.split()
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    environment = {**os.environ, **threads}
    environment.pop("PYTHONSAFEPATH", None)
    before = cpu_seconds()
    done = subprocess.run([sys.executable, str(FOLDER / script), *arguments], env=environment, check=False)
    return cpu_seconds() - before, done.returncode


def main() -> int:
    """Run the benchmarks whose file names begin with one of the arguments, or all, and print the list."""
    chosen = [each for each in BENCHMARKS if not sys.argv[1:] or each.script.startswith(tuple(sys.argv[1:]))]
    u, lines, failed = cpu_unit(), [], 0
    for benchmark in chosen:
        print(f"\n== {benchmark.script}", flush=True)
        seconds, code = run(benchmark)
        failed += code != 0
        state = "" if code == 0 else f"**failed with exit code {code}**; "
        cost = f"{seconds:.0f} s, {seconds / u:.0f} u"
        lines.append(
            f"| {benchmark.question} | `{benchmark.script}` | {state}{cost} | `{benchmark.full or 'the same'}` |"
        )
    print(f"\nu = {u * 1e3:.2f} ms\n\n| question | short form | CPU | full form |\n| --- | --- | --- | --- |")
    print("\n".join(lines))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
