"""Cost of methods, texture models and scores, as multiples of the machine unit u (see ``unit.py``).

``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/speed.py [SUBJECT ...] [--largest SIDE] [--methods ...]``

The lattice is given, kernels are compiled and warm, and every figure is CPU time over that of a unit taken right before
it, the median of seven (three where a call is long), so that other work on the machine weighs on both. Subjects:

``methods``
    Each method and its variants, brick, from 128 x 128 to 256 x 256 px.
``lattices``
    The same methods with their defaults, by the size of the cell: windows, brick, corduroy.
``samples``
    Brick to 256 x 256 px, by the side of the sample.
``outputs``
    Brick from 128 x 128 px, by the side of the output up to ``--largest``: the cost of 256 x 256 px should not grow.
    Each figure is one synthesis in a process of its own; the last column is by how much the process grew, of which the
    output and its source map are 24 bytes a pixel.
``suites``
    Each texture of ``core`` and ``report2004``, from 128 x 128 to 256 x 256 px, with tile-set, the most expensive last.
``models``
    Each texture model at 512 x 512 px, without and with all departures.
``cells``
    All scores of one output of 256 x 256 px and of 512 x 512 px, which share their windows, tiles and fresh draws, and
    of a bent one.
``scores``
    Each metric on an output of 256 x 256 px, with the texture's model, and with sample and lattice alone.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from unit import cpu_unit, median_units

from nrbench import plugins
from nrbench.imaging.convert import quantize
from nrbench.jit import load_kernels
from nrbench.plugins.forms import Observation, Refused, Shape, Task, Texture
from nrbench.plugins.parameters import parse_spec
from nrbench.running.phases import score_observation
from nrbench.streams import stream
from nrbench.suites.plan import draw_samples
from nrbench.suites.suite import load_suite

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
    *("graph-cuts", "graph-cuts:refine=none", "graph-cuts:placement=sub-patch", "graph-cuts:placement=random"),
)
PLAIN = (
    *("rsgf", "tile-set", "representative-tile", "tiling", "fftm-pixel", "fftm-patch", "ann-pixel"),
    *("quilting", "patch-based", "regularized-patch", "graph-cuts"),
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
        print(f"  {name:92} {median_units(call, repeats):8.1f} u", flush=True)
    except Refused as refusal:
        print(f"  {name:92} refused: {refusal.reason}", flush=True)


def time_methods(options: argparse.Namespace) -> None:
    """Print the cost of each method and variant."""
    for spec in options.methods or METHODS:
        print_cost(spec, synthesis(spec, sampled("brick", 128), 256))


def time_lattices(options: argparse.Namespace) -> None:
    """Print the cost by the size of the cell: the smaller the cell, the more tiles."""
    for model in ("windows", "brick", "corduroy"):
        for spec in options.methods or PLAIN:
            print_cost(f"{model}: {spec}", synthesis(spec, sampled(model, 128), 256), 3)


def time_samples(options: argparse.Namespace) -> None:
    """Print the cost by the side of the sample."""
    for spec in options.methods or PLAIN:
        for side in (96, 128, 256, 512):
            print_cost(f"{spec}, from {side} x {side}", synthesis(spec, sampled("brick", side), 256), 3)


def time_outputs(options: argparse.Namespace) -> None:
    """Print cost and memory by the side of the output."""
    for spec in options.methods or PLAIN:
        for side in (side for side in SIDES if side <= options.largest):
            with multiprocessing.get_context("fork").Pool(1) as pool:
                units, held = pool.apply(cost_alone, (spec, side))
            each = units / side**2 * 256**2
            print(f"  {spec:30} {side:5} x {side:<5} {units:9.1f} u  {each:7.2f} u per 256 x 256", end="")
            print(f"  {held:7.0f} bytes a pixel", flush=True)


def cost_alone(spec: str, side: int) -> tuple[float, float]:
    """Return what one synthesis takes in this process: CPU time in u, and bytes for each output pixel."""
    texture = sampled("brick", 128)
    synthesis(spec, texture, 64)()
    u, held, start = cpu_unit(), peak_memory(), time.process_time()
    synthesis(spec, texture, side)()
    return (time.process_time() - start) / u, (peak_memory() - held) / side**2


def peak_memory() -> int:
    """Return the most bytes that this process has held so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def time_suites(options: argparse.Namespace) -> None:
    """Print the cost of each texture of the suites."""
    for suite in ("core", "report2004"):
        for sample in draw_samples(load_suite(suite), ["*"]):
            texture = replace(sample.recipe, shape=(128, 128)).render()
            texture = replace(texture, image=quantize(texture.image))
            for spec in options.methods or ("tile-set",):
                print_cost(f"{suite}/{sample.recipe.texture}: {spec}", synthesis(spec, texture, 256), 3)


def time_models(options: argparse.Namespace) -> None:
    """Print the cost of each texture model; the bound is 50 u."""
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


def time_cells(options: argparse.Namespace) -> None:
    """Print the cost of all scores of one cell, and of each part that takes 1 u or more; the bounds are 60 and 160 u.

    A part that several metrics share counts for the one that asks for it first.
    """
    for side, bend in ((256, 0.0), (512, 0.0), (256, 0.5)):
        for name in ("brick", "weave", "hexagon"):
            observation = observed(name, side, color=0.2, noise=0.03, bend=bend)
            parts: dict[str, list[float]] = {metric: [] for metric in plugins.names("metrics")}
            for count in range(4):
                u, fresh = cpu_unit(), replace(observation)
                for metric, units in parts.items():
                    start = time.process_time()
                    score_observation(fresh, metric)
                    if count:
                        units.append((time.process_time() - start) / u)
            costs = {metric: statistics.median(units) for metric, units in parts.items()}
            print(f"  {name}, {side} x {side} px, bend {bend:g}: {sum(costs.values()):.1f} u", end=" = ")
            print(" + ".join(f"{metric} {cost:.1f}" for metric, cost in costs.items() if cost >= 1), flush=True)


def time_scores(options: argparse.Namespace) -> None:
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


SUBJECTS: Mapping[str, Callable[[argparse.Namespace], None]] = {
    "methods": time_methods,
    "lattices": time_lattices,
    "samples": time_samples,
    "outputs": time_outputs,
    "suites": time_suites,
    "models": time_models,
    "cells": time_cells,
    "scores": time_scores,
}


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("subjects", nargs="*", metavar="SUBJECT", help=f"of {', '.join(SUBJECTS)}; none: all")
    parser.add_argument("--largest", type=int, default=SIDES[-1], help="of outputs: the largest side in px")
    parser.add_argument("--methods", nargs="*", help="methods as name:param=value,...")
    options = parser.parse_args()
    load_kernels()
    print(f"u = {cpu_unit() * 1e3:.2f} ms")
    for subject in options.subjects or SUBJECTS:
        print(f"\n{subject}")
        SUBJECTS[subject](options)


if __name__ == "__main__":
    main()
