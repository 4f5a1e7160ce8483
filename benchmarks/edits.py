"""Edits of a picture by dose: those that nobody sees side by side, and those that everybody sees."""

import io
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow
from PIL import ImageDraw
from scipy.ndimage import gaussian_filter, map_coordinates

from nrbench.imaging.convert import Image, quantize

Plane = NDArray[np.float64]
LUMA = np.array([0.299, 0.587, 0.114])
LEVEL = 1 / 255


@dataclass(frozen=True)
class Scene:
    """A color picture of known lattice, and the random stream of its edit.

    Parameters
    ----------
    picture
        ``(H, W, 3)`` in [0, 1].
    vectors
        ``(2, 2)``: reduced generating vectors (x, y) px.
    rng
        The stream.
    """

    picture: Image
    vectors: Plane
    rng: np.random.Generator

    @property
    def places(self) -> tuple[Plane, Plane]:
        """(y, x) of all pixels, px."""
        y, x = np.mgrid[: self.picture.shape[0], : self.picture.shape[1]].astype(float)
        return y, x

    @property
    def mean(self) -> Plane:
        """(3,): mean color."""
        return np.asarray(self.picture.mean((0, 1)))

    def noise(self, *channels: int) -> Plane:
        """White noise of unit variance."""
        return self.rng.standard_normal((*self.picture.shape[:2], *channels))

    def hole(self, size: float) -> tuple[slice, slice]:
        """Return a box of ``size`` x ``size`` cells, at a third of the picture."""
        height, width = self.picture.shape[:2]
        wide, high = np.maximum(16, np.rint(size * np.linalg.norm(self.vectors, axis=0))).astype(int)
        return np.s_[height // 3 : height // 3 + high, width // 3 : width // 3 + wide]

    def resample(self, matrix: Plane, order: int = 3) -> Plane:
        """Map the picture linearly about its middle."""
        y, x = self.places
        middle = np.array([x.max() / 2, y.max() / 2])
        at = (np.stack([x, y], -1) - middle) @ np.linalg.inv(matrix).T + middle
        return self.sample(at[..., 1], at[..., 0], order)

    def sample(self, y: Plane, x: Plane, order: int) -> Plane:
        """Return the picture at places (y, x) px."""
        planes = np.moveaxis(self.picture, -1, 0)
        return np.stack([map_coordinates(plane, [y, x], order=order, mode="mirror") for plane in planes], -1)


def compress(scene: Scene, quality: float, subsampling: int = 2) -> Plane:
    """Write and read the picture as JPEG; its colors at half the resolution, unless ``subsampling`` is 0."""
    file = io.BytesIO()
    pixels = np.rint(scene.picture * 255).astype(np.uint8)
    Pillow.fromarray(pixels).save(file, "JPEG", quality=int(quality), subsampling=subsampling)
    return np.asarray(Pillow.open(file)) / 255


def add_chroma(scene: Scene, levels: float) -> Plane:
    """Add smooth noise to the colors, of ``levels`` of 255."""
    noise = gaussian_filter(scene.noise(3), (2, 2, 0))
    noise -= (noise @ LUMA)[..., np.newaxis]
    return np.asarray(scene.picture + levels * LEVEL * noise / noise.std())


def blur(scene: Scene, sigma: float) -> Plane:
    """Blur by a Gaussian of ``sigma`` px."""
    return np.asarray(gaussian_filter(scene.picture, (sigma, sigma, 0)), np.float64)


def turn(scene: Scene, degrees: float) -> Plane:
    """Turn about the middle."""
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return scene.resample(np.array([[cosine, -sine], [sine, cosine]]))


def light(scene: Scene, levels: float) -> Plane:
    """Add a ramp of light from left to right, of ``levels`` of 255 in all."""
    _, x = scene.places
    return np.asarray(scene.picture + (levels * LEVEL * (x / x.max() - 0.5))[..., np.newaxis])


def shade_border(scene: Scene, share: float) -> Plane:
    """Darken the corners by a share."""
    y, x = scene.places
    radius = np.hypot(x / x.max() - 0.5, y / y.max() - 0.5) * np.sqrt(2)
    return np.asarray(scene.picture * (1 - share * radius**2)[..., np.newaxis])


def stretch_contrast(scene: Scene, factor: float) -> Plane:
    """Multiply the departures from the mean color."""
    return scene.mean + factor * (scene.picture - scene.mean)


def fill_hole(scene: Scene, size: float, content: Callable[[Scene], Plane]) -> Plane:
    """Put other content into a box of ``size`` x ``size`` cells."""
    box, edited = scene.hole(size), np.array(scene.picture, float)
    edited[box] = content(scene)[box]
    return edited


def write_text(scene: Scene, share: float) -> Plane:
    """Write white letters whose height is a share of the picture's."""
    height, width = scene.picture.shape[:2]
    canvas = Pillow.fromarray(np.rint(scene.picture * 255).astype(np.uint8))
    text = "SAMPLE TEXT 2004"
    ImageDraw.Draw(canvas).text((width // 6, height // 2), text, fill=(255, 255, 255), font_size=share * height)
    return np.asarray(canvas) / 255


def slip(scene: Scene, axis: int, distance: int) -> Plane:
    """Move one half of the picture along the cut between both; the picture loses ``distance`` px along it."""
    turned = np.swapaxes(scene.picture, 0, axis)
    half, side = len(turned) // 2, turned.shape[1] - distance
    return np.swapaxes(np.concatenate([turned[:half, :side], turned[half:, distance:]]), 0, axis)


def sort_cells(scene: Scene, key: Callable[[Plane], Plane]) -> Plane:
    """Lay the whole cells anew: the darkest ones where ``key`` of the cell's coordinates is least."""
    y, x = scene.places
    cell = np.stack([x, y], -1) @ np.linalg.inv(scene.vectors)
    number = np.floor(cell).astype(int)
    corners = np.array([(0, 0), (0, 1), (1, 0), (1, 1)])
    names = np.unique(number.reshape(-1, 2), axis=0)
    ends = (names[:, np.newaxis] + corners) @ scene.vectors
    names = names[((ends >= 0) & (ends <= (x.max(), y.max()))).all((1, 2))]
    tones = [scene.picture[(number == name).all(-1)].mean() for name in names]
    moved = np.zeros_like(cell)
    for target, source in zip(names[np.argsort(key(names), kind="stable")], names[np.argsort(tones)], strict=True):
        moved[(number == target).all(-1)] = source - target
    at = (cell + moved) @ scene.vectors
    return scene.sample(at[..., 1], at[..., 0], 1)


def _flat(scene: Scene) -> Plane:
    return np.broadcast_to(scene.mean, scene.picture.shape)


def _halves(scene: Scene, dark: float, bright: float, step: float = 0.0) -> Plane:
    """Multiply, or add a step to, the upper and the lower half."""
    upper = (np.arange(len(scene.picture)) < len(scene.picture) / 2)[:, np.newaxis, np.newaxis]
    return np.where(upper, scene.picture * bright + step / 2, scene.picture * dark - step / 2)


def shortest(scene: Scene) -> float:
    """Return the length of the shorter generating vector, px."""
    return float(np.linalg.norm(scene.vectors, axis=1).min())


Edit = Callable[[Scene, float], Plane]
EDITS: Mapping[str, tuple[Edit, tuple[float, ...], tuple[float, ...]]] = {
    "JPEG 4:2:0, quality": (compress, (92, 85), (6,)),
    "JPEG 4:4:4, quality": (lambda f, dose: compress(f, dose, 0), (85,), ()),
    "gray grain, levels": (lambda f, dose: f.picture + dose * LEVEL * f.noise(1), (4,), (25,)),
    "colored grain, levels": (lambda f, dose: f.picture + dose * LEVEL * f.noise(3), (2,), (25,)),
    "smooth chroma, levels": (add_chroma, (2,), (20,)),
    "shift, bilinear, px": (lambda f, dose: f.sample(f.places[0], f.places[1] + dose, 1), (0.5,), ()),
    "shift, cubic, px": (lambda f, dose: f.sample(f.places[0], f.places[1] + dose, 3), (0.5,), ()),
    "blur, px": (blur, (0.6,), (2,)),
    "sharpened, share": (lambda f, dose: f.picture + dose * (f.picture - blur(f, 1)), (0.3,), (3,)),
    "turned, degrees": (turn, (0.25, 0.5), (5,)),
    "larger, share": (lambda f, dose: f.resample((1 + dose) * np.eye(2)), (0.01,), (0.1,)),
    "brighter, levels": (lambda f, dose: f.picture + dose * LEVEL, (2,), (30,)),
    "warmer, levels": (lambda f, dose: f.picture + dose * LEVEL * np.array([1, 0, -1]), (2,), (20,)),
    "gamma": (lambda f, dose: f.picture**dose, (1.03,), (1.6,)),
    "contrast": (stretch_contrast, (0.96, 1.04), (0.6, 1.5)),
    "ramp of light, levels": (light, (4,), (60,)),
    "dark corners, share": (shade_border, (0.02,), (0.45,)),
    "tones, number": (lambda f, dose: np.round(f.picture * (dose - 1)) / (dose - 1), (128,), (5,)),
    "green, share": (lambda f, dose: f.picture * (1 + dose * np.array([-1, 0.7, -1])), (), (0.15,)),
    "gray instead of color": (lambda f, _: np.repeat((f.picture @ LUMA)[..., np.newaxis], 3, 2), (), (1,)),
    "red and blue swapped": (lambda f, _: f.picture[..., ::-1], (), (1,)),
    "departures of channels rotated": (lambda f, _: f.mean + (f.picture - f.mean)[..., [2, 0, 1]], (), (1,)),
    "negative": (lambda f, _: 1 - f.picture, (), (1,)),
    "hole of noise, cells": (lambda f, dose: fill_hole(f, dose, lambda g: g.rng.random(g.picture.shape)), (), (2,)),
    "flat hole, cells": (lambda f, dose: fill_hole(f, dose, _flat), (), (2,)),
    "blurred hole, cells": (lambda f, dose: fill_hole(f, dose, lambda g: blur(g, 6)), (), (2,)),
    "step of light": (lambda f, dose: _halves(f, 1, 1, dose), (), (0.16,)),
    "dark half, share": (lambda f, dose: _halves(f, 1 - dose, 1), (), (0.3,)),
    "text, share of the height": (write_text, (), (0.11,)),
    "half slipped along rows, s": (lambda f, dose: slip(f, 0, round(dose * shortest(f))), (), (0.3,)),
    "half slipped along columns, s": (lambda f, dose: slip(f, 1, round(dose * shortest(f))), (), (0.3,)),
    "cells sorted by tone": (lambda f, _: sort_cells(f, lambda n: n[:, 0]), (), (1,)),
    "cells as a checkerboard": (lambda f, _: sort_cells(f, lambda n: n.sum(1) % 2), (), (1,)),
    "cells as a blob": (lambda f, _: sort_cells(f, lambda n: ((n - n.mean(0)) ** 2).sum(1)), (), (1,)),
}
"""Each edit with the doses that nobody sees and those that everybody sees."""


def apply_edit(name: str, dose: float, picture: Image, vectors: Plane, rng: np.random.Generator) -> Image:
    """Return a picture with an edit, rounded to 8 bits."""
    edited = EDITS[name][0](Scene(picture, vectors, rng), dose)
    return quantize(np.ascontiguousarray(edited.clip(0, 1), np.float32))


def edit_picture(picture: Image, vectors: Plane, seen: bool) -> Iterator[tuple[str, float, Image]]:
    """Yield name, dose and picture of all edits that are seen, or of all that are not."""
    for name, (_, unseen_doses, seen_doses) in EDITS.items():
        for dose in seen_doses if seen else unseen_doses:
            rng = np.random.default_rng(zlib.crc32(f"{name} {dose}".encode()))
            yield name, dose, apply_edit(name, dose, picture, vectors, rng)
