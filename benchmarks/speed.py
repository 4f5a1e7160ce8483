"""Cost of methods, texture models, scores, commands and cells, as multiples of the machine unit w (see ``unit.py``).

``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/speed.py [SUBJECT ...] [--methods ...] [--largest SIDE]``

In the first five subjects the lattice is given, and kernels are compiled and warm. Each figure is CPU time over that of
a unit taken right before it, the median of seven (three where a call is long), so other work on the machine weighs on
both. Subjects:

``methods``
    Each method and its variants: a texture of ``--model``, from ``--sample`` to ``--output`` px a side.
``outputs``
    Brick from 128 x 128 px, by the side of the output up to ``--largest``: the cost of 256 x 256 px should not grow.
    Each figure is one synthesis in a process of its own. The last column is by how much the process grew; the output
    and its source map are 24 bytes a pixel of it.
``models``
    Each texture model at 512 x 512 px, without and with all departures.
``cells``
    The scores of the suite `default` of one output of 256 x 256 px, of a bent one, of one of 448 x 448 px whose
    reference is the sample, as with a photograph, and of 512 x 512 px. They share windows and tiles. The references,
    which all outputs of a texture share, are learned before.
``scores``
    Each metric on an output of 256 x 256 px, with the texture's model, and with sample and lattice alone.
``commands``
    Short commands in new interpreters: CPU time of the whole process, the least of three.
``pictures``
    ``nrbench lattice`` on square pictures of a brick wall, of ``--sides``: wall and CPU time of the whole command,
    with reading the file and drawing the overlay, peak memory, and the error of the vectors.
``overhead``
    What a cell costs beyond its method: runs of ``--cells`` cells of 64 px, one at a time, scored by ``cost`` alone, of
    a method of nrbench and of a third-party one, which has a child process for each cell. The start of the worker is
    left out. CPU time of all processes, and the part that encodes and decodes pictures.
"""

import contextlib
import json
import multiprocessing
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
from studies import Options, run_studies
from trivial_cells import write_plugin, write_suite
from unit import cpu_unit, median_units

import nrbench
from nrbench import Lattice, plugins
from nrbench.imaging.convert import quantize
from nrbench.lattice.relation import lattice_error
from nrbench.pictures.files import read_image, write_image
from nrbench.plugins.forms import Observation, Refused, Shape, Task, Texture
from nrbench.plugins.parameters import parse_spec
from nrbench.running.phases import score_observation
from nrbench.running.runner import Step
from nrbench.streams import stream
from nrbench.suites.suite import load_suite
from nrbench.work import peak_bytes

PAPER = "rsgf:seam=blend,subpixel=false,tolerance=3,candidate_fraction=0,prefer_unused=false"
METHODS = (
    *("rsgf", "rsgf:seam=blend", "rsgf:subpixel=false"),
    *(PAPER, f"{PAPER},match=ncc"),
    *("tile-set", "tile-set:registration=0", "tile-set:parts=4", "tile-set:tile=upright"),
    *("tile-set:cells=2", "tile-set:margin=0", "tile-set:stitch=dynamic"),
    *("representative-tile", "tiling", "supertile", "shuffle", "scatter"),
    *("fftm-pixel", "fftm-patch", "ann-pixel"),
    *("quilting", "quilting:block=24", "patch-based", "patch-based:search=kdtree", "patch-based:patch=24"),
    *("regularized-patch", "regularized-patch:texel=quadrilateral"),
    *("graph-cuts", "graph-cuts:passes=0", "graph-cuts:placement=sub-patch", "graph-cuts:placement=random"),
    *("texture-optimization", "gpnn", "gpdm"),
)
PLAIN = (
    *("rsgf", "tile-set", "representative-tile", "tiling", "fftm-pixel", "fftm-patch", "ann-pixel"),
    *("quilting", "patch-based", "regularized-patch", "graph-cuts", "texture-optimization", "gpnn", "gpdm"),
)
EVERYTHING = {"light": 0.3, "damage": 0.2, "missing": 0.1, "jitter": 0.3, "bend": 0.3}
SIDES = (256, 512, 1024, 2048, 4096)


def sampled(model: str, side: int, **parameters: float) -> Texture:
    """Return a square texture of a model, its pixels rounded to 8 bits."""
    texture: Texture = plugins.build("datasets", model, parameters).render((side, side), np.random.default_rng(0))
    return replace(texture, image=quantize(texture.image))


def synthesis(spec: str, texture: Texture, output: int) -> Callable[[], object]:
    """Return a call that synthesizes a square output."""
    method = plugins.build("synthesizers", *parse_spec(spec))
    shape = (output, output)
    return lambda: method.synthesize(Task(texture.image, shape, texture.lattice, np.random.default_rng(1)))


def print_cost(name: str, call: Callable[[], object], repeats: int = 7) -> None:
    """Print what a call costs, or why a method refuses its input."""
    try:
        print(f"  {name:92} {median_units(call, repeats):8.1f} w", flush=True)
    except Refused as refusal:
        print(f"  {name:92} refused: {refusal.reason}", flush=True)


