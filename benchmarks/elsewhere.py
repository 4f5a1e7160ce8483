"""Validation of the verbs for pictures from elsewhere: does a picture repeat, and where does it leave its lattice.

``python benchmarks/elsewhere.py STUDY [--half setting|report] [--count N]``. Limits are set on the half ``setting``;
the figures of ``report``, other textures and other seeds, are the report.

``edges``
    ``nrbench score --tileable``: false alarms on textures drawn on a torus and on outputs of methods that repeat, and
    the share of faults that are found when they are planted at the right edge of these pictures.
``defects``
    ``nrbench lattice --defects``: fresh draws of all models with their lattices, clean or with one planted fault.
"""

from collections.abc import Callable, Iterator, Mapping
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import fft, ndimage
from scipy.spatial import cKDTree
from studies import Options, run_studies
from validation import models, print_table, show, subjects

import nrbench
from nrbench.calling.tileable import nearest_closing_shape
from nrbench.imaging.convert import Image, quantize
from nrbench.imaging.mean_tile import interpolate
from nrbench.lattice.geometry import Lattice, Points

Rng = np.random.Generator
METHODS = ("tile-set", "quilting", "patch-based", "resample", "tiling", "rsgf")


def filtered(rng: Rng, shape: tuple[int, int], slope: float, least: float = 1.0) -> NDArray[np.float64]:
    """Return noise on a torus whose amplitude falls with the frequency."""
    v, u = np.meshgrid(*(fft.fftfreq(n) * n for n in shape), indexing="ij")
    spectrum = fft.fft2(rng.standard_normal(shape)) * np.maximum(np.hypot(u, v), least) ** -slope
    spectrum[0, 0] = 0
    noise = fft.ifft2(spectrum).real
    return np.asarray(noise / noise.std())


def colored(rng: Rng, number: NDArray[np.intp], spread: float) -> NDArray[np.float64]:
    """Return a color for each number."""
    table = 0.5 + rng.normal(0, spread, (int(number.max()) + 1, 3)) + rng.normal(0, spread, (int(number.max()) + 1, 1))
    return np.asarray(table[number])


