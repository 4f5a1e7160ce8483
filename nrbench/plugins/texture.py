"""A texture: an image with what is known of its lattice and its departures from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice

Kind = Literal["0", "I", "II", "III", "stochastic"]
Shape = tuple[int, int]
"""(height, width) in px."""
Region = tuple[int, int, int, int]
"""(x0, y0, x1, y1) in px of the picture that a crop was cut from, half-open."""


@dataclass(frozen=True)
class Texture:
    """An image, and the truth about it.

    Parameters
    ----------
    image
        The pixels, :data:`~nrbench.imaging.convert.Image`.
    lattice
        The smallest lattice of the ideal image, origin included; None where there is none or it is not known.
    lattices
        All lattices, where a texture has several (``lattice`` first).
    name, family
        For tables: the suite's row, and the group of rows it belongs to.
    kind
        ``"0"`` perfectly regular, ``"I"`` regular geometry with varying color, ``"II"`` varying geometry with regular
        color, ``"III"`` both vary, ``"stochastic"`` no lattice; None where it is not known (photographs).
    ideal
        The periodic image, shape of ``image``: the mean over the model's draws at this lattice and phase, of undamaged
        elements in their places; None unless the model is known.
    displacement
        ``float32 (H, W, 2)``: how far, (x, y) px, the content at each pixel has moved
        from its ideal place; None: not at all.
    elements
        Departures of each element (brick, thread, tile) by name, one array each whose first axis counts elements.
    regular_share
        Variance of the mean over draws (the ideal image, but for damage and displacements) over mean total variance,
        in [0, 1]; None where it is not known.
    region
        Where a photograph's crop was cut; None for models.
    """

    image: Image
    lattice: Lattice | None = None
    lattices: tuple[Lattice, ...] = ()
    name: str = ""
    family: str = ""
    kind: Kind | None = None
    ideal: Image | None = None
    displacement: NDArray[np.float32] | None = None
    elements: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    regular_share: float | None = None
    region: Region | None = None


@runtime_checkable
class Dataset(Protocol):
    """The form of a dataset plugin: a frozen dataclass with these two methods."""

    def render(self, shape: Shape, rng: np.random.Generator) -> Texture:
        """Return a texture of ``shape``: lattice phase and departures drawn from ``rng``."""
        ...

    def again(self, texture: Texture, shape: Shape, rng: np.random.Generator) -> Texture | None:
        """Return an independent draw: same model and lattice, origin included, fresh departures.

        For a photograph, a region of ``shape`` disjoint from ``texture.region``. None where there is none.
        """
        ...