def time_methods(options: Options) -> None:
    """Print the cost of each method and variant."""
    for spec in options.methods or METHODS:
        print_cost(spec, synthesis(spec, sampled(options.model, options.sample), options.output))


def time_outputs(options: Options) -> None:
    """Print cost and memory by the side of the output."""
    for spec in options.methods or PLAIN:
        for side in (side for side in SIDES if side <= options.largest):
            with multiprocessing.get_context("fork").Pool(1) as pool:
                units, held = pool.apply(cost_alone, (spec, side))
            each = units / side**2 * 256**2
            print(f"  {spec:30} {side:5} x {side:<5} {units:9.1f} w  {each:7.2f} w per 256 x 256", end="")
            print(f"  {held:7.0f} bytes a pixel", flush=True)


def cost_alone(spec: str, side: int) -> tuple[float, float]:
    """Return what one synthesis takes in this process: CPU time in w, and bytes for each output pixel."""
    texture = sampled("brick", 128)
    synthesis(spec, texture, 64)()
    unit, held, start = cpu_unit(), peak_bytes(), time.process_time()
    synthesis(spec, texture, side)()
    return (time.process_time() - start) / unit, (peak_bytes() - held) / side**2


def time_models(options: Options) -> None:
    """Print the cost of each texture model; the bound is 50 w."""
    for name in plugins.names("datasets"):
        for kind, parameters in {"plain": {}, "with all departures": EVERYTHING}.items():
            if name != "images" and not (name == "noise" and parameters):
                model = plugins.build("datasets", name, parameters)
                print_cost(f"{name}, {kind}", lambda m=model: m.render((512, 512), np.random.default_rng(0)), 3)  # type: ignore[misc]


def observed(name: str, side: int, **parameters: float) -> Observation:
    """Return a fresh draw of a model as the output for a sample of 128 x 128 px."""
    model, texture = plugins.build("datasets", name, parameters), sampled(name, 128, **parameters)

    def again(shape: Shape, k: int) -> Texture:
        drawn: Texture = model.again(texture, shape, stream("again", "speed", k))
        return replace(drawn, image=quantize(drawn.image))

    return Observation(texture.image, again((side, side), 0).image, texture, again=again)


def time_cells(options: Options) -> None:
    """Print the cost of all scores of one cell, and of each part that takes 1 w or more.

    The bounds are 15 w at 256 px, and 50 w at 448 px without a model. A part that several metrics share counts for the
    one that asks for it first.
    """
    metrics = sorted(load_suite("default").metrics, key="quality".__eq__)  # it is the worst of the others
    kinds = {"256 px": (256, 0.0, True), "256 px, bent": (256, 0.5, True), "448 px, no model": (448, 0.0, False)}
    for kind, (side, bend, known) in {**kinds, "512 px": (512, 0.0, True)}.items():
        for name in ("brick", "weave", "hexagon"):
            observation = observed(name, side, color=0.2, noise=0.03, bend=bend)
            if not known:
                bare = Texture(observation.sample, observation.truth.lattice if observation.truth else None)
                observation = Observation(observation.sample, observation.output, bare)
            parts: dict[str, list[float]] = {metric: [] for metric in metrics}
            for count in range(4):
                unit, fresh = cpu_unit(), replace(observation)
                for metric, units in parts.items():
                    start = time.process_time()
                    score_observation(fresh, metric)
                    if count:
                        units.append((time.process_time() - start) / unit)
            costs = {metric: statistics.median(units) for metric, units in parts.items()}
            print(f"  {name}, {kind}: {sum(costs.values()):.1f} w", end=" = ")
            print(" + ".join(f"{metric} {cost:.1f}" for metric, cost in costs.items() if cost >= 1), flush=True)


def time_scores(options: Options) -> None:
    """Print the cost of each metric, with the texture's model and without."""
    for name in ("brick", "weave", "hexagon"):
        observation = observed(name, 256, color=0.2, noise=0.03)
        bare = Texture(observation.sample, observation.truth.lattice if observation.truth else None)
        seen = {
            "with the model": observation,
            "lattice alone": Observation(observation.sample, observation.output, bare),
        }
        for metric in plugins.names("metrics"):
            for kind, observation in seen.items():
                score = plugins.build("metrics", metric).score
                print_cost(f"{name}, {metric}, {kind}", lambda f=score, o=observation: f(replace(o)), 3)  # type: ignore[misc]


COMMANDS = (
    *("--help", "list", "show rsgf", "plan core", "status missing", "status R", "run missing.toml"),
    "synth brick.png -m rsgf --size 256x256 --lattice 27.3,0,13.65,12.2 -o out.png",
    "synth brick.png -m quilting --size 256x256 -o out.png",
)


