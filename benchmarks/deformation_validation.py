"""What the scores of deformation, geometry, appearance and self-similarity make of planted departures.

``OMP_NUM_THREADS=1 python benchmarks/deformation_validation.py`` prints, for smooth warps planted in fresh draws and
for bent and jittered models, the amplitude that was recovered over the true one at the same lattice points, by size;
then for each score the Spearman correlation with the size of its own departure over single images (``--count`` seeds x
8 sizes), and how the others answer to it. Textures are brick, weave and hexagon in turn, every second one rotated.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.stats import spearmanr

from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.datasets_procedural.weave import Weave
from nrbench.imaging.convert import quantize
from nrbench.metrics.deformation import Deformation
from nrbench.metrics.deformations.tracked_lattices import DeformationField, track_images
from nrbench.metrics.geometry_appearance import GeometryAppearance
from nrbench.metrics.self_similarity import SelfSimilarity
from nrbench.plugins.forms import Metric, Observation, Shape, Task, Texture
from nrbench.streams import stream
from nrbench.synthesizers.planted import Planted

SIDE = 256
WARPS = (0.06, 0.12, 0.18, 0.24, 0.3, 0.36, 0.43, 0.5)
STRENGTHS = (0.05, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0)
KNOB = (0.0, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.45)
"""Of the suite ``spectrum``, up to where nothing regular is left."""
Field = np.ndarray[tuple[int, ...], np.dtype[Any]]


@dataclass(frozen=True)
class Planting:
    """An observation with a departure of known size, and the true displacement of its output."""

    size: float
    seen: Observation
    displacement: Field


def model(seed: int) -> Model:
    """Return the model of a seed: family and rotation in turn, the rest at random."""
    rng = stream("render", "deformation", seed)
    rotation = float(rng.uniform(-45, 45)) if seed // 3 % 2 else 0.0
    common = {"rotation": rotation, "color": float(rng.uniform(0.1, 0.3)), "noise": float(rng.uniform(0.0, 0.04))}
    if seed % 3 == 0:
        return Brick(width=rng.uniform(24, 34), height=rng.uniform(12, 17), joint=2.4, **common)
    if seed % 3 == 1:
        return Weave(warp=rng.uniform(10, 15), weft=rng.uniform(10, 15), **common)
    return Hexagon(period=rng.uniform(18, 30), joint=2.4, **common)


def observation(one: Model, seed: int) -> Observation:
    """Return sample and a fresh draw of a model."""
    texture = one.render((SIDE // 2, SIDE // 2), stream("render", "deformation", seed, "sample"))
    texture = replace(texture, image=quantize(texture.image))

    def again(shape: Shape, k: int) -> Texture:
        drawn = one.again(texture, shape, stream("again", "deformation", seed, k))
        return replace(drawn, image=quantize(drawn.image))

    return Observation(texture.image, again((SIDE, SIDE), 0).image, texture, again=again)


def warped(seed: int, sizes: tuple[float, ...] = WARPS) -> Iterator[Planting]:
    """Yield fresh draws of a texture with smooth warps planted in them, size the largest displacement in s."""
    seen = observation(model(seed), seed)
    for size in sizes:
        rng = stream("synthesis", "deformation", seed, str(size))
        made = Planted("warp", size).synthesize(Task(seen.sample, (SIDE, SIDE), None, rng, again=seen.again))
        yield Planting(size, replace(seen, output=quantize(made.image), again=None), made.extras["displacement"])


def departed(kind: str, seed: int, sizes: tuple[float, ...] = STRENGTHS) -> Iterator[Planting]:
    """Yield fresh draws of a model with one departure of each strength, beside the sample without it."""
    plain = replace(model(seed), **{kind: 0.0})
    seen = observation(plain, seed)
    for size in sizes:
        drawn = replace(plain, **{kind: size}).again(
            seen.truth, (SIDE, SIDE), stream("again", "deformation", seed, kind, str(size))
        )
        moved = np.zeros((SIDE, SIDE, 2)) if drawn.displacement is None else drawn.displacement
        yield Planting(size, replace(seen, output=quantize(drawn.image), again=None), moved)


def turned(seed: int, sizes: tuple[float, ...] = KNOB) -> Iterator[Planting]:
    """Yield hexagonal tiles of any period and rotation as the suite ``spectrum`` makes them at each knob."""
    rng = stream("render", "deformation", seed, "knob")
    base = Hexagon(period=rng.uniform(16, 30), joint=2.4, rotation=rng.uniform(-30, 30), color=0, intensity=0, noise=0)
    seen = observation(base, seed)
    for size in sizes:
        strengths = {"color": 0.6, "intensity": 0.3, "noise": 0.08, "jitter": 0.8, "bend": 1.0}
        at_knob = replace(base, **{name: size * full for name, full in strengths.items()})
        drawn = at_knob.again(seen.truth, (SIDE, SIDE), stream("again", "deformation", seed, "knob", str(size)))
        yield Planting(size, replace(seen, output=quantize(drawn.image), again=None), np.zeros((SIDE, SIDE, 2)))


def recovered(planting: Planting) -> tuple[float, float, float]:
    """Return the amplitude that was measured, the true one at the same points, and that of the error, all in s."""
    found = planting.seen.shared(track_images)
    if isinstance(found, str) or found.obstacle:
        return float("nan"), float("nan"), float("nan")
    field, s = DeformationField.of(found.output), found.output.lattice.s
    at = field.places.T[::-1]
    moved = [map_coordinates(axis, at, np.float64, 1, "nearest") for axis in np.moveaxis(planting.displacement, -1, 0)]
    ideal = field.lattice.from_cell(field.numbers)
    true = replace(field, places=ideal + np.stack(moved, -1))
    error = replace(field, places=ideal + true.rest - field.rest)
    return field.amplitude / s, true.amplitude / s, error.amplitude / s


@dataclass(frozen=True)
class Measured:
    """What was made of one image."""

    kind: str
    size: float
    amplitude: float
    true: float
    error: float
    scores: dict[str, float | None]


def measured(kind: str, planting: Planting) -> Measured:
    """Score one image."""
    scores = {
        f"{name}.{column}": metric.score(planting.seen).values[column]
        for name, metric, columns in METRICS
        for column in columns
    }
    return Measured(kind, planting.size, *recovered(planting), scores)


METRICS: tuple[tuple[str, Metric, tuple[str, ...]], ...] = (
    ("deformation", Deformation(), ("amplitude", "folded")),
    ("geometry_appearance", GeometryAppearance(), ("g", "a")),
    ("self_similarity", SelfSimilarity(), ("score",)),
)
DEPARTURES: dict[str, Callable[[int], Iterator[Planting]]] = {
    "warp": warped,
    "bend": lambda seed: departed("bend", seed),
    "jitter": lambda seed: departed("jitter", seed),
    "color": lambda seed: departed("color", seed),
    "knob": turned,
}


def print_recovery(kind: str, images: list[Measured]) -> None:
    """Print how much of the true amplitude is recovered, by size."""
    print(f"{kind}: amplitude recovered")
    for size in sorted({image.size for image in images}):
        rows = [image for image in images if image.size == size]
        held = [image for image in rows if np.isfinite(image.amplitude)]
        low, middle, high = np.quantile([image.amplitude / max(image.true, 1e-9) for image in held], (0.1, 0.5, 0.9))
        true, error = (np.median([getattr(image, name) for image in held]) for name in ("true", "error"))
        print(
            f"  size {size:4.2f}  true {true:.3f} s  measured over true {middle:.2f} ({low:.2f} to {high:.2f})"
            f"  error {error:.3f} s  measured in {len(held)} of {len(rows)}"
        )


def print_responses(kind: str, images: list[Measured]) -> None:
    """Print how each score answers to a departure's size over single images, and its medians at both ends."""
    for name in images[0].scores:
        pairs = [(image.size, value) for image in images if (value := image.scores[name]) is not None]
        sizes, values = (np.array(column, np.float64) for column in zip(*pairs, strict=True))
        low, high = (float(np.median(values[sizes == end])) for end in (sizes.min(), sizes.max()))
        rank = spearmanr(sizes, values)[0] if np.ptp(values) else float("nan")
        print(f"  {kind:8} {name:24} {rank:6.3f}  {low:.3f} to {high:.3f}  n {len(values)}")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20, help="seeds")
    parser.add_argument("--kinds", nargs="*", choices=DEPARTURES, default=list(DEPARTURES), help="departures")
    arguments = parser.parse_args()
    count = arguments.count
    for kind in arguments.kinds:
        images = [measured(kind, planting) for seed in range(count) for planting in DEPARTURES[kind](seed)]
        if kind in ("warp", "bend", "jitter"):
            print_recovery(kind, images)
            found, true = ([getattr(image, name) for image in images] for name in ("amplitude", "true"))
            print(f"  Spearman correlation with the true amplitude {spearmanr(found, true, nan_policy='omit')[0]:.3f}")
        print(f"Spearman correlation with the size of {kind}, {count} seeds x 8 sizes")
        print_responses(kind, images)


if __name__ == "__main__":
    main()
