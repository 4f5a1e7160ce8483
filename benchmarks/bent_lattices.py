"""How often the lattice of a bent picture is found, how exactly, and how often a straight picture counts as bent.

``python benchmarks/bent_lattices.py [bent] [straight] [--count 20] [--first 1000] [--bends 0.25 0.5] [--tilts 10 30]``

``bent``
    ``nrbench.track_lattice`` on 256 x 256 px of brick, weave and hexagon, turned at random: with smooth warps, and as a
    plane that a camera with a field of view of 50 degrees sees at a tilt, in a random direction. The recall is that of
    ``nrbench.lattice.vertices.match_vertices``. A lattice is right if its vectors are those of the mean lattice of the
    true vertices in the picture within 2 % of s, and the median error of the vertices is at most 5 % of s.
``straight``
    The share of undeformed 192 x 192 px draws of all models, some with jitter, that count as bent.
"""

import time
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from studies import Options, run_studies
from unit import cpu_unit

import nrbench
from nrbench import plugins
from nrbench.displacement.deformation_field import Deformation, map_points
from nrbench.imaging.convert import Image, quantize
from nrbench.imaging.mean_tile import interpolate
from nrbench.lattice.geometry import Lattice, Points
from nrbench.lattice.relation import lattice_error
from nrbench.lattice.vertices import (
    Vertex,
    displace_vertices,
    fit_lattice,
    lay_vertices,
    list_vertices,
    match_vertices,
)

MODELS = ("brick", "weave", "hexagon")
NOT_LATTICES = ("images", "noise")
SHAPE, STRAIGHT_SHAPE = (256, 256), (192, 192)
FIELD_OF_VIEW = 50.0
"""Degrees, across the picture."""
OVERSAMPLING = 2
MOST_LATTICE_ERROR, MOST_FIELD_ERROR = 0.02, 0.05
DEPARTURES: tuple[dict[str, float], ...] = ({}, {"jitter": 0.3}, {"jitter": 0.6}, {"color": 0.6})


class Bent(NamedTuple):
    """A bent picture, and its true vertices."""

    image: Image
    vertices: tuple[Vertex, ...]

    @property
    def lattice(self) -> Lattice:
        """The true mean lattice: that of the vertices in the picture."""
        places, size = np.array(self.vertices)[:, 2:], np.array(self.image.shape[1::-1])
        inside = ((places >= -0.5) & (places < size - 0.5)).all(1)
        return fit_lattice([vertex for vertex, seen in zip(self.vertices, inside, strict=True) if seen])


def warped(model: str, bend: float, seed: int) -> Bent:
    """Return a model with a smooth warp."""
    rng = np.random.default_rng(seed)
    built = plugins.build("datasets", model, {"bend": bend, "rotation": float(rng.uniform(0, 90))})
    texture = built.render(SHAPE, rng)
    return Bent(quantize(texture.image), displace_vertices(texture.lattice, texture.displacement))


