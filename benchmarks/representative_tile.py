"""Speed of representative-tile, as multiples of the machine unit u, and of its exact search beside brute force.

Run it on one thread: ``OMP_NUM_THREADS=1 python benchmarks/representative_tile.py``. The lattice is given, kernels are
warm, every figure is the median of CPU times, each over that of a unit taken right before it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from unit import cpu_unit, median_units

from nrbench.datasets_procedural.brick import Brick
from nrbench.detectors.ssdn import Ssdn, ssdn
from nrbench.imaging.convert import Image, quantize
from nrbench.jit import load_kernels
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Task
from nrbench.synthesizers.representative_tile import RepresentativeTile, continuity, resemblance

TILE = (148, 196)
"""Rows and columns of the tile of the paper's figure 7-(k), of a sample of 1200 x 600 px."""
METHODS = {
    "representative-tile": RepresentativeTile(),
    "representative-tile rated_share=0.0001": RepresentativeTile(rated_share=1e-4),
    "representative-tile rescale=false": RepresentativeTile(rescale=False),
}


def wall(height: int, width: int, brick: float, course: float) -> tuple[Image, Lattice]:
    """Return a wall whose tile, two courses of one brick, is ``brick`` x 2 ``course`` px."""
    model = Brick(width=brick, height=course, joint=course / 6, color=0.2, noise=0.03)
    texture = model.render((height, width), np.random.default_rng(0))
    assert texture.lattice is not None
    return quantize(texture.image), texture.lattice


def synthesis(method: RepresentativeTile, sample: Image, lattice: Lattice, shape: tuple[int, int]) -> object:
    """Run the method."""
    return method.synthesize(Task(sample, shape, lattice, np.random.default_rng(1)))


def brute_force(image: Image, size: tuple[int, int], places: NDArray[np.int64]) -> list[float]:
    """Return the resemblance of some tiles (rows y, x), each repeated over the image."""
    found = []
    for y, x in places.tolist():
        tile = image[y : y + size[0], x : x + size[1]]
        rows, columns = (np.arange(image.shape[0]) - y) % size[0], (np.arange(image.shape[1]) - x) % size[1]
        found.append(ssdn(tile[rows[:, np.newaxis], columns], image))
    return found


def search_table(image: Image, size: tuple[int, int]) -> None:
    """Print what rating every place costs, exactly, and by brute force as told by ten places; and how they differ."""
    height, width = image.shape[:2]
    room = (height - size[0] + 1, width - size[1] + 1)
    places = np.random.default_rng(0).integers((0, 0), room, (10, 2))
    exact = median_units(lambda: resemblance(image, size), 5)
    naive = median_units(lambda: brute_force(image, size, places), 1) / len(places) * room[0] * room[1]
    costs = resemblance(image, size)
    error = np.abs(costs[places[:, 0], places[:, 1]] - brute_force(image, size, places)).max()
    print(f"{width} x {height}, tile {size[1]} x {size[0]}: {room[0] * room[1]} places", end="")
    print(f"  exact {exact:.1f} u, continuity {median_units(lambda: continuity(image, size), 5):.1f} u,", end="")
    print(f" brute force {naive:.0f} u ({naive / exact:.0f} times), difference {error:.0e}")


def main() -> None:
    """Print the tables."""
    load_kernels()
    print(f"u = {cpu_unit() * 1e3:.2f} ms")
    sample, lattice = wall(600, 1200, 196.37, 74.11)
    print("\n1200 x 600 from 1200 x 600, tile 196 x 148")
    for name, method in METHODS.items():
        print(f"{name:38} {median_units(lambda m=method: synthesis(m, sample, lattice, (600, 1200)), 3):8.1f} u")
    print(f"{'its detection by ssdn':38} {median_units(lambda: Ssdn(primitive=False).detect(sample), 3):8.1f} u")
    print("\nthe search")
    search_table(sample, TILE)
    search_table(sample[:300, :600], (74, 98))
    small, fine = wall(128, 128, 27.3, 12.2)
    print("\nfrom 128 x 128: cost by output")
    for side in (256, 512, 1024, 2048, 4096):
        cost = median_units(lambda s=side: synthesis(RepresentativeTile(), small, fine, (s, s)), 1)
        print(f"{side:5} x {side:<5} {cost:8.1f} u   {cost / side**2 * 256**2:6.2f} u per 256 x 256")


if __name__ == "__main__":
    main()