def run_command(command: str, folder: Path) -> tuple[float, float, float, bytes]:
    """Run a command in a new interpreter; return wall seconds, CPU seconds, peak GiB and its standard output."""
    words = [sys.executable, "-m", "nrbench", *command.split()]
    start = time.perf_counter()
    pipe = subprocess.PIPE
    with subprocess.Popen(words, cwd=folder, stdout=pipe, stderr=subprocess.DEVNULL) as process:
        assert process.stdout is not None
        answer = process.stdout.read()
        _, _, usage = os.wait4(process.pid, 0)
        process.returncode = 0
    return time.perf_counter() - start, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 2**20, answer


def time_commands(options: Options) -> None:
    """Print the cost of short commands from cold."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        write_image(folder / "brick.png", nrbench.texture("brick", shape=(128, 128), color=0.3).image)
        once = nrbench.Options(jobs=0)
        nrbench.run("core", methods=["scatter"], textures="brick-mild", out=folder / "R", options=once)
        for command in COMMANDS:
            run_command(command, folder)
            seconds = min(run_command(command, folder)[1] for _ in range(3))
            print(f"  {seconds:6.2f} s {seconds / cpu_unit():6.0f} w  nrbench {command}", flush=True)


def time_pictures(options: Options) -> None:
    """Print the cost of ``nrbench lattice``. The wall is one draw, repeated; its lattice fits into the draw."""
    wall = nrbench.texture("brick", (2000, 2000), 1, width=25.0, height=12.5, color=0.3, noise=0.05)
    assert wall.lattice is not None
    print(f"  {'side':>6} {'wall s':>7} {'CPU s':>7} {'w':>7} {'GiB':>6}  lattice, error in px")
    for side in options.sides:
        times = -(-side // 2000)
        with tempfile.TemporaryDirectory() as place:
            write_image(Path(place) / "wall.png", np.tile(wall.image, (times, times, 1))[:side, :side])
            seconds, cpu, held, text = run_command("lattice wall.png -o overlay.png --json", Path(place))
        answer, found = json.loads(text), "no lattice"
        if "t1" in answer:
            error = lattice_error(Lattice(answer["t1"], answer["t2"]), wall.lattice, (side, side))
            found = f"{error.label}, {error.vector:.4f}, confidence {answer['confidence']:.3f}"
        print(f"  {side:>6} {seconds:>7.1f} {cpu:>7.1f} {cpu / cpu_unit():>7.0f} {held:>6.2f}  {found}", flush=True)


def time_overhead(options: Options) -> None:
    """Print what a cell costs beyond its method and metrics."""
    with tempfile.TemporaryDirectory() as place:
        plugins.add_file(write_plugin(Path(place)))
        for parameter in ("quilting:tolerance", "trivial:number"):
            print(f"  {parameter.partition(':')[0]}:")
            time_trivial_cells(options.cells, parameter)


def time_trivial_cells(count: int, parameter: str) -> None:
    """Print the same for one method, of which each cell has another value of a parameter."""
    marks: dict[int, tuple[float, float]] = {}

    def follow(step: Step) -> None:
        if step.done in (count // 10, count):
            marks[step.done] = time.perf_counter(), cpu_of_all_processes()

    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        suite = write_suite(folder, count, parameter)
        cells = nrbench.run(suite, out=folder / "run", options=nrbench.Options(jobs=1), progress=follow).cells
        pictures = picture_units(cells[0].folder)
    if any(cell.status != "ok" for cell in cells):
        raise SystemExit("overhead: a trivial cell failed")
    own = np.mean([[cell.result["seconds"], cell.result["cpu_seconds"]] for cell in cells], 0)
    (early, before), (late, after) = sorted(marks.items())
    wall, cpu = np.subtract(after, before) / (late - early) - own
    print(f"  {1000 * wall:.1f} ms of wall, {1000 * cpu:.1f} ms of CPU = {cpu / cpu_unit():.2f} w a cell over")
    print(f"  {late - early} cells, of which")
    print(f"  encoding and decoding of pictures: {pictures:.2f} w")


def cpu_of_all_processes() -> float:
    """Return the CPU seconds so far of this process, and of the worker and the scorer with their ended children."""
    total = time.process_time()
    for child in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.Error):
            total += sum(child.cpu_times()[:4])
    return total


def picture_units(folder: Path) -> float:
    """Return the cost of one cell's pictures: sample and output are written, and read three times."""
    sample, copy = folder / "sample.png", folder.parent / "copy.png"
    image = read_image(sample)

    def handle() -> None:
        for _ in range(100):
            write_image(copy, image)
            write_image(copy, image)
            for _ in range(3):
                read_image(sample)

    return median_units(handle) / 100


if __name__ == "__main__":
    run_studies(
        __doc__,
        *(
            time_methods,
            time_outputs,
            time_models,
            time_cells,
            time_scores,
            time_commands,
            time_pictures,
            time_overhead,
        ),
        **{"largest": SIDES[-1], "methods": [], "model": "brick", "sample": 128, "output": 256},
        **{"sides": [8000], "cells": 2000},
    )
