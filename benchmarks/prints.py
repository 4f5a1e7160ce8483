"""Whether the elements of outputs have the colors of their sample, on ten prints whose elements have one of a few inks.

``python benchmarks/prints.py colors [--method METHOD] [--lattice given|own] [--seeds N ...] [--names NAME ...]``

For each of the prints of ``labels/prints-2.toml`` it prints what :class:`Comparison` describes, worst over the seeds.
``--sheet FILE.png`` writes all samples beside outputs. The fresh draws of method ``oracle`` are a control.

``python benchmarks/prints.py draw FOLDER``

Draws these prints, and six others whose outputs were labeled. Each print is a file, from which a sample and a fresh
draw are cut. FOLDER/invented holds pictures of the labeled prints whose elements have colors that are no inks: normal
values with the mean and the covariance of the inks.
"""

import argparse
import contextlib
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter
from skimage.color import rgb2lab

from nrbench import Refused, synthesize
from nrbench.datasets_procedural.modelling import pattern as shapes
from nrbench.imaging.convert import Image
from nrbench.pictures.files import write_image
from nrbench.pictures.overlays import contact_sheet
from nrbench.plugins.forms import Shape
from nrbench.suites.plan import Sample, draw_samples
from nrbench.suites.suite import load_suite
from nrbench.synthesizers.precomputed import name_for

Colors = NDArray[np.float64]
Plane = NDArray[np.float64]
Numbers = NDArray[np.int64]
SHAPE, SIZE, FINE = (416, 256), (256, 256), 4
"""Shape of a picture and of an output, px, and samples of each pixel along a side."""
MOST_AWAY = 3.0
"""CIELAB: bound of the distance from the sample's colors."""
SUITE = Path(__file__).resolve().parent / "labels" / "prints.toml"
"""The prints whose outputs were labeled."""
GRADED = SUITE.with_name("prints-2.toml")
"""The ten others."""
INKS = {
    "berry": [(0.80, 0.15, 0.25), (0.15, 0.25, 0.60), (0.95, 0.75, 0.20)],
    "mint": [(0.10, 0.45, 0.35), (0.75, 0.90, 0.80)],
    "earth": [(0.55, 0.30, 0.15), (0.80, 0.60, 0.35), (0.30, 0.20, 0.15), (0.90, 0.85, 0.70)],
    "candy": [(0.95, 0.45, 0.60), (0.45, 0.75, 0.90), (0.60, 0.85, 0.45)],
}
PRINTS = {
    "polka-berry": ("polka", "berry", 24.3),
    "polka-mint": ("polka", "mint", 21.7),
    "checks-candy": ("checks", "candy", 15.3),
    "checks-mint": ("checks", "mint", 17.9),
    "wall-earth": ("wall", "earth", 9.7),
    "wall-berry": ("wall", "berry", 11.3),
}


# Prints whose outputs were labeled; their pixels stay as they are


def draw(kind: str, size: float, color: Callable[[int], Colors]) -> Colors:
    """Return a print (height, width, 3) whose elements have the colors ``color(count)``; the period is ``size`` px."""
    y, x = (np.mgrid[: SHAPE[0] * FINE, : SHAPE[1] * FINE] + 0.5) / FINE
    high, wide = {"polka": (size * 3**0.5 / 2, size), "checks": (size, size), "wall": (size, 2.2 * size)}[kind]
    row = np.floor(y / high).astype(int)
    column = np.floor(x / wide - 0.5 * (row % 2) * (kind != "checks")).astype(int) + 1
    u, v = x / wide - 0.5 * (row % 2) * (kind != "checks") - column + 0.5, y / high - row - 0.5
    colors = color((row.max() + 1) * (column.max() + 1)).reshape(row.max() + 1, column.max() + 1, 3)
    picture = colors[row, column]
    if kind == "polka":
        picture[np.hypot(u * wide, v * high) > 0.33 * size] = (0.96, 0.94, 0.88)
    if kind == "wall":
        picture[(abs(u) * wide > wide / 2 - 0.8) | (abs(v) * high > high / 2 - 0.8)] = (0.12, 0.12, 0.14)
    return picture.reshape(SHAPE[0], FINE, SHAPE[1], FINE, 3).mean((1, 3))


