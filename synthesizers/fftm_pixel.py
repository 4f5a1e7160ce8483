"""Pixel-based synthesis guided by a fractional Fourier texture mask."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from nrbench.errors import BadInput
from nrbench.imaging.door import Image, to_bytes
from nrbench.imaging.harmonics import Harmonic, Signal
from nrbench.lattice.frdft import Frdft
from nrbench.synthesis import Refused, Synthesis, Task

from .fftm_mask import Analysis, TextureMask
from .mask_clusters import Clusters
from .mask_period import tileable_mask
from .neighborhoods import Integers, Layers, Neighborhood
from .pixel_growth import Growth, Rules, Search, Stock, stock_of

Match = Literal["full", "cluster"]


@dataclass(frozen=True)
class FftmPixel:
    """TODO."""

    neighborhood: int = 3
    weight: float = 1.0
    match: Match = "full"
    search: Search = "ann"
    coherence: float | None = 1.5
    eps: float = 1.0
    dimensions: int = 16
    similar: int = 4
    clusters: int = 64
    tileable: bool = False
    threshold: float = 0.0
    harmonics: Harmonic = "tied"
    signal: Signal = "real"

    reference: ClassVar[bool] = False
    uses_lattice: ClassVar[bool] = True
    needs_lattice: ClassVar[bool] = False
    version: ClassVar[str] = "1"
    paper: ClassVar[str] = Frdft.paper

    def synthesize(self, task: Task) -> Synthesis:
        start = time.perf_counter()
        mask = Analysis(self.threshold, self.harmonics, self.signal).of(task.sample)
        seconds = time.perf_counter() - start
        return self.guided(task, mask, seconds)

    @property
    def rules(self) -> Rules:
        return Rules(self.search, self.eps, self.similar, self.dimensions, self.coherence or 0.0)

    def guided(self, task: Task, mask: TextureMask, seconds: float = 0.0) -> Synthesis:
        return _Guided(self, task, mask).synthesis(seconds)


class _Guided:
    """One synthesis."""

    def __init__(self, method: FftmPixel, task: Task, mask: TextureMask) -> None:
        self.method, self.task, self.mask = method, task, mask
        size = method.neighborhood
        left, top, right, bottom = Neighborhood.of_mask(size).box
        height, width = task.shape
        fitted = tileable_mask(mask, task.shape) if method.tileable else mask
        drawn = fitted.picture((height + top + bottom, width + left + right), (-left, -top))
        self.picture = drawn[top : top + height, left : left + width]
        self.sample = _layers(task.sample, mask.picture(task.sample.shape[:2]))
        self.growth = Growth(task, _layers(drawn, drawn), (top, left), method.tileable)
        self.pixels = Neighborhood.of_mask(size).complete(task.sample.shape[:2])
        if not len(self.pixels):
            raise Refused("")
        self.ranks = task.rng.permutation(len(self.pixels))
        self.clusters = None
        if method.match == "cluster":
            whole = Neighborhood.of_mask(size)
            self.clusters = Clusters.of(self.sample, whole, self.pixels, method.clusters, task.rng)

    def synthesis(self, seconds: float) -> Synthesis:
        height, width = self.task.shape
        size, masked = self.method.neighborhood, self.clusters is None
        groups = None
        if self.clusters is not None:
            groups = self.clusters.of_output(self.growth.layers, self.task.shape, self.growth.corner)
        stock = self._stock(Neighborhood.growing(size, masked))
        self.growth.grow(stock, self.method.rules, range(height), range(width), groups)
        if self.method.tileable:
            stock = self._stock(Neighborhood.closing(size, masked))
            edge = size // 2
            self.growth.grow(stock, self.method.rules, range(min(edge, height)), range(width), groups, 0)
            self.growth.grow(stock, self.method.rules, range(edge, height), range(min(edge, width)), groups, 0)
        image, source = self.growth.finished()
        return Synthesis(image, self.mask.lattice, source, {"mask": self.picture}, seconds)

    def _stock(self, neighborhood: Neighborhood) -> Stock:
        labels = None if self.clusters is None else self.clusters.labels
        method = self.method
        return stock_of(self.sample, neighborhood, method.rules, method.weight, self.pixels, self.ranks, labels)


def _layers(texture: Image, mask: Image) -> Layers:
    return np.stack([to_bytes(texture), to_bytes(mask)])
