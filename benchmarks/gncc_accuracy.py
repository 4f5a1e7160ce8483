"""How often gncc finds the smallest lattice, how precisely and how fast; and how often it finds one where none is.

Run it on one thread: ``OMP_NUM_THREADS=1 python benchmarks/gncc_accuracy.py``. Lattices: three families, axis-aligned
and rotated, 10 seeds each, 128 x 128. No lattice: noise of several correlation lengths, and gratings in noise.
"""

from __future__ import annotations

import itertools
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import gaussian_filter
from unit import machine_unit

from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.datasets_procedural.weave import Weave
from nrbench.detectors.gncc import Gncc
from nrbench.imaging.convert import Image, quantize
from nrbench.jit import load_kernels
from nrbench.lattice.comparison import lattice_error
from nrbench.plugins.forms import NoLatticeFound, Texture

SIDE = 128
SEEDS = range(10)
DETECTORS = {
    "surrogate": Gncc(),
    "none": Gncc(reject="none"),
    "paper": Gncc(reject="none", subpixel=False, tolerance=0, prominence=0),
}
FAMILIES = {"brick": (Brick, 17.3), "weave": (Weave, 31.7), "hexagon": (Hexagon, 11.9)}


@dataclass
class Tally:
    """What one detector made of several textures."""

    labels: Counter[str] = field(default_factory=Counter)
    errors: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)

    def add(self, detector: Gncc, texture: Texture) -> None:
        """Let the detector look at a texture."""
        image, start = quantize(texture.image), time.perf_counter()
        try:
            lattice = detector.detect(image).lattice
        except NoLatticeFound:
            lattice = None
        self.seconds.append(time.perf_counter() - start)
        if lattice is None or texture.lattice is None:
            self.labels["none" if lattice is None else "found"] += 1
            return
        error = lattice_error(lattice, texture.lattice, image.shape[:2])
        self.labels[error.label] += 1
        self.errors += [error.vector] if error.relation == "exact" else []

    def row(self, u: float) -> str:
        """Return the tally in words."""
        total, exact = self.labels.total(), self.labels["exact"]
        rest = ", ".join(f"{label} {n}" for label, n in self.labels.most_common() if label != "exact")
        precision = f"error {np.median(self.errors):.3f} px" if self.errors else ""
        return f"exact {exact:3}/{total:<3} {precision:15} {np.median(self.seconds) / u:7.1f} u   {rest}"


def textures(family: str, color: float, noise: float) -> Iterator[Texture]:
    """Yield the family's textures, axis-aligned and rotated."""
    kind, rotation = FAMILIES[family]
    for turn, seed in itertools.product((0.0, rotation), SEEDS):
        model: Model = kind(color=color, noise=noise, rotation=turn)
        yield model.render((SIDE, SIDE), np.random.default_rng(seed))


def noises(sigma: float) -> Iterator[Texture]:
    """Yield smoothed noise, channels correlated."""
    for seed in range(40):
        rng = np.random.default_rng(seed)
        wide = SIDE + int(8 * sigma)
        fields = gaussian_filter(rng.standard_normal((wide, wide, 2)), (sigma, sigma, 0))[-SIDE:, -SIDE:]
        yield Texture(_visible(fields @ rng.uniform(-1, 1, (2, 3))))


def gratings(noise: float) -> Iterator[Texture]:
    """Yield stripes of any direction in noise of a given strength, relative to the stripes."""
    y, x = np.indices((SIDE, SIDE))
    for seed in range(40):
        rng = np.random.default_rng(seed)
        angle, period = rng.uniform(0, np.pi), rng.uniform(8, 30)
        stripes = np.tanh(4 * np.sin(2 * np.pi * (x * np.cos(angle) + y * np.sin(angle)) / period))
        grain = gaussian_filter(rng.standard_normal((SIDE, SIDE)), 1)
        yield Texture(_visible((stripes + noise * grain / grain.std())[..., np.newaxis] * [1.0, 0.8, 0.5]))


def _visible(values: np.ndarray) -> Image:
    values = values - values.mean((0, 1))
    return np.clip(0.5 + 0.15 * values / values.std(), 0, 1).astype(np.float32)


def main() -> None:
    """Print the tables."""
    load_kernels()
    u = machine_unit()
    print(f"u = {u * 1e3:.2f} ms")
    for name, detector in DETECTORS.items():
        print(f"\n{name}: {detector}")
        for family, color, noise in itertools.product(FAMILIES, (0.1, 0.3), (0.02, 0.1)):
            tally = Tally()
            for texture in textures(family, color, noise):
                tally.add(detector, texture)
            print(f"{family:8} color {color} noise {noise:<5} {tally.row(u)}")
    print("\nno lattice (reject=surrogate)")
    for make, strength in [(noises, 0.0), (noises, 1.0), (noises, 3.0), (gratings, 0.3), (gratings, 1.5)]:
        tally = Tally()
        for texture in make(strength):
            tally.add(Gncc(), texture)
        print(f"{make.__name__:9} {strength:<5} found {tally.labels['found']:2}/{tally.labels.total()}")


if __name__ == "__main__":
    main()