def _draw_inks(inks: Colors, rng: np.random.Generator, count: int) -> Colors:
    """Return inks, ``(count, 3)``, each drawn with equal chances."""
    return np.asarray(inks[rng.integers(len(inks), size=count)])


def _invent_colors(inks: Colors, rng: np.random.Generator, count: int) -> Colors:
    """Return normal values with the mean and the covariance of the inks, ``(count, 3)``."""
    return np.clip(rng.multivariate_normal(inks.mean(0), np.cov(inks.T, bias=True), size=count), 0, 1)


def draw_labeled(folder: Path) -> None:
    """Write the prints whose outputs were labeled."""
    (folder / "invented").mkdir(parents=True, exist_ok=True)
    others = {}
    for number, (name, (kind, palette, size)) in enumerate(PRINTS.items()):
        inks, rng = np.array(INKS[palette]), np.random.default_rng(440 + number)
        write_image(folder / f"{name}.png", draw(kind, size, partial(_draw_inks, inks, rng)))
        other = draw(kind, size, partial(_invent_colors, inks, rng))
        others[name] = other[: SIZE[0]]
    with contextlib.chdir(folder):
        for sample in draw_samples(load_suite(str(SUITE))):
            assert sample.texture is not None
            write_image(f"invented/{name_for(sample.texture.image, SIZE)}", others[sample.row.name])


# Prints whose elements are known


class Layout(NamedTuple):
    """The elements of a print at each point.

    Parameters
    ----------
    row, column
        Numbers of the element.
    part
        Number of the part of the element, such as its rim; -1 on the ground.
    """

    row: Numbers
    column: Numbers
    part: Numbers


Lay = Callable[[Plane, Plane], Layout]


def lay_parts(index: tuple[Numbers, Numbers], *distances: Plane) -> Layout:
    """Return the layout of elements whose parts have these signed distances; later parts lie over earlier ones."""
    part = np.full(distances[0].shape, -1)
    for number, distance in enumerate(distances):
        part[distance < 0] = number
    return Layout(index[1], index[0], part)


def lay_dots(x: Plane, y: Plane, period: float, rim: float = 0.0, light: float = 0.0) -> Layout:
    """Return the layout of polka dots, with a rim of some px, or a small light of a share of the period."""
    index, at = shapes.honeycomb(x, y, period)
    dot = shapes.disc(*at, 0.68 * period)
    if rim:
        return lay_parts(index, dot, dot + rim)
    if light:
        return lay_parts(index, dot, shapes.disc(at[0] + 0.1 * period, at[1] + 0.1 * period, light * period))
    return lay_parts(index, dot)


def lay_checks(x: Plane, y: Plane, period: float) -> Layout:
    """Return the layout of squares without ground."""
    index, _ = shapes.cells(x, y, period, period)
    return lay_parts(index, np.full(x.shape, -1.0))


def lay_pixels(x: Plane, y: Plane) -> Layout:
    """Return the layout of a wall of pixels: 16 x 8 with joints of one, a light row above and a dark one below."""
    index, (along, across) = shapes.rows(x - 0.5, y - 0.5, 16, 8, 0.5)
    brick = shapes.box(along - 0.5, across - 0.5, 15, 7)
    return lay_parts(index, brick, np.maximum(brick, across + 2), np.maximum(brick, 3 - across))


def lay_flowers(x: Plane, y: Plane) -> Layout:
    """Return the layout of flowers in a half drop."""
    index, (down, right) = shapes.rows(y, x, 29.3, 23.6, 0.5)
    turn, radius = np.arctan2(down, right), np.hypot(down, right)
    return lay_parts(index, radius - 8.6 - 2.2 * np.cos(5 * turn), radius - 3.4)


def lay_stars(x: Plane, y: Plane) -> Layout:
    """Return the layout of turned stars with a star of another ink inside."""
    index, at = shapes.rows(*shapes.rotate(x, y, 11.0), 28.7, 24.1, 0.5)
    turn, radius = np.arctan2(*at), np.hypot(*at)
    star = radius * (0.72 + 0.28 * np.abs(np.sin(2.5 * turn)))
    return lay_parts(index, star - 8.4, star - 4.2)


