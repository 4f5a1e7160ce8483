"""How often each detector finds the smallest lattice, how precisely and fast, and how often one where none is.

Run it on one thread: ``OMP_NUM_THREADS=1 python benchmarks/detector_accuracy.py [--count 8] [DETECTOR...]``.
``--first`` is the first seed. ``--blur 1`` blurs the textures with a lattice by a Gaussian of 1 px; ``--stochastic 0``
leaves out the others.
Brick, weave and hexagon, axis-aligned and rotated, 128 to 256 px a side with at least 4 periods, by regular share; and
200 stochastic textures: noise of five spectra, crops of scikit-image's grass and gravel, and stripes in noise.
"""

import itertools
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import skimage.data
from scipy.ndimage import gaussian_filter
from studies import read_options
from unit import cpu_unit

from nrbench import plugins
from nrbench.imaging.convert import Image, as_image, quantize
from nrbench.jit import load_kernels
from nrbench.lattice.geometry import Lattice
from nrbench.lattice.relation import lattice_error
from nrbench.plugins.forms import Detector, NoLatticeFound, Texture
from nrbench.plugins.parameters import parse_spec

DETECTORS = [
    "consensus",
    "gncc",
    "gncc:reject=none",
    "gncc:preset=paper",
    "ssdn",
    "frdft:reject=none",
    "dominance",
    "dominance:reject=none",
]
FAMILIES = {"brick": 17.3, "weave": 31.7, "hexagon": 11.9}
SIDES = (128, 160, 192, 256)
STRENGTHS = ((0.1, 0.02), (0.14, 0.04), (0.3, 0.05), (0.4, 0.08), (0.5, 0.1), (0.6, 0.1), (0.7, 0.1))
SPECTRA = ("white", "pink", "brown", "blobs", "grass")
CLASSES = {"mild": (0.9, 1.01), "middle": (0.6, 0.9), "strong": (0.3, 0.6)}


@dataclass
class Tally:
    """What a detector made of some textures."""

    labels: list[str] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)

    def add(self, detector: Detector, image: Image, truth: Lattice | None) -> None:
        """Let the detector look at an image."""
        start = time.process_time()
        try:
            found = detector.detect(image).lattice
        except NoLatticeFound:
            found = None
        self.seconds.append(time.process_time() - start)
        if found is None or truth is None:
            self.labels.append("none" if found is None else "found")
            return
        error = lattice_error(found, truth, image.shape[:2])
        self.labels.append(error.label)
        self.errors += [error.vector] if error.relation == "exact" else []

    def row(self, unit: float) -> str:
        """Return the tally in words."""
        exact, n = self.labels.count("exact"), len(self.labels)
        others = sorted({label for label in self.labels if label != "exact"})
        rest = ", ".join(f"{label} {self.labels.count(label)}" for label in others)
        error = f"error {np.median(self.errors):.3f} px" if self.errors else ""
        return f"exact {exact:3}/{n:<3} {error:15} {np.median(self.seconds) / unit:7.1f} w   {rest}"


def regular(first: int, count: int) -> Iterator[tuple[str, Texture]]:
    """Yield textures with a lattice, and the class of their regular share."""
    for (family, turn), (color, noise) in itertools.product(FAMILIES.items(), STRENGTHS):
        for seed, rotation in itertools.product(range(first, first + count), (0.0, turn)):
            parameters = {"color": color, "intensity": color / 2, "noise": noise, "rotation": rotation}
            side = SIDES[seed % len(SIDES)]
            drawn = plugins.build("datasets", family, parameters).render((side, side), np.random.default_rng(seed))
            share = drawn.regular_share or 0.0
            kind = next((kind for kind, (low, high) in CLASSES.items() if low <= share < high), None)
            if kind is not None:
                yield f"{family} {kind}", drawn


def stochastic(count: int) -> Iterator[tuple[str, Image]]:
    """Yield ``count`` textures without a lattice."""
    rng = np.random.default_rng(9000)
    pictures = {name: as_image(getattr(skimage.data, name)()) for name in ("grass", "gravel")}
    kinds = [*SPECTRA, *pictures]
    for number in range(count):
        kind, side = kinds[number % len(kinds)], SIDES[number // len(kinds) % len(SIDES)]
        if kind in pictures and number % 2:
            whole = pictures[kind]
            y, x = (int(rng.integers(0, n - side)) for n in whole.shape[:2])
            yield f"crops of {kind}", whole[y : y + side, x : x + side]
        else:
            spectrum = kind if kind in SPECTRA else "blobs"
            scale = float(rng.choice([5, 12, 20]))
            noise = plugins.build("datasets", "noise", {"spectrum": spectrum, "scale": scale})
            yield "noise", noise.render((side, side), rng).image


def gratings(count: int) -> Iterator[tuple[str, Image]]:
    """Yield stripes of any direction in noise: they have one period, and no lattice."""
    y, x = np.indices((128, 128))
    for seed, noise in itertools.product(range(count), (0.3, 1.5)):
        rng = np.random.default_rng(seed)
        angle, period = rng.uniform(0, np.pi), rng.uniform(8, 30)
        stripes = np.tanh(4 * np.sin(2 * np.pi * (x * np.cos(angle) + y * np.sin(angle)) / period))
        grain = gaussian_filter(rng.standard_normal((128, 128)), 1)
        values = (stripes + noise * grain / grain.std())[..., np.newaxis] * [1.0, 0.8, 0.5]
        values -= values.mean((0, 1))
        yield f"gratings {noise:g}", np.clip(0.5 + 0.15 * values / values.std(), 0, 1).astype(np.float32)


def main() -> None:
    """Print one table for each detector."""
    options = read_options(__doc__, ["detectors"], detectors=DETECTORS, count=8, first=8000, stochastic=200, blur=0.0)
    load_kernels()
    unit = cpu_unit()
    for spec in options.detectors:
        detector = plugins.build("detectors", *parse_spec(spec))
        tallies: dict[str, Tally] = defaultdict(Tally)
        for kind, texture in regular(options.first, options.count):
            image = gaussian_filter(texture.image, (options.blur, options.blur, 0), mode="nearest")
            tallies[kind].add(detector, quantize(image), texture.lattice)
        for kind, image in itertools.chain(stochastic(options.stochastic), gratings(options.stochastic // 10)):
            tallies[kind].add(detector, quantize(image), None)
        print(spec)
        for kind, tally in tallies.items():
            print(f"  {kind:16} {tally.row(unit)}", flush=True)


if __name__ == "__main__":
    main()