def camera(tilt: float, direction: float) -> Points:
    """Return the homography from the picture to the plane; one px in the middle is one px of the plane."""
    height, width = SHAPE
    focal = width / 2 / np.tan(np.radians(FIELD_OF_VIEW / 2))
    angle, slope = np.radians(direction), np.tan(np.radians(tilt))
    turn = np.array([[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    rays = np.array([[1 / focal, 0, -(width - 1) / 2 / focal], [0, 1 / focal, -(height - 1) / 2 / focal], [0, 0, 1]])
    plane = np.array([[focal * np.hypot(1, slope), 0, 0], [0, focal, 0], [-slope, 0, 1]])
    return np.asarray(turn.T @ plane @ turn @ rays)


def tilted(model: str, tilt: float, seed: int) -> Bent:
    """Return a model as a camera sees it."""
    rng = np.random.default_rng(seed)
    turned, matrix = float(rng.uniform(0, 90)), camera(tilt, rng.uniform(0, 360))
    fine = [(np.arange(n * OVERSAMPLING) + 0.5) / OVERSAMPLING - 0.5 for n in SHAPE[::-1]]
    plane = map_points(matrix, np.stack(np.meshgrid(*fine), -1))
    low, high = plane.reshape(-1, 2).min(0) - 4, plane.reshape(-1, 2).max(0) + 4
    width, height = np.ceil(high - low).astype(int)
    texture = plugins.build("datasets", model, {"rotation": turned}).render((int(height), int(width)), rng)
    blocks = interpolate(texture.image, plane - low).reshape(SHAPE[0], OVERSAMPLING, SHAPE[1], OVERSAMPLING, -1)
    image = quantize(np.clip(blocks.mean((1, 3)), 0, 1).astype(np.float32))
    laid = np.array(lay_vertices(texture.lattice, (int(height), int(width))))
    places = map_points(np.linalg.inv(matrix), laid[:, 2:] + low)
    near = ((places > -texture.lattice.s) & (places < np.array(SHAPE[::-1]) + texture.lattice.s)).all(1)
    return Bent(image, list_vertices(laid[near, 1::-1], places[near]))


def errors(found: Deformation, bent: Bent) -> tuple[float, float, float]:
    """Return the error of the mean lattice and the median error of the vertices, in s, and the recall of vertices."""
    match = match_vertices(found.lattice_points, bent.vertices, SHAPE)
    error = lattice_error(found.lattice, bent.lattice, SHAPE, share=2 * MOST_LATTICE_ERROR)
    off = error.vector / bent.lattice.s if error.relation == "exact" else np.inf
    return off, np.inf if match.error is None else match.error, match.recall or 0.0


def show_bent(options: Options) -> None:
    """Print how many lattices of bent pictures are right."""
    unit, every = cpu_unit(), []
    makers = [(warped, "bend", options.bends), (tilted, "tilt", options.tilts)]
    for make, word, values in makers:
        for value in values:
            for model in options.models:
                rows = []
                for seed in range(options.first, options.first + options.count):
                    bent = make(model, value, seed)
                    start = time.process_time()
                    try:
                        found = nrbench.track_lattice(bent.image)
                        row = (*errors(found, bent), found.bent, found.homography is not None)
                    except nrbench.NoLatticeFound:
                        row = (np.inf, np.inf, 0.0, False, False)
                    rows.append((*row, (time.process_time() - start) / unit))
                lattice, field, recall, flag, plane, units = (np.array(column) for column in zip(*rows, strict=True))
                right = (lattice <= MOST_LATTICE_ERROR) & (field <= MOST_FIELD_ERROR)
                every += right.tolist()
                print(f"  {model:8} {word} {value:<5} right {right.sum():3}/{len(right):<3}", end="")
                print(f"  recall {recall.mean():.3f}", end="")
                print(f"  median errors: lattice {np.median(lattice):.3f}, vertices {np.median(field):.3f} s", end="")
                print(f"  bent {flag.sum()}, a homography {plane.sum()}  {np.median(units):.0f} w", flush=True)
    print(f"  all: right {sum(every)}/{len(every)}")


def straight_pictures(options: Options) -> Iterator[tuple[str, Image]]:
    """Yield undeformed draws of all models."""
    for model in (name for name in plugins.names("datasets") if name not in NOT_LATTICES):
        for departures in DEPARTURES:
            for seed in range(options.first, options.first + options.count):
                rng = np.random.default_rng(seed)
                built = plugins.build("datasets", model, {"rotation": float(rng.uniform(0, 90)), **departures})
                yield f"{model} {departures}", quantize(built.render(STRAIGHT_SHAPE, rng).image)


def show_straight(options: Options) -> None:
    """Print how many straight pictures count as bent, and what the answer costs beyond the detector."""
    unit, flagged, number, extra = cpu_unit(), [], 0, []
    for name, image in straight_pictures(options):
        start = time.process_time()
        try:
            nrbench.detect_lattice(image)
            middle = time.process_time()
            found = nrbench.track_lattice(image)
        except nrbench.NoLatticeFound:
            continue
        extra.append((time.process_time() - middle - (middle - start)) / unit)
        number += 1
        if found.bent:
            flagged.append(f"{name} ({found.amplitude:.2f} s)")
    print(f"  {len(flagged)} of {number} count as bent, {np.median(extra):.0f} w beyond the detector: {flagged}")


if __name__ == "__main__":
    more = {"models": list(MODELS), "bends": [0.25, 0.5, 1.0], "tilts": [10.0, 20.0, 30.0]}
    run_studies(__doc__, show_bent, show_straight, count=20, first=1000, **more)