def wall(rng: Rng, shift: float = 0.5) -> NDArray[np.float64]:
    """Draw bricks, or square tiles without a shift of the courses, on a torus."""
    width, height = int(rng.integers(24, 44)), int(rng.integers(14, 26))
    across, down = 2 * int(rng.integers(3, 5)), 2 * int(rng.integers(4, 7))
    y, x = np.mgrid[: down * height, : across * width] + rng.uniform(0, 20, 2)[:, None, None]
    row = (y // height).astype(int)
    right = x - shift * width * (row % 2)
    column = np.floor(right / width).astype(int)
    joint = np.minimum(right % width, y % height) < rng.uniform(1.5, 3.5)
    color = colored(rng, (row % down) * across + column % across, rng.uniform(0.02, 0.12))
    return np.where(joint[..., None], 0.8, color)


def dots(rng: Rng) -> NDArray[np.float64]:
    """Draw dots of random sizes and colors on a torus."""
    s, across, down = int(rng.integers(14, 30)), int(rng.integers(6, 10)), int(rng.integers(6, 10))
    y, x = np.mgrid[: down * s, : across * s] + rng.uniform(0, s, 2)[:, None, None]
    number = (y // s).astype(int) % down * across + (x // s).astype(int) % across
    away = np.hypot(x % s - s / 2, y % s - s / 2) - s * rng.uniform(0.25, 0.4, down * across)[number]
    return np.where(away[..., None] < 0, colored(rng, number, 0.1), 0.85)


def threads(rng: Rng) -> NDArray[np.float64]:
    """Draw a plain weave of threads, each of its own color, on a torus."""
    s, across, down = int(rng.integers(8, 16)), 2 * int(rng.integers(7, 11)), 2 * int(rng.integers(7, 11))
    y, x = np.mgrid[: down * s, : across * s] + rng.uniform(0, s, 2)[:, None, None]
    i, j = (x // s).astype(int), (y // s).astype(int)
    spread = rng.uniform(0.02, 0.1)
    warp, weft = colored(rng, i % across, spread), colored(rng, j % down, spread)
    over = (i + j) % 2 == 0
    round_ = np.where(over, np.sin(np.pi * (x % s) / s), np.sin(np.pi * (y % s) / s))
    return np.where(over[..., None], warp, weft) * (0.4 + 0.6 * round_[..., None])


def stones(rng: Rng) -> NDArray[np.float64]:
    """Draw cells around random points, without a lattice, on a torus."""
    shape = rng.integers(150, 260, 2)
    points = rng.uniform(0, 1, (int(rng.integers(40, 120)), 2)) * shape
    tree = cKDTree(points, boxsize=shape)
    distance, number = tree.query(np.moveaxis(np.indices(shape), 0, -1), k=2)
    joint = distance[..., 1] - distance[..., 0] < 2.5
    return np.where(joint[..., None], 0.2, colored(rng, number[..., 0], 0.1))


def clouds(rng: Rng) -> NDArray[np.float64]:
    """Draw smooth noise on a torus."""
    shape = tuple(int(n) for n in rng.integers(128, 280, 2))
    color = np.stack([filtered(rng, shape, rng.uniform(0.9, 2.5), rng.uniform(1, 8)) for _ in range(3)], -1)
    return 0.5 + 0.15 * color @ rng.normal(0, 0.5, (3, 3))


def speckle(rng: Rng) -> NDArray[np.float64]:
    """Draw white noise, blurred a little, in gray on a torus."""
    noise = ndimage.gaussian_filter(rng.standard_normal(rng.integers(96, 280, 2)), rng.uniform(0.4, 2.5), mode="wrap")
    return np.asarray(0.5 + 0.12 * noise[..., None] / noise.std())


PAINTERS: Mapping[str, Callable[[Rng], NDArray[np.float64]]] = {
    "bricks": wall,
    "squares": lambda rng: wall(rng, 0.0),
    "dots": dots,
    "threads": threads,
    "stones": stones,
    "clouds": clouds,
    "speckle": speckle,
}


def paint(name: str, seed: int) -> Image:
    """Draw a picture that repeats, with grain of its own."""
    rng = np.random.default_rng([seed, list(PAINTERS).index(name)])
    image = PAINTERS[name](rng)
    grain = filtered(rng, (image.shape[0], image.shape[1]), rng.uniform(0, 0.6))
    return quantize(np.clip(image + rng.uniform(0.005, 0.04) * grain[..., None], 0, 1).astype(np.float32))


def repeating(half: str, count: int) -> Iterator[tuple[str, Image]]:
    """Yield pictures that repeat: drawn ones, and outputs of methods from fresh draws of textures of ``core``."""
    first = 0 if half == "setting" else 1000
    for name in PAINTERS:
        for seed in range(first, first + count):
            yield name, paint(name, seed)
    for number, subject in enumerate(subjects("core", ["*-*"])):
        method = METHODS[number // 2 % len(METHODS)]
        if subject.again is not None and number % 2 == (half == "report"):
            sample = quantize(subject.again((144, 144), 500 + first).image)
            shape = nearest_closing_shape(subject.texture.lattice, (176, 208), 0.01)
            made = nrbench.synthesize(method, sample, shape, subject.texture.lattice, first, tileable=True)
            yield method, made.image


def mix_ends(image: Image, width: int) -> Image:
    """Return a picture that is cut off at eleven eighteenths, its left end faded into what follows the right one."""
    kept = image.shape[1] * 11 // 18
    rest, part = image[:, kept : kept + width], np.linspace(0, 1, width, dtype=np.float32)[:, np.newaxis]
    return np.concatenate([(1 - part) * rest + part * image[:, :width], image[:, width:kept]], 1)


def blur_edge(image: Image, sigma: float, reach: int) -> Image:
    """Return a picture that is blurred near its left and right edges."""
    blurred = ndimage.gaussian_filter(image, (sigma, sigma, 0), mode="wrap")
    return np.concatenate([blurred[:, :reach], image[:, reach:-reach], blurred[:, -reach:]], 1)


def slope(image: Image, step: float) -> Image:
    """Return a picture that becomes brighter from left to right."""
    return image * np.linspace(1 - step / 2, 1 + step / 2, image.shape[1], dtype=np.float32)[:, np.newaxis]


FAULTS: Mapping[str, Callable[[Image], Image]] = {
    "none": lambda image: image,
    **{f"{n} px lost": partial(lambda n, image: image[:, n:], n) for n in (1, 2, 4, 8)},
    "1 px doubled": lambda image: image[:, np.r_[: image.shape[1], 0]],
    **{f"step of {n} %": partial(lambda n, image: slope(image, n / 100), n) for n in (1, 2, 3, 5)},
    "blur of 1 px": lambda image: blur_edge(image, 1.0, 4),
    "blur of 2 px": lambda image: blur_edge(image, 2.0, 8),
    "faded over 24 px": lambda image: mix_ends(image, 24),
    "cut": lambda image: image[:, : image.shape[1] * 11 // 18],
}
"""Pictures that break across x, made from pictures that repeat."""


def study_edges(options: Options) -> None:
    """Print the share of pictures that break, by the fault that was planted at the right edge and by texture."""
    rows = []
    for texture, image in repeating(options.half, options.count):
        for fault, spoil in FAULTS.items():
            values = nrbench.score(quantize(spoil(image).clip(0, 1)), tileable=True).values
            rows += [
                {"texture": texture, "fault": fault, "breaks": not values[f"tileable.{axis}.repeats"]}
                for axis in ("xy" if fault == "none" else "x")
            ]
    table = pd.DataFrame(rows).pivot_table(index="fault", columns="texture", values="breaks", sort=False)
    tell = print_table("fault", *table.columns, "all")
    for fault, row in table.iterrows():
        every = np.mean([one["breaks"] for one in rows if one["fault"] == fault])
        tell(fault, *(show(value) for value in row), show(every))


def plant(image: Image, lattice: Lattice, fault: str, rng: Rng) -> tuple[Image, Points]:
    """Return a picture with one fault of a cell or a row, and the middle (x, y) of the fault."""
    basis = lattice.canonical()
    height, width = image.shape[:2]
    y, x = np.mgrid[:height, :width]
    points = lattice.points((height, width))
    inner = points[(abs(points / (width, height) - 0.5) < 0.3).all(1)]
    middle = inner[rng.integers(len(inner))]
    away = np.stack([x, y], -1) - middle
    u, v = np.moveaxis(away @ np.linalg.inv(basis.matrix), -1, 0)
    distance = np.hypot(*np.moveaxis(away, -1, 0)) / basis.s
    spoiled = image.copy()
    if fault == "none":
        return image, middle
    if fault == "missing":
        inside = np.maximum(abs(u), abs(v)) < 0.5
        spoiled[inside] = np.median(image[np.maximum(abs(u), abs(v)) < 1.5], 0)
    elif fault == "stain":
        spoiled *= 1 - 0.35 * np.clip(4 * (0.45 - distance), 0, 1)[..., np.newaxis].astype(np.float32)
    elif fault == "hole":
        spoiled[distance < 0.35] = 0.05
    elif fault == "broken":
        spoiled[(abs(u) < 0.12) & (abs(v) < 0.5)] = image.min((0, 1))
    else:
        along = 0.3 * basis.s * basis.matrix[0] / np.hypot(*basis.matrix[0])
        course = abs(v) < 0.5
        spoiled[course] = interpolate(image, np.stack([x, y], -1)[course] + along)
    return spoiled, middle


PLANTED = ("none", "missing", "stain", "hole", "broken", "shifted row")


def study_defects(options: Options) -> None:
    """Print the share of pictures in which a planted fault is found, and in which anything else is called a defect."""
    rows, first = [], 700 if options.half == "setting" else 900
    every = [*subjects("core", []), *models([])]
    for subject in (one for one in every if one.again and one.texture.lattice):
        for number in range(first, first + options.count):
            texture = subject.again((224, 256), number)
            for fault in PLANTED:
                rng = np.random.default_rng([number, PLANTED.index(fault)])
                image, middle = plant(quantize(texture.image), texture.lattice, fault, rng)
                try:
                    found = nrbench.find_defects(image, texture.lattice)
                except nrbench.NoLatticeFound:
                    continue
                boxes = [(np.min(each.outline, 0), np.max(each.outline, 0)) for each in found]
                hits = [fault != "none" and bool(((a <= middle) & (middle <= b)).all()) for a, b in boxes]
                rows.append({"texture": subject.name, "fault": fault, "found": any(hits), "other": not all(hits)})
    table = pd.DataFrame(rows)
    tell = print_table("fault", "pictures", "found", "anything else", "not found in")
    for fault, own in table.groupby("fault", sort=False):
        missed = ", ".join(own[~own.found].texture.unique()) if fault != "none" else "-"
        tell(fault, len(own), show(own.found.mean()), f"{own.other.mean():.3f}", missed)


if __name__ == "__main__":
    halves = ("setting", "report")
    run_studies(__doc__, study_edges, study_defects, choices={"half": halves}, half="report", count=6)