def lay_dashes(x: Plane, y: Plane) -> Layout:
    """Return the layout of stripes broken into dashes."""
    index, at = shapes.rows(x, y, 26.2, 10.7, 0.35)
    return lay_parts(index, shapes.capsule(*at, 23.0, 6.6))


def lay_scales(x: Plane, y: Plane) -> Layout:
    """Return the layout of scales, each row over the next one, with dark edges."""
    i, j, edge = np.zeros((3, *x.shape))
    for step in (1, 0, -1):
        row = np.rint(y / 12.1) + step
        column, right = shapes.split_period(x - row * 11.2, 22.4)
        distance = shapes.disc(right, y - row * 12.1 + 4, 25.6)
        over = (distance < 0) | (step == 1)
        i, j, edge = np.where(over, np.stack([column, row, distance]), (i, j, edge))
    return lay_parts((i.astype(int), j.astype(int)), edge + 1.4)


@dataclass(frozen=True)
class Print:
    """A print.

    Parameters
    ----------
    lay
        Returns the layout at points (x, y) in px of the file.
    ground
        sRGB color of the ground.
    inks
        ``(classes, parts, 3)``: the colors of an element of each class.
    shares
        The share of each class; by default they are equal.
    runs
        Chance that an element has the class of the one before it in its row, whatever the shares.
    """

    lay: Lay
    ground: tuple[float, float, float]
    inks: Sequence[Sequence[tuple[float, float, float]]]
    shares: Sequence[float] | None = None
    runs: float = 0.0

    def layout(self, shape: Shape, corner: tuple[int, int] = (0, 0)) -> Layout:
        """Return the layout of a picture, :data:`FINE` points along a side of a pixel, from a corner (x, y)."""
        y, x = (np.mgrid[: shape[0] * FINE, : shape[1] * FINE] + 0.5) / FINE
        return self.lay(x + corner[0], y + corner[1])

    def classes(self, seed: int) -> Numbers:
        """Return the class of each element, by row and column modulo the shape."""
        rng = np.random.default_rng(seed)
        table = rng.choice(len(self.inks), (64, 64), p=self.shares)
        for column in range(1, 64):
            stays = rng.random(64) < self.runs
            table[stays, column] = table[stays, column - 1]
        return table

    def draw(self, shape: Shape, classes: Numbers) -> Colors:
        """Return a picture ``(height, width, 3)``, from the corner of the file."""
        at = self.layout(shape)
        inks = np.array(self.inks)[classes[at.row % len(classes), at.column % len(classes)], np.maximum(at.part, 0)]
        picture = np.where(at.part[..., np.newaxis] < 0, self.ground, inks)
        return picture.reshape(shape[0], FINE, shape[1], FINE, 3).mean((1, 3))


CREAM, NIGHT, SAND = (0.95, 0.92, 0.85), (0.13, 0.15, 0.22), (0.86, 0.80, 0.68)
RED, BLUE, YELLOW, GREEN = (0.82, 0.22, 0.20), (0.16, 0.34, 0.62), (0.93, 0.74, 0.22), (0.24, 0.52, 0.34)
TEAL, PINK, BROWN, WHITE = (0.20, 0.55, 0.58), (0.90, 0.55, 0.62), (0.48, 0.30, 0.20), (0.97, 0.97, 0.95)
DESIGNS: Mapping[str, Print] = {
    "dots-two": Print(partial(lay_dots, period=23.7), CREAM, [[TEAL], [RED]], (0.7, 0.3)),
    "dots-three": Print(partial(lay_dots, period=21.3), WHITE, [[RED], [BLUE], [YELLOW]]),
    "dots-rim": Print(
        partial(lay_dots, period=25.4, rim=1.8), SAND, [[NIGHT, ink] for ink in (RED, BLUE, YELLOW, GREEN)]
    ),
    "dots-light": Print(
        partial(lay_dots, period=24.9, light=0.22), NIGHT, [[ink, WHITE] for ink in (PINK, TEAL, YELLOW)]
    ),
    "checks": Print(partial(lay_checks, period=14.6), CREAM, [[PINK], [TEAL], [CREAM]]),
    "pixels": Print(
        lay_pixels,
        (0.20, 0.18, 0.18),
        [
            [ink, tuple(min(1.0, 1.2 * v) for v in ink), tuple(0.75 * v for v in ink)]
            for ink in (BROWN, RED, SAND, TEAL)
        ],
        (0.4, 0.3, 0.2, 0.1),
    ),
    "flowers": Print(lay_flowers, GREEN, [[PINK, YELLOW], [CREAM, RED], [BLUE, CREAM]]),
    "stars": Print(lay_stars, NIGHT, [[YELLOW, RED], [WHITE, BLUE], [TEAL, YELLOW]]),
    "dashes": Print(lay_dashes, CREAM, [[RED], [BLUE], [GREEN]], runs=0.6),
    "scales": Print(lay_scales, (0.10, 0.20, 0.24), [[TEAL], [SAND], [BLUE]]),
}
"""The ten prints, by name."""
CLASSES = {name: design.classes(460 + number) for number, (name, design) in enumerate(DESIGNS.items())}
"""The class of each element of their files."""


