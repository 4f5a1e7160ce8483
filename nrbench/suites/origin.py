"""Where a row's samples come from: its dataset, or for a picture that a model rendered, that model."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from nrbench import plugins
from nrbench.plugins.forms import Texture
from nrbench.streams import pixels_hash
from nrbench.suites.cell import Recipe
from nrbench.suites.suite import Suite, TextureRow


@dataclass(frozen=True)
class Origin:
    """How the samples of a row are drawn.

    Parameters
    ----------
    first
        The recipe of replicate 0.
    known
        What was drawn to find that out, with the recipe that draws it again: nothing is drawn twice.
    """

    first: Recipe
    known: tuple[Recipe, Texture] | None = None

    @classmethod
    def of(cls, suite: Suite, row: TextureRow) -> Origin:
        """Return the origin of a row's samples.

        A picture with a recipe is drawn by it where that gives the picture's pixels and the lattice that is told of it.

        Raises
        ------
        BadInput
            For a dataset or parameters that are not known or not valid.
        """
        plugin = plugins.build("datasets", row.dataset, row.parameters)
        shape = row.sample or suite.sample
        own = Recipe(row.dataset, plugins.parameters_of(plugin), suite.seed, row.name, 0, shape)
        if row.recipe is None:
            return cls(own)
        then = Recipe(**{item.name: getattr(row.recipe, item.name) for item in dataclasses.fields(Recipe)})
        try:
            then = dataclasses.replace(then, parameters=plugins.parameters_of(then.plugin()))
            whole = dataclasses.replace(own, shape=then.shape)
            model, picture = then.render(), whole.render()
            same = pixels_hash(model.image) == pixels_hash(picture.image) and _as_told(model, picture)
        except Exception:  # of another version, or of a plugin that is not installed here: a picture like any other
            return cls(own)
        if same:
            return cls(dataclasses.replace(then, shape=shape), (then, model))
        return cls(own, (whole, picture))

    def recipe(self, replicate: int) -> Recipe:
        """Return how a replicate is drawn."""
        return dataclasses.replace(self.first, replicate=self.first.replicate + replicate)

    def render(self, recipe: Recipe) -> Texture:
        """Draw a texture, unless it is the one that was drawn already."""
        return self.known[1] if self.known and self.known[0] == recipe else recipe.render()


def _as_told(texture: Texture, picture: Texture) -> bool:
    """Return whether the lattice told of a picture, if any, is the texture's own: vectors and origin to 1e-9 px."""
    own, told = texture.lattice, picture.lattice
    if own is None or told is None:
        return told is None
    pairs = ((own.t1, told.t1), (own.t2, told.t2), (own.origin, told.origin))
    return all(np.allclose(*pair, rtol=0, atol=1e-9) for pair in pairs)
