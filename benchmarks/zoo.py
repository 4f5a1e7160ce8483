"""Validation of the scores: a zoo of textures that no model draws, most of them prints.

``python benchmarks/zoo.py STUDY [--half setting|report] [--kinds NAME ...] [--count N] [--by sample model]``. Each of
twenty functions draws one kind of near-regular texture on a known lattice: ten prints, of flat elements in a few inks,
and ten others. Limits are set on the kinds with even numbers (``setting``), the figures of the odd ones are the report.

``fresh``
    Fresh draws of 256 px, each judged by a sample of 128 or of 96 px and its lattice alone, or with the model.
``prints``
    Prints in three palettes: fresh draws, inks that the print does not have, copies of the sample's elements (the ideal
    ``copier``), and, of the first sample, outputs of ``tile-set`` and ``resample`` to which the lattice is given.
``faults``
    One or more planted faults of each peril.
``draw FILE.png``
    A sheet with one picture of each kind; with ``--kinds NAME``, also its faults.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import PIL.Image
import PIL.ImageDraw
from edits import EDITS, Plane, apply_edit
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.special import ndtri
from skimage.color import rgb2lab
from studies import Options, read_options
from validation import SIZE, Row, Subject, baseline, perils_text, print_table, show

from nrbench import Lattice
from nrbench.datasets_procedural.modelling import pattern as shapes
from nrbench.datasets_procedural.modelling.pattern import Frame, Index, coverage, mix
from nrbench.imaging.convert import Image, quantize
from nrbench.pictures.files import to_pil
from nrbench.plugins.forms import Shape, Texture
from nrbench.streams import stream

Colors = NDArray[np.float64]
PALETTES: Mapping[str, tuple[tuple[float, float, float], ...]] = {
    "bright": ((0.96, 0.93, 0.87), (0.84, 0.28, 0.24), (0.20, 0.43, 0.70), (0.95, 0.76, 0.20)),
    "dusk": ((0.16, 0.19, 0.26), (0.42, 0.64, 0.58), (0.86, 0.53, 0.40), (0.76, 0.73, 0.66)),
    "two": ((0.87, 0.89, 0.91), (0.13, 0.30, 0.27), (0.76, 0.40, 0.50)),
}
"""The ground and the inks of prints."""
_TABLE, _FINER = 64, 2
_NEW = 15.0
"""CIELAB: least distance of an invented color from the inks."""
LEAST_FRESH, LEAST_PRINT, LEAST_COPY, MOST_NEW, MOST_FAULT = 0.8, 0.85, 0.6, 0.3, 0.4
"""Bounds of the quality of fresh draws, of those of prints, of correct copies, of invented inks, and of faults."""


@dataclass
class Canvas:
    """The points of a picture, the inks, and the random numbers of its elements.

    Parameters
    ----------
    x, y
        px in the axes of the kind, at two points along each side of a pixel.
    inks
        ``(k, 3)``: the ground first.
    rng
        The stream of the draw.
    way
        ``"fresh"``: each element is random. ``"invented"``: its color is no ink. ``"copied"``: it is one of ``seen``.
        ``"repeated"``: 2 x 2 elements return. ``"sorted"``: its number grows with its first index.
    seen
        The numbers of the elements of a sample, one set for each call of :meth:`number`.
    used
        The same for the elements of this picture.
    """

    x: Plane
    y: Plane
    inks: Colors
    rng: np.random.Generator
    way: str = "fresh"
    seen: list[Plane] = field(default_factory=list)
    used: list[Plane] = field(default_factory=list)

    def number(self, i: Index, j: Index | int = 0) -> Plane:
        """Return a random number in [0, 1) for the element (i, j) of each point."""
        table, side = self.rng.random((_TABLE, _TABLE)), np.arange(_TABLE)
        if self.way == "repeated":
            table = table[side % 2][:, side % 2]
        elif self.way == "copied":
            table = self.rng.choice(self.seen[len(self.used)], table.shape)
        elif self.way == "sorted":
            place = (side - i.min()) % _TABLE
            table = np.clip((place[:, np.newaxis] + table) / (i.max() - i.min() + 1), 0, 0.9999)
        numbers = table[i % _TABLE, j % _TABLE]
        self.used.append(np.unique(numbers))
        return np.asarray(numbers)

    def ink(self, i: Index, j: Index | int = 0) -> Colors:
        """Return the ink of the element of each point."""
        return self.choose(self.number(i, j))

    def choose(self, number: Plane) -> Colors:
        """Return the ink that belongs to a number in [0, 1), or an invented one."""
        inks = self.inks[1:]
        if self.way != "invented":
            return np.asarray(inks[(number * len(inks)).astype(int)])
        spread = np.cov(inks.T) + 0.1**2 * np.eye(3)
        drawn = self.rng.multivariate_normal(inks.mean(0), spread, 20 * _TABLE**2).clip(0, 1)
        distances = np.linalg.norm(rgb2lab(drawn)[:, np.newaxis] - rgb2lab(self.inks), axis=-1)
        drawn = drawn[distances.min(1) > _NEW]
        return np.asarray(drawn[(number * len(drawn)).astype(int)])

    def tint(self, deviation: float, i: Index, j: Index | int = 0) -> Colors:
        """Return a normal factor of the color of the element of each point."""
        return 1 + deviation * np.asarray(ndtri(self.number(i, j).clip(0.002, 0.998)))[..., np.newaxis]

    def grain(self, deviation: float, sigma: float | tuple[float, float] = 0.0) -> Colors:
        """Return noise of whole pixels, smooth over ``sigma`` px."""
        noise = gaussian_filter(self.rng.standard_normal(np.array(self.x.shape) // _FINER), sigma)
        fine = noise.repeat(_FINER, 0).repeat(_FINER, 1)[..., np.newaxis]
        return np.asarray(deviation * fine / noise.std())


Paint = Callable[[Canvas], Colors]


class Kind(NamedTuple):
    """One kind of texture.

    Parameters
    ----------
    paint
        The function that paints it. An element lies in the middle of each lattice point.
    vectors
        Generating vectors px in the axes of the kind.
    rotation
        Degrees from x to the first axis.
    inks
        Whether it is a print, in any palette.
    varied
        Whether its elements differ visibly.
    """

    paint: Paint
    vectors: tuple[tuple[float, float], tuple[float, float]]
    rotation: float = 0.0
    inks: bool = False
    varied: bool = True


KINDS: dict[str, Kind] = {}


def kind(*vectors: tuple[float, float], **options: Any) -> Callable[[Paint], Paint]:
    """Enter a kind with the name of the function that paints it."""

    def enter(paint: Paint) -> Paint:
        KINDS[paint.__name__] = Kind(paint, (vectors[0], vectors[1]), **options)
        return paint

    return enter


def plus(x: Plane, y: Plane) -> Plane:
    """Return the distance to a cross."""
    return np.minimum(shapes.box(x, y, 16, 5), shapes.box(x, y, 5, 16))


# Prints


@kind((21.4, 0), (10.7, 21.4 * 0.75**0.5), inks=True)
def dots(c: Canvas) -> Colors:
    """Paint polka dots."""
    index, at = shapes.honeycomb(c.x, c.y, 21.4)
    return mix(coverage(shapes.disc(*at, 14.2)), c.inks[0], c.ink(*index))


@kind((13.7, 13.7), (13.7, -13.7), inks=True)
def checks(c: Canvas) -> Colors:
    """Paint a checkerboard: every second field is ground."""
    i, j = (shapes.split_period(part, 13.7)[0] for part in (c.x, c.y))
    return mix(((i + j) % 2 == 0) * 1.0, c.inks[0], c.ink(i, j))


@kind((16, 0), (8, 8), inks=True)
def pixels(c: Canvas) -> Colors:
    """Paint a wall of bricks on whole pixels."""
    index, (along, across) = shapes.rows(c.x, c.y, 16, 8, 0.5)
    shade = 1 + 0.14 * (across < -2) - 0.16 * (across > 3)
    return mix(((along > -7) & (across > -3)) * 1.0, 0.8 * c.inks[0], c.ink(*index) * shade[..., np.newaxis])


@kind((22.3, 13.55), (0, 27.1), inks=True)
def halfdrop(c: Canvas) -> Colors:
    """Paint flowers in columns, each half a period lower than the last."""
    index, (down, right) = shapes.rows(c.y, c.x, 27.1, 22.3, 0.5)
    turn, radius = np.arctan2(down, right), np.hypot(down, right)
    flower = mix(coverage(radius - 8.6 - 1.9 * np.cos(5 * turn)), c.inks[0], c.ink(*index))
    return mix(coverage(radius - 2.6), flower, 0.5 * c.inks[0])


@kind((22.6, 0), (0, 22.6), rotation=7.0, inks=True)
def panels(c: Canvas) -> Colors:
    """Paint square panels with dark joints."""
    index, at = shapes.cells(c.x, c.y, 22.6, 22.6)
    return mix(coverage(shapes.box(*at, 20.4, 20.4)), 0.3 * c.inks[0], c.ink(*index))


@kind((24.2, 0), (0, 21.8), inks=True)
def icons(c: Canvas) -> Colors:
    """Paint discs, frames and crosses."""
    index, (right, down) = shapes.cells(c.x, c.y, 24.2, 21.8)
    number, frame = 3 * c.number(*index), abs(shapes.box(right, down, 12, 12)) - 1.8
    distance = np.choose(number.astype(int), (shapes.disc(right, down, 15.4), frame, plus(right, down)))
    return mix(coverage(distance), c.inks[0], c.choose(number % 1))


@kind((20.8, 0), (10.4, 11.3), inks=True)
def scales(c: Canvas) -> Colors:
    """Paint fish scales, each row over the next one."""
    top = np.zeros((3, *c.x.shape))
    for step in (1, 0, -1):
        j = np.rint(c.y / 11.3) + step
        i, right = shapes.split_period(c.x - j * 10.4, 20.8)
        distance = shapes.disc(right, c.y - j * 11.3 + 4, 24)
        top = np.where((distance < 0) | (step == 1), np.stack([i, j, distance]), top)
    i, j = top[:2].astype(int)
    return mix(coverage(abs(top[2]) - 1.3), c.ink(i, j), 0.4 * c.inks[0])


@kind((10.8, 15.6), (10.8, -15.6), inks=True)
def harlequin(c: Canvas) -> Colors:
    """Paint lozenges with thin lines between them."""
    (i, u), (j, v) = (shapes.split_period(c.x / 21.6 + sign * c.y / 31.2, 1) for sign in (1, -1))
    return mix(coverage((np.maximum(abs(u), abs(v)) - 0.5) * 17.7 + 0.9), c.inks[0], c.ink(i, j))


@kind((25.4, 0), (12.7, 17.9), rotation=12.0, inks=True)
def crosses(c: Canvas) -> Colors:
    """Paint crosses in staggered rows."""
    index, at = shapes.rows(c.x, c.y, 25.4, 17.9, 0.5)
    return mix(coverage(plus(*at)), c.inks[0], c.ink(*index))


@kind((24.6, 0), (0, 24.6), inks=True)
def rings(c: Canvas) -> Colors:
    """Paint rings of one ink around discs of several."""
    index, at = shapes.cells(c.x, c.y, 24.6, 24.6)
    outer = mix(coverage(shapes.disc(*at, 20.2)), c.inks[0], 0.6 * c.inks[1] + 0.1)
    return mix(coverage(shapes.disc(*at, 13)), outer, c.ink(*index))


# Others


@kind((19.3, 0), (0, 19.3), rotation=45.0, varied=False)
def net(c: Canvas) -> Colors:
    """Paint thin wires between knots that are displaced a little."""
    moves = c.rng.normal(0, 0.04 * 19.3, (2, _TABLE, _TABLE))
    i, j = np.floor(c.x / 19.3).astype(int), np.floor(c.y / 19.3).astype(int)
    u, v = c.x / 19.3 - i, c.y / 19.3 - j
    parts = (((1 - u) * (1 - v), 0, 0), (u * (1 - v), 1, 0), ((1 - u) * v, 0, 1), (u * v, 1, 1))
    right, down = (sum(w * move[(i + a) % _TABLE, (j + b) % _TABLE] for w, a, b in parts) for move in moves)
    wires = np.minimum(*(abs(shapes.split_period(at, 19.3)[1]) for at in (c.x - right, c.y - down)))
    return mix(coverage(shapes.stripe(wires, 2.2)), (0.85, 0.87, 0.84), (0.18, 0.24, 0.30)) + c.grain(0.01, 1.0)


@kind((21.7, 0), (0, 21.7))
def rare(c: Canvas) -> Colors:
    """Paint tiles of soft grain, one in twelve of another color."""
    index, at = shapes.cells(c.x, c.y, 21.7, 21.7)
    color = np.where((c.number(*index) < 1 / 12)[..., np.newaxis], (0.68, 0.36, 0.26), (0.72, 0.70, 0.64))
    tile = color * c.tint(0.02, *index) + c.grain(0.03, 1.2)
    return mix(coverage(shapes.box(*at, 19.6, 19.6, 1.5)), (0.42, 0.41, 0.39), tile)


@kind((35.2, 0), (17.6, 10.3), rotation=4.0)
def flemish(c: Canvas) -> Colors:
    """Paint bricks of two lengths by turns."""
    j, down = shapes.split_period(c.y, 10.3)
    i, right, width = shapes.boxes(c.x - j * 17.6, (23.4, 11.8))
    brick = np.array((0.60, 0.34, 0.26)) * c.tint(0.16, i, j) + c.grain(0.035)
    return mix(coverage(shapes.box(right, down, width - 1.9, 8.4)), (0.76, 0.73, 0.68), brick)


@kind((12.6, 0), (0, 12.6), rotation=15.0)
def halftone(c: Canvas) -> Colors:
    """Paint black dots of random sizes."""
    index, at = shapes.cells(c.x, c.y, 12.6, 12.6)
    return mix(coverage(shapes.disc(*at, 4.5 + 6.5 * c.number(*index))), (0.95, 0.95, 0.93), (0.10, 0.10, 0.11))


@kind((27.3, 0), (9.0, 22.1), rotation=-9.0, varied=False)
def motif(c: Canvas) -> Colors:
    """Paint leaves of one print, all alike."""
    _, at = shapes.rows(c.x, c.y, 27.3, 22.1, 9.0 / 27.3)
    right, down = shapes.rotate(*at, 35.0)
    edge = abs(down) - 5.4 * np.cos(np.clip(right / 11, -1, 1) * np.pi / 2)
    leaf = mix(coverage(edge), (0.93, 0.90, 0.82), (0.22, 0.42, 0.30))
    return mix(coverage(shapes.box(right, down, 19, 1.6)), leaf, (0.80, 0.76, 0.50))


@kind((13.2, 11.6), (13.2, -11.6))
def cloth(c: Canvas) -> Colors:
    """Paint a plain weave of two yarns."""
    warp, weft = shapes.interlace(c.x, c.y, (13.2, 11.6), 1.6, np.eye(2, dtype=bool))
    picture = np.broadcast_to((0.10, 0.09, 0.12), (*c.x.shape, 3))
    for yarn, color in ((warp, (0.30, 0.40, 0.58)), (weft, (0.82, 0.76, 0.62))):
        picture = mix(yarn.coverage, picture, color * c.tint(0.08, yarn.index) * yarn.shade[..., np.newaxis])
    return picture + c.grain(0.03)


@kind((19.8, 0), (9.9, 17.4))
def cobbles(c: Canvas) -> Colors:
    """Paint gray round stones, lit from the upper left."""
    index, (right, down) = shapes.rows(c.x, c.y, 19.8, 17.4, 0.5)
    outline = np.hypot(right / 1.08, down) - 8.2 - 0.8 * c.number(*index)
    light = 0.5 - 0.016 * (right + down) - 0.0012 * (right**2 + down**2)
    stone = light[..., np.newaxis] * c.tint(0.14, *index) + c.grain(0.03, 0.8)
    return mix(coverage(outline), (0.20, 0.19, 0.18), stone * (1, 0.99, 0.96))


@kind((13.4, 14.6), (13.4, -14.6), varied=False)
def chainlink(c: Canvas) -> Colors:
    """Paint wires that cross, before a blurred green."""
    picture = np.array((0.30, 0.38, 0.26)) + c.grain(0.03, 4.0)
    for sign in (1, -1):
        across = shapes.split_period(c.x / 26.8 + sign * c.y / 29.2, 1)[1] * 19.7
        wire = np.array((0.74, 0.76, 0.77)) * shapes.round_profile(across, 3.6, 0.6)[..., np.newaxis]
        picture = mix(coverage(shapes.stripe(across, 3.4)), picture, wire)
    return picture + c.grain(0.012)


@kind((17.2, 0), (8.6, 17.2 * 0.75**0.5), varied=False)
def grille(c: Canvas) -> Colors:
    """Paint brushed gray metal with round holes."""
    _, at = shapes.honeycomb(c.x, c.y, 17.2)
    metal = 0.62 + c.grain(0.05, (0.4, 6.0)) + 0.12 * coverage(abs(shapes.disc(*at, 11.6)) - 0.7)[..., np.newaxis]
    return mix(coverage(shapes.disc(*at, 10.6)), metal * (0.98, 1, 1.02), (0.12, 0.12, 0.13))


@kind((13.4, 0), (0, 11.4))
def knit(c: Canvas) -> Colors:
    """Paint stitches in rows of one of two yarns."""
    right = shapes.split_period(c.x, 13.4)[1]
    j, down = shapes.split_period(c.y - 0.85 * (abs(right) - 3.35), 11.4)
    legs = shapes.round_profile(abs(right) - 3.35, 6.8, 0.55) * shapes.round_profile(down, 11.6, 0.5)
    yarn = np.where((c.number(j) < 0.5)[..., np.newaxis], (0.76, 0.30, 0.26), (0.88, 0.85, 0.78))
    return np.asarray(yarn * (legs[..., np.newaxis] + c.grain(0.04)))


# Draws


@dataclass(frozen=True)
class Specimen:
    """One sample of a kind, and draws of the same texture.

    Parameters
    ----------
    kind, palette
        Names of the kind and of its palette.
    number
        Number of the sample.
    side
        px: side of the sample.
    """

    kind: str
    palette: str
    number: int
    side: int = 128

    @property
    def name(self) -> str:
        """Name of the texture."""
        return f"{self.kind}, {self.palette}" if KINDS[self.kind].inks else self.kind

    @property
    def half(self) -> str:
        """The half to which the kind belongs."""
        return ("setting", "report")[[*KINDS].index(self.kind) % 2]

    def stream(self, role: str, *entropy: int | str) -> np.random.Generator:
        """Return a stream of this sample."""
        return stream(role, "zoo", self.kind, self.palette, self.number, *entropy)

    def lattice(self, role: str) -> Lattice:
        """Return the lattice; each role has a phase of its own, and pixel art lies on whole pixels."""
        origin = self.stream(role).uniform(0, 64, 2)
        frame = Frame(tuple(np.rint(origin) + 0.5 if self.kind == "pixels" else origin), KINDS[self.kind].rotation)
        return Lattice(*map(frame.vector, KINDS[self.kind].vectors), frame.origin)

    def paint(self, shape: Shape, role: str, draw: int = 0, way: str = "fresh") -> tuple[Image, list[Plane]]:
        """Return a draw, rounded to 8 bits, and the numbers of its elements."""
        y, x = (np.arange(_FINER * side) / _FINER + (1 / _FINER - 1) / 2 for side in shape)
        left, top = self.lattice(role).origin
        at = shapes.rotate(*np.meshgrid(x - left, y - top), KINDS[self.kind].rotation)
        seen = self.paint((self.side, self.side), "render")[1] if way == "copied" else []
        canvas = Canvas(*at, np.array(PALETTES[self.palette]), self.stream(role, draw), way, seen)
        fine = KINDS[self.kind].paint(canvas).clip(0, 1).reshape(shape[0], _FINER, shape[1], _FINER, 3)
        return quantize(fine.mean((1, 3)).astype(np.float32)), canvas.used

    def output(self, way: str = "fresh", draw: int = 0) -> Image:
        """Return a picture of the size of outputs; draws of one number and phase differ by their elements only."""
        return self.paint(SIZE, "synthesis", draw, way)[0]

    def join_halves(self) -> Image:
        """Return a picture whose elements are joined of halves of two elements."""
        lattice = self.lattice("synthesis")
        places = np.stack(np.meshgrid(np.arange(SIZE[1]), np.arange(SIZE[0])), -1)
        turn = lattice.to_cell(places.reshape(-1, 2))[:, 0].reshape(*SIZE, 1)
        return np.where(turn % 1 < 0.5, self.output(), self.output(draw=1))

    def edit(self, name: str) -> Image:
        """Return a fresh draw with an edit that everybody sees."""
        vectors, rng = self.lattice("synthesis").matrix, self.stream("synthesis", name)
        return apply_edit(name, EDITS[name][2][-1], self.output(), vectors, rng)

    def judge(self, by: str, output: Image | None, least: float = 0.0, most: float = 1.0, **labels: Any) -> list[Row]:
        """Return how an output is judged, with its bounds; nothing if there is no output."""
        own = {"half": self.half, "by": by, "least": least, "most": most, **labels}
        return [] if output is None else [own | subject_of(self, by).judge(output)]


@lru_cache(maxsize=4)
def subject_of(specimen: Specimen, by: str) -> Subject:
    """Return the sample, with fresh draws on its lattice if it is judged by the ``"model"``."""
    lattice, shape = specimen.lattice("render"), (specimen.side, specimen.side)

    def again(shape: Shape, number: int) -> Texture:
        return Texture(specimen.paint(shape, "render", number + 1)[0], lattice, (lattice,))

    image = specimen.paint(shape, "render")[0]
    if by == "sample":
        return Subject(specimen.name, Texture(image, lattice, (lattice,)))
    ideal = np.mean([again(shape, number).image for number in range(8)], 0, dtype=np.float32)
    return Subject(specimen.name, Texture(image, lattice, (lattice,), ideal=ideal), again)


FAULTS: Mapping[str, tuple[str, Callable[[Specimen], Image], str]] = {
    "slipped along rows": ("regularity", lambda s: s.edit("half slipped along rows, s"), ""),
    "slipped along columns": ("regularity", lambda s: s.edit("half slipped along columns, s"), ""),
    "halves joined": ("integrity", Specimen.join_halves, "varied"),
    "2 x 2 repeated": ("randomness", lambda s: s.output("repeated"), "varied"),
    "sorted": ("randomness", lambda s: s.output("sorted"), "varied"),
    "new inks": ("appearance", lambda s: s.output("invented"), "inks"),
    "warmer": ("appearance", lambda s: s.edit("warmer, levels"), ""),
    "blurred": ("appearance", lambda s: s.edit("blur, px"), ""),
    "grain": ("appearance", lambda s: s.edit("gray grain, levels"), ""),
}
"""The peril of each fault, what plants it, and which field of a kind says that it can be seen there."""


def specimens(options: Options, prints: bool = False) -> Iterator[Specimen]:
    """Yield the samples of the chosen kinds; a print has all palettes, or one in turn."""
    for place, (name, each) in enumerate(KINDS.items()):
        palettes = [*PALETTES] if prints else [[*PALETTES][place // 2 % len(PALETTES)]]
        for palette, number in product(palettes, range(options.count)):
            found = Specimen(name, palette, number)
            asked = options.half in ("both", found.half) and (not options.kinds or name in options.kinds)
            if asked and (each.inks or not prints):
                yield found


def print_rows(rows: list[Row], *columns: str) -> None:
    """Print the quality in groups, the share within bounds of those that are judged, and those that are not."""
    table = pd.DataFrame(rows).astype({"score": float})
    table["good"] = (table["score"] >= table["least"]) & (table["score"] <= table["most"])
    tell = print_table("half", "by", *columns, "n", "undecided", "least", "mean", "largest", "beyond the bounds")
    for key, own in table.groupby(["half", "by", *columns], sort=False):
        score, bad = own["score"], own[~own["good"] & own["score"].notna()].to_dict("records")
        others = "; ".join(f"{row['texture']} {perils_text(row)}" for row in bad) or "-"
        tell(*key, len(own), score.isna().sum(), *map(show, (score.min(), score.mean(), score.max())), others)
    for (half, by, least, most, group), own in table.groupby(["half", "by", "least", "most", columns[0]], sort=False):
        judged = own[own["score"].notna()]
        share = f"{judged['good'].mean():.3f} of {len(judged)} judged from {least} to {most}"
        print(f"\n{half}, by {by}, {columns[0]} {group}: {share}, {len(own) - len(judged)} undecided")


def study_fresh(options: Options) -> None:
    """Print the quality of fresh draws, by samples of two sizes."""
    rows = []
    for by, side, case in product(options.by, options.sides, specimens(options)):
        rows += replace(case, side=side).judge(by, case.output(), LEAST_FRESH, side=side)
    print_rows(rows, "side", "texture")


def study_prints(options: Options) -> None:
    """Print how prints of the right and of wrong inks are judged, and copies of them."""
    bounds = {"fresh": (LEAST_PRINT, 1.0), "invented": (0.0, MOST_NEW), "copied": (LEAST_COPY, 1.0)}
    rows = []
    for by, case in product(options.by, specimens(options, True)):
        for way, (least, most) in bounds.items():
            rows += case.judge(by, case.output(way), least, most, way=way)
        for name, least in (("tile-set", LEAST_COPY), ("resample", 0.0)) if case.number == 0 else ():
            sample = subject_of(case, by).texture
            rows += case.judge(by, baseline(name, sample.image, sample.lattice, SIZE), least, way=name)
    print_rows(rows, "way", "texture")


def study_faults(options: Options) -> None:
    """Print the quality of planted faults."""
    rows = []
    for by, (fault, (peril, plant, needs)), case in product(options.by, FAULTS.items(), specimens(options)):
        if not needs or getattr(KINDS[case.kind], needs):
            rows += case.judge(by, plant(case), most=MOST_FAULT, fault=fault, peril=peril)
    print_rows(rows, "peril", "fault")


def draw_sheet(options: Options) -> None:
    """Draw one picture of each kind, or the faults and copies of some."""
    options.count, pictures = 1, {}
    for case in specimens(options):
        pictures[case.name] = case.output()
        for fault, (_, plant, needs) in FAULTS.items() if options.kinds else ():
            if not needs or getattr(KINDS[case.kind], needs):
                pictures[f"{case.name}: {fault}"] = plant(case)
    columns, step = 5, np.add(SIZE[::-1], (8, 22))
    sheet = PIL.Image.new("RGB", tuple(map(int, step * (columns, -(-len(pictures) // columns)))), "white")
    for place, (name, picture) in enumerate(pictures.items()):
        left, top = map(int, step * (place % columns, place // columns))
        sheet.paste(to_pil(picture), (left, top))
        PIL.ImageDraw.Draw(sheet).text((left + 2, top + SIZE[0] + 4), name, fill="black")
    sheet.save(options.file)


STUDIES: Mapping[str, Callable[[Options], None]] = {
    "fresh": study_fresh,
    "prints": study_prints,
    "faults": study_faults,
    "draw": draw_sheet,
}


def main() -> None:
    """Run a study, and print its table."""
    halves, references = ("setting", "report", "both"), ("sample", "model")
    choices = {"study": STUDIES, "half": halves, "kinds": KINDS, "by": references}
    more = {"half": "both", "kinds": [], "count": 5, "by": ["sample"], "sides": [128, 96]}
    options = read_options(__doc__, ["study", "file"], choices, study="fresh", file="zoo.png", **more)
    STUDIES[options.study](options)


if __name__ == "__main__":
    main()
