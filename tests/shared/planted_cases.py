"""Textures, and planted defects in their fresh draws."""

from collections.abc import Mapping

import numpy as np

from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.datasets_procedural.weave import Weave
from nrbench.imaging.convert import Image
from nrbench.plugins.forms import Again, Shape, Synthesis, Task, Texture
from nrbench.streams import stream
from nrbench.synthesizers.planted import Planted

MODELS: Mapping[str, Model] = {
    "brick": Brick(color=0.2, noise=0.02),
    "weave": Weave(rotation=20.0, color=0.2),
    "hexagon": Hexagon(period=23.3, color=0.2, noise=0.02),
    "plain": Brick(width=30, height=12, phase=(0.2, 0.3)),
}
TEXTURES = {name: model.render((128, 128), np.random.default_rng(0)) for name, model in MODELS.items()}
TEXTURE = TEXTURES["brick"]
S = TEXTURE.lattice.s
NEEDS_NO_LATTICE = ("none", "stretch", "blurred-band", "blur", "contrast", "seam", "color-mean")
LARGEST = {
    **dict.fromkeys(("phase-step", "displaced-tile", "off-lattice", "doubled-tile", "slipped-course", "warp"), 0.5),
    **dict.fromkeys(("dropped-row", "doubled-row", "verbatim"), 0.5),
    **{"stretch": 0.02, "blurred-band": 0.6, "color-mean": 0.4},
}


class Draws:
    """Fresh draws of a texture, which are kept."""

    def __init__(self, name: str = "brick") -> None:
        self.model, self.texture = MODELS[name], TEXTURES[name]

    def __call__(self, shape: Shape, k: int) -> Texture | None:
        """Return the k-th draw."""
        drawn = self.model.again(self.texture, shape, stream("again", k))
        self.seen = (*getattr(self, "seen", ()), drawn.image)
        return drawn

    def fresh(self, shape: Shape, draw: int = -1) -> Image:
        """Return the output without its defect: the middle of a draw."""
        image = self.seen[draw]
        margin = (image.shape[0] - shape[0]) // 2
        return image[margin : margin + shape[0], margin : margin + shape[1]]


draws = Draws()


def plant(kind: str, size: float, seed: int = 0, again: Again | None = draws, shape: Shape = (150, 180)) -> Synthesis:
    """Run the method."""
    return Planted(kind, size).synthesize(Task(TEXTURE.image, shape, None, np.random.default_rng(seed), again=again))


Case = tuple[Image, np.ndarray, np.ndarray, Image, Draws]


def planted(kind: str, size: float, name: str = "brick", shape: Shape = (150, 180), seed: int = 0) -> Case:
    """Return image, displacement, mask, the draw without its defect, and all draws."""
    again = Draws(name)
    made = plant(kind, size, seed, again, shape)
    fresh = again.fresh(shape, -2 if kind in ("two-tone", "torn") else -1)
    return made.image, made.extras["displacement"], made.extras["covered"] > 0, fresh, again