def draw_graded(folder: Path) -> None:
    """Write the ten prints."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, design in DESIGNS.items():
        write_image(folder / f"{name}.png", design.draw(SHAPE, CLASSES[name]))


@contextlib.contextmanager
def graded_samples(names: Sequence[str] = ()) -> Iterator[list[Sample]]:
    """Yield the samples of the ten prints, or of those named, in a folder that has their files."""
    with tempfile.TemporaryDirectory() as folder:
        draw_graded(Path(folder))
        with contextlib.chdir(folder):
            yield list(draw_samples(load_suite(str(GRADED)), list(names)))


# Colors of elements


class Elements(NamedTuple):
    """The elements of a picture of which half the inner pixels are shown, or more.

    Parameters
    ----------
    place
        ``(n, 2)``: row and column.
    color
        ``(n, parts, 3)``: mean CIELAB color of the inner pixels of each part that has some. An inner pixel and those
        around it lie in one part.
    scatter
        ``(n, parts)``: root mean squared distance of these pixels from the mean, CIELAB.
    """

    place: Numbers
    color: Colors
    scatter: Plane


def find_elements(design: Print, picture: Image, corner: tuple[int, int]) -> Elements:
    """Return the elements of a picture of a print, whose corner (x, y) lies there in the file."""
    at = design.layout((picture.shape[0], picture.shape[1]), corner)
    key = ((at.row * 1024 + at.column) * 8 + at.part).astype(np.int32)
    alike = minimum_filter(key, 3 * FINE) == maximum_filter(key, 3 * FINE)
    row, column, part, alike = (each[FINE // 2 :: FINE, FINE // 2 :: FINE] for each in (*at, alike))
    inner = alike & (part >= 0)
    place, element = np.unique(np.stack([row[inner], column[inner]], -1), axis=0, return_inverse=True)
    parts, index = np.unique(part[inner], return_inverse=True)
    index += element.ravel() * len(parts)
    box = (len(place), len(parts))

    def mean(values: Colors) -> Colors:
        sums = [np.bincount(index, plane, box[0] * box[1]) for plane in values.T]
        return np.stack(sums, -1).reshape(*box, -1) / np.maximum(counts, 1)[..., np.newaxis]

    counts = np.bincount(index, minlength=box[0] * box[1]).reshape(box)
    colors = rgb2lab(picture[inner].astype(float))
    color = mean(colors)
    away = np.square(colors - color.reshape(-1, 3)[index]).sum(-1, keepdims=True)
    whole = (counts >= 0.5 * np.median(counts, 0)).all(1)
    return Elements(place[whole], color[whole], np.sqrt(mean(away)[whole, :, 0]))


@dataclass(frozen=True)
class Comparison:
    """The elements of an output and those of its sample.

    Parameters
    ----------
    farthest
        The largest distance of an element's color from the nearest element of the sample, CIELAB. Parts count together:
        a petal of one class around the middle of another is far from both.
    uneven
        Share of the elements with a part whose pixels scatter by more than 3 CIELAB; those of the sample do not.
    shares
        Share of the output's elements that would have to change their class, to have them as often as the sample.
    equal
        Share of neighbors in a row that have one class, less that of the sample.
    """

    farthest: float
    uneven: float
    shares: float
    equal: float


def compare(design: Print, classes: Numbers, sample: Elements, output: Elements) -> Comparison:
    """Return how the elements of an output differ from those of its sample."""
    away = np.linalg.norm(output.color[:, np.newaxis] - sample.color, axis=-1).max(-1)
    own = classes[sample.place[:, 0] % len(classes), sample.place[:, 1] % len(classes)]
    drawn = own[away.argmin(1)]
    often = [np.bincount(each, minlength=len(design.inks)) / len(each) for each in (own, drawn)]
    equal = [_share_equal(*pair) for pair in ((sample.place, own), (output.place, drawn))]
    return Comparison(
        float(away.min(1).max()),
        float((output.scatter > MOST_AWAY).any(1).mean()),
        float(np.abs(often[0] - often[1]).sum() / 2),
        equal[1] - equal[0],
    )


def _share_equal(place: Numbers, kind: Numbers) -> float:
    """Return the share of neighbors in a row that are of one class."""
    known = {(int(row), int(column)): int(each) for (row, column), each in zip(place, kind, strict=True)}
    pairs = [known[row, column + 1] == each for (row, column), each in known.items() if (row, column + 1) in known]
    return float(np.mean(pairs))


def print_colors(method: str, lattice: str, seeds: Sequence[int], names: Sequence[str], sheet: Path | None) -> None:
    """Print the comparisons of outputs of a method with their samples: the largest distance, else the mean."""
    pictures: list[Image] = []
    captions: list[str] = []
    print("print | farthest, CIELAB | uneven elements | shares of classes | equal neighbors | notes")
    print("--- | --- | --- | --- | --- | ---")
    with graded_samples(names) as samples:
        for sample in samples:
            name, texture, again = sample.row.name, sample.texture, sample.recipe.again(sample.texture)
            assert texture is not None and texture.region is not None
            design, corner, found, notes = DESIGNS[name], texture.region[:2], [], dict[str, None]()
            own = find_elements(design, texture.image, corner)
            for seed in seeds:
                if method == "oracle":
                    fresh = again(SIZE, seed)
                    assert fresh is not None and fresh.region is not None
                    output, corner = fresh.image, fresh.region[:2]
                else:
                    known = texture.lattice if lattice == "given" else None
                    try:
                        made = synthesize(method, texture.image, SIZE, known, seed=seed)
                    except Refused as why:
                        notes[f"refused: {why}"] = None
                        continue
                    output, notes[made.note] = made.image, None
                found.append(compare(design, CLASSES[name], own, find_elements(design, output, corner)))
            table = np.array([astuple(each) for each in found] or [[np.nan] * 4])
            values = " | ".join(f"{value:.2f}" for value in (table[:, 0].max(), *table[:, 1:].mean(0)))
            print(f"{name} | {values} | {'; '.join(filter(None, notes))}", flush=True)
            if found:
                pictures += [texture.image, output]
                captions += [f"{name}: sample", f"{method}, seed {seeds[-1]}"]
    if sheet:
        write_image(sheet, contact_sheet(pictures, captions, 6))


def main() -> None:
    """Draw the prints, or compare the colors of elements."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    studies = parser.add_subparsers(dest="study", required=True)
    studies.add_parser("draw").add_argument("folder", type=Path)
    colors = studies.add_parser("colors")
    colors.add_argument("--method", default="resample")
    colors.add_argument("--lattice", choices=["given", "own"], default="own")
    colors.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3])
    colors.add_argument("--names", nargs="+", choices=list(DESIGNS), default=())
    colors.add_argument("--sheet", type=Path, metavar="FILE.png")
    options = parser.parse_args()
    if options.study == "draw":
        draw_labeled(options.folder)
        draw_graded(options.folder)
    else:
        print_colors(options.method, options.lattice, options.seeds, options.names, options.sheet)


if __name__ == "__main__":
    main()
