"""Textures of kinds that the models of ``datasets_procedural`` lack, for benchmarks of lattice detectors.

Cells with two similar halves, elements of two tints, bent textures, large elements under fine grain, photographs in
other colors, stones without a lattice, and structure of pixels: offsets of lines, enlarged pictures, and screens.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from bent_lattices import Bent
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from nrbench import plugins
from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice
from nrbench.lattice.vertices import displace_vertices

MODELS = (
    *("wallpaper", "jigsaw", "pavement", "card", "plate", "ceramic", "scales", "squares", "cans", "swirl", "mat"),
    *("pie", "toothpaste", "windows", "mosaic", "cracker", "carpet", "rug", "corduroy", "knit", "plaid", "basket"),
    *("brick", "weave", "hexagon"),
)
SPECTRA = ("white", "pink", "brown", "blobs", "grass")
SIDES = (64, 96, 128, 192, 256)
SMALL = (96, 128, 160)
"""px; sides of the images that are enlarged."""


class Case(NamedTuple):
    """An image and its lattice.

    Parameters
    ----------
    kind
        ``"model"``, or how the image differs from a model.
    family
        The model.
    image
        The pixels.
    lattice
        The smallest lattice; None if there is none.
    """

    kind: str
    family: str
    image: Image
    lattice: Lattice | None


def draw_departures(rng: np.random.Generator) -> dict[str, Any]:
    """Return random departures, from none to beyond recognition."""
    drawn: dict[str, Any] = {
        "color": rng.choice([0, 0.15, 0.3, 0.5, 0.8]),
        "noise": rng.choice([0, 0.03, 0.06, 0.1, 0.2]),
    }
    drawn["rotation"] = rng.uniform(0, 90) * (rng.random() < 0.5)
    choices = {"jitter": ([0.1, 0.2, 0.5], 0.25), "light": ([0.5], 0.25), "damage": ([0.15], 0.2)}
    drawn |= {name: rng.choice(values) for name, (values, odds) in choices.items() if rng.random() < odds}
    return {name: float(value) for name, value in drawn.items()}


def draw_models(rng: np.random.Generator, count: int) -> Iterator[Case]:
    """Yield ``count`` draws of each model, and of noise of each spectrum, which has no lattice."""
    for _ in range(count):
        for model in MODELS:
            yield _draw_model(rng, model, int(rng.choice(SIDES)))
        for spectrum in SPECTRA:
            side, scale = int(rng.choice(SIDES[1:])), float(rng.choice([5, 12, 20, 30]))
            noise = plugins.build("datasets", "noise", {"spectrum": spectrum, "scale": scale})
            yield Case("model", "noise", noise.render((side, side), rng).image, None)


def _draw_model(rng: np.random.Generator, model: str, side: int) -> Case:
    texture = plugins.build("datasets", model, draw_departures(rng)).render((side, side), rng)
    return Case("model", model, texture.image, texture.lattice)


def draw_kinds(rng: np.random.Generator, count: int) -> Iterator[Case]:
    """Yield ``count`` textures of each further kind for each of some models."""
    for _ in range(count):
        for model in MODELS:
            side = int(rng.choice(SIDES[2:]))
            bend = float(rng.choice([0.25, 0.5, 0.75]))
            yield _bend(rng, model, side, bend)
            yield _recolor(_draw_model(rng, model, side), rng)
            yield _enlarge(_draw_model(rng, model, int(rng.choice(SMALL))), rng)
        for _ in range(12):
            yield _tint(rng)
        for _ in range(6):
            yield _halve(rng)
            yield Case("stones", "stones", _draw_stones(rng), None)


def _bend(rng: np.random.Generator, model: str, side: int, bend: float) -> Case:
    """Return a model with a smooth warp. Its lattice is the one that fits the displaced vertices best."""
    departures = {**draw_departures(rng), "bend": bend, "jitter": 0.0}
    texture = plugins.build("datasets", model, departures).render((side, side), rng)
    bent = Bent(texture.image, displace_vertices(texture.lattice, texture.displacement))
    return Case("bent", model, texture.image, bent.lattice)


def _sample(image: Image, x: NDArray[np.float64], y: NDArray[np.float64]) -> Image:
    """Return the image at real-valued positions, by splines."""
    channels = [ndimage.map_coordinates(plane, [y, x], order=3, mode="mirror") for plane in np.moveaxis(image, 2, 0)]
    return np.clip(np.stack(channels, -1), 0, 1).astype(np.float32)


def _recolor(case: Case, rng: np.random.Generator) -> Case:
    """Return the image as another camera would show it: other colors, contrast and sharpness, and coding errors."""
    image = case.image
    mix = np.abs(rng.normal(size=(3, 3))) + 0.2
    image = (image if image.shape[2] == 3 else np.repeat(image, 3, 2)) @ (mix / mix.sum(0))
    image = image ** rng.uniform(0.5, 2)
    if rng.random() < 0.4:
        image = 1 - image
    if rng.random() < 0.4:
        image = image.mean(2, keepdims=True)
    image = ndimage.gaussian_filter(image, (*2 * [rng.uniform(0, 1.5)], 0))
    image = image + rng.normal(0, rng.uniform(0, 0.04), image.shape)
    return case._replace(kind="recolored", image=np.clip(image, 0, 1).astype(np.float32))


def _enlarge(case: Case, rng: np.random.Generator) -> Case:
    """Return the image enlarged, with fine grain: large elements seen from near."""
    scale, side = rng.uniform(2, 3), case.image.shape[0]
    at = np.arange(int(scale * side)) / scale
    image = _sample(case.image, *np.meshgrid(at, at))
    grain = ndimage.gaussian_filter(rng.standard_normal((*image.shape[:2], 1)), (*2 * [rng.uniform(0.4, 1.2)], 0))
    if rng.random() < 0.5:  # specks, as of stone
        grain = np.where(grain > 1.5 * grain.std(), -1.0, 0.0)
    image = image + rng.uniform(0.02, 0.15) * grain / grain.std()
    assert case.lattice is not None
    lattice = Lattice.from_basis(scale * case.lattice.matrix)
    return case._replace(kind="enlarged", image=np.clip(image, 0, 1).astype(np.float32), lattice=lattice)


def _motif(rng: np.random.Generator, shape: tuple[int, int]) -> NDArray[np.float64]:
    return np.asarray(ndimage.gaussian_filter(rng.normal(size=(*shape, 3)), (1.5, 1.5, 0), mode="wrap"))


def _halve(rng: np.random.Generator) -> Case:
    """Return a texture whose cell has two similar halves."""
    height, width = (int(n) for n in rng.integers(10, 28, 2))
    first = _motif(rng, (height, width))
    second = first + rng.uniform(0.15, 0.9) * _motif(rng, (height, width))
    bands = 0.15 * np.sin(2 * np.pi * np.arange(2 * width) / width)[:, np.newaxis] * (rng.random() < 0.5)
    cell = np.concatenate([first, second], 1) + bands
    side = int(rng.choice(SIDES[2:]))
    image = 0.5 + np.tile(cell, (side // height + 2, side // (2 * width) + 2, 1))
    y, x = np.indices((side, side))
    turn = rng.uniform(0, 0.4) * (rng.random() < 0.5)
    c, s, scale = np.cos(turn), np.sin(turn), 1.0
    rows, columns = np.mod(-s * x + c * y, scale * height), np.mod(c * x + s * y, scale * 2 * width)
    channels = [
        ndimage.map_coordinates(plane, [rows, columns], order=1, mode="wrap") for plane in np.moveaxis(image, 2, 0)
    ]
    image = np.stack(channels, -1) + rng.normal(0, rng.uniform(0, 0.1), (side, side, 1))
    lattice = Lattice((2 * width * c, 2 * width * s), (-height * s, height * c))
    return Case("halves", "halves", np.clip(image, 0, 1).astype(np.float32), lattice)


def _tint(rng: np.random.Generator) -> Case:
    """Return checks or bricks of two tints in turn, that differ by 0.03 to 0.3 of the range."""
    side, fine = int(rng.choice(SIDES[2:])), 3
    width = rng.uniform(10, 30)
    height = width * rng.uniform(0.5, 1)
    layout = rng.choice(["checks", "courses", "bricks"])
    turn = rng.uniform(0, 0.5) * (rng.random() < 0.4)
    c, s = np.cos(turn), np.sin(turn)
    y, x = np.mgrid[: side * fine, : side * fine] / fine
    v = (200 - s * x + c * y) / height
    row = np.floor(v).astype(int)
    u = (200 + c * x + s * y) / width - 0.5 * (row % 2) * (layout != "checks")
    column = np.floor(u).astype(int)
    tints = rng.normal(size=3)
    tints *= np.exp(rng.uniform(np.log(0.03), np.log(0.3))) / np.abs(tints).max()
    turns = {"checks": row + column, "courses": row, "bricks": column}[layout] % 2
    own = rng.normal(0, rng.choice([0, 0.02, 0.05, 0.1]), (row.max() + 1, column.max() + 2, 1))
    image = rng.uniform(0.3, 0.7, 3) + (turns[..., np.newaxis] - 0.5) * tints + own[row, column]
    if layout != "checks" or rng.random() < 0.4:
        image[((u - column) * width < 1.5) | ((v - row) * height < 1.5)] = rng.choice([0.1, 0.9])
    image = image.reshape(side, fine, side, fine, 3).mean((1, 3)) + rng.normal(0, rng.uniform(0, 0.05), (side, side, 1))
    cells = {"checks": [(width, height), (width, -height)], "courses": [(width, 0), (0, 2 * height)]}
    basis = np.array(cells.get(layout, [(2 * width, 0), (0, 2 * height)])) @ [[c, s], [-s, c]]
    return Case("tints", "tints", np.clip(image, 0, 1).astype(np.float32), Lattice.from_basis(basis))


def draw_pixel_kinds(rng: np.random.Generator, count: int) -> Iterator[Case]:
    """Yield ``count`` models with offsets of lines, pictures enlarged by copies of pixels, and screens of dots."""
    for _ in range(count):
        for model in MODELS:
            side = int(rng.choice(SIDES[2:]))
            yield _offset(_draw_model(rng, model, side), rng)
            small = _draw_model(rng, model, int(rng.choice(SMALL))) if rng.random() < 0.7 else None
            image = small.image if small else rng.random((int(rng.choice(SMALL)), 60, 3), np.float32)
            scale = int(rng.integers(2, 5))
            lattice = Lattice.from_basis(scale * small.lattice.matrix) if small and small.lattice else None
            yield Case("pixels", model, image.repeat(scale, 0).repeat(scale, 1), lattice)
            yield _screen(rng, int(rng.integers(1, 5)))


def _offset(case: Case, rng: np.random.Generator) -> Case:
    """Return the image with offsets of its rows or columns: scan lines, banding of light, or drift."""
    lines = np.arange(len(case.image))
    kinds = {
        "scan": rng.normal(size=len(lines)),
        "banding": 1.4 * np.sin(2 * np.pi * lines / rng.uniform(25, 100)),
        "drift": 0.2 * np.cumsum(rng.normal(size=len(lines))),
    }
    offsets = kinds[str(rng.choice(list(kinds)))] * case.image.std() * np.exp(rng.uniform(np.log(0.1), np.log(2)))
    image = case.image + (offsets[:, np.newaxis] if rng.random() < 0.5 else offsets)[..., np.newaxis]
    image = (image - image.min()) / (image.max() - image.min())
    return case._replace(kind="offsets", image=image.astype(np.float32))


def _screen(rng: np.random.Generator, count: int) -> Case:
    """Return superposed screens of dots; more than one have no single lattice."""
    y, x = np.indices((256, 256))
    image, lattice = np.ones((256, 256, 3)), None
    for ink in np.array([(0, 1, 1), (1, 0, 1), (1, 1, 0), (0, 0, 0)])[:count]:
        pitch, turn = rng.uniform(5, 12), rng.uniform(0, np.pi / 2)
        c, s = np.cos(turn) / pitch, np.sin(turn) / pitch
        waves = np.cos(2 * np.pi * (c * x + s * y)) + np.cos(2 * np.pi * (c * y - s * x))
        image *= 1 - (1 / (1 + np.exp((rng.uniform(0, 1) - waves) / 0.3)))[..., np.newaxis] * (1 - ink)
        lattice = Lattice.from_basis(np.linalg.inv([(c, s), (-s, c)]).T) if count == 1 else None
    image += rng.normal(0, 0.02, image.shape)
    return Case("screens", f"{count} screens", np.clip(image, 0, 1).astype(np.float32), lattice)


def _draw_stones(rng: np.random.Generator) -> Image:
    """Return stones of similar size in mortar, at places without any order beyond their distance."""
    side, size = int(rng.choice(SIDES[2:])), rng.uniform(8, 24)
    places = rng.uniform(-size, side + size, (6000, 2))
    taken = np.zeros(len(places), bool)
    for number, place in enumerate(places):
        taken[number] = (
            not (np.abs(places[:number][taken[:number]] - place) ** 2).sum(1).min(initial=np.inf) < (0.8 * size) ** 2
        )
    places = places[taken]
    y, x = np.indices((side, side))
    distances, nearest = cKDTree(places).query(np.stack([x, y], -1), 2)
    joint = np.clip((distances[..., 1] - distances[..., 0]) / 3, 0, 1)[..., np.newaxis]
    stone = 0.5 + rng.uniform(0.02, 0.12) * rng.normal(size=(len(places), 3))
    image = 0.3 + joint * (stone[nearest[..., 0]] - 0.3) + rng.normal(0, 0.03, (side, side, 1))
    return np.clip(image, 0, 1).astype(np.float32)
