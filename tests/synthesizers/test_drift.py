"""Claims about large outputs: on a lattice with fractional vectors nothing drifts."""

import numpy as np
import pytest
from cases import Case

from nrbench.datasets_procedural.brick import Brick
from nrbench.imaging.convert import quantize
from nrbench.lattice.geometry import Lattice
from nrbench.metrics.judgment.examination import examine
from nrbench.plugins.forms import Synthesizer, Task
from nrbench.synthesizers.representative_tile import RepresentativeTile
from nrbench.synthesizers.rsgf import Rsgf
from nrbench.synthesizers.tile_set import TileSet
from nrbench.synthesizers.tiling import Tiling

OWN = Case.of(Brick(width=21.37, height=18.81, bond="stack", rotation=7.0, color=0.2, noise=0.03))
SIDE = 400


def worst_misplacement(method: Synthesizer, lattice: Lattice | None = None) -> float:
    """Return the largest misplacement of any window of an output, over s, measured with the model's truth."""
    task = Task(OWN.texture.image, (SIDE, SIDE), lattice or OWN.lattice, np.random.default_rng(1))
    followed = examine(OWN.observe(quantize(method.synthesize(task).image))).followed
    near = followed.displacement - followed.expected
    moved = ((followed.expected + near - np.rint(near)) @ followed.net.vectors)[followed.valid]
    return float(np.linalg.norm(moved - np.median(moved, 0), axis=1).max() / followed.net.s)


@pytest.mark.parametrize("method", [Rsgf(), Rsgf(seam="blend"), TileSet(), RepresentativeTile(), Tiling()])
def test_on_a_fractional_lattice_every_window_is_in_place(method: Synthesizer) -> None:
    """With the lattice given every window lies within a twentieth of s of the truth."""
    assert worst_misplacement(method) < 0.05


def test_whole_pixel_vectors_would_drift() -> None:
    """The lattice rounded to whole pixels, as in the paper, leaves windows out of place by more than a tenth of s."""
    whole = Lattice(*(tuple(float(round(value)) for value in vector) for vector in OWN.lattice.reduced().matrix))
    assert worst_misplacement(Rsgf(seam="blend", subpixel=False), whole) > 0.1
