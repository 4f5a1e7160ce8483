"""What a texture is, learned from fresh draws of its model, or from the one sample of a photograph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice, Points, Vector
from nrbench.plugins.forms import Again, Observation, Shape, Texture

from ..perception import limits
from ..perception.visible import Lab, SeenSample, perceive
from ..registration.followed import CellModel, FollowedPicture
from ..registration.lattice_net import LatticeNet, Mask, Values, fold_cells, sample_planes
from ..registration.lattice_nodes import STRIPS as STRIPS
from ..registration.lattice_nodes import WIDEST, Strips, choose_windows, explain_share
from .known_lattice import canonical_lattice

FIRST_DRAW = 1 << 16
"""Number of the first fresh draw of the reference; the oracle and the planted defects use smaller numbers."""
DRAWS = 6
"""Number of fresh draws."""
_SIDES = (128, 384)
"""Smallest and largest side of a fresh draw, px."""
_LEAST_TILES = 8
"""Least number of tiles along each side of a fresh draw."""
_FEWEST_CELLS = 3
"""Least number of cells along each vector, the incomplete ones included."""


class CannotTell(Exception):
    """There is no reference, or it is too small; the message is the reason, as in the tables."""


@dataclass(frozen=True, eq=False)
class TextureReference:
    """The pictures that show what a texture is, followed by its lattice.

    Parameters
    ----------
    pictures
        The reference pictures followed by the lattice: fresh draws, or the sample alone.
    model
        The model of the cell, learned from all of them.
    sample_shape
        Shape of the sample that a method receives.
    """

    pictures: Sequence[FollowedPicture]
    model: CellModel
    sample_shape: Shape

    @property
    def net(self) -> LatticeNet:
        """The net of the pictures, which have one shape."""
        return self.pictures[0].net

    @property
    def strips(self) -> Strips | None:
        """The strips of a sample; None for fresh draws."""
        return self.pictures[0].strips

    @property
    def from_sample(self) -> bool:
        """Whether the sample is all that is known of the texture."""
        return self.strips is not None

    @cached_property
    def color(self) -> Values:
        """(3,): mean color."""
        return np.asarray(np.mean([picture.lab[..., :3].mean((0, 1)) for picture in self.pictures], 0), np.float32)

    @cached_property
    def usual_misfit(self) -> tuple[float, float]:
        """Median misfit of the cells of the reference, and the misfit beyond which a cell is torn."""
        misfits = np.concatenate([picture.misfit[picture.valid & picture.in_place] for picture in self.pictures])
        top, margin = (limits.TOP_OF_SAMPLE, limits.TORN_OF_SAMPLE) if self.from_sample else (limits.TOP, limits.TORN)
        mean = self.model.mean
        flat = ((mean - mean.mean((0, 1))) ** 2 / (self.model.variance + limits.JND**2)).mean()
        seen = max(limits.SEEN_MISFIT, limits.OF_FLAT * float(flat))
        return max(float(np.median(misfits)), seen / 2), max(margin * float(np.quantile(misfits, top)), seen)

    @cached_property
    def slip_limit(self) -> float:
        """Difference in s between two sides of a line beyond which they have slipped."""
        least = limits.SLIP * (limits.LOOSE if self.from_sample else 1)
        return max(least, limits.OF_SLIP * max(float(picture.slip.max(initial=0)) for picture in self.pictures))

    @cached_property
    def most_misplaced(self) -> float:
        """Share out of place that chance explains, by the pictures or the strips."""
        bad = [self.misplacement(picture) for picture in self.pictures]
        if self.strips is not None:
            return explain_share(self.strips.share_out(bad[0], self.pictures[0]), True)
        shares = [each[picture.valid].mean() for each, picture in zip(bad, self.pictures, strict=True)]
        return explain_share(np.array(shares), False)

    @cached_property
    def residuals(self) -> list[tuple[Values, Mask]]:
        """The straightened pictures less their mean cell, and their known points."""
        return [picture.residual for picture in self.pictures]

    @cached_property
    def departures(self) -> list[tuple[Values, Mask]]:
        """The straightened pictures less one mean cell, that of all of them, and their known points."""
        mean = self.net.tile(self.model.mean)
        return [(plane - mean, known) for plane, known in (picture.straightened for picture in self.pictures)]

    @cached_property
    def shown(self) -> list[tuple[Values, Mask]]:
        """The same for all points of a sample, because its cells out of place, as rare ones can be, belong to it."""
        inside = self.net.inside
        return [(plane, inside if self.from_sample else known) for plane, known in self.departures]

    def follow(self, lab: Lab, drift: Points | float = 0.0) -> FollowedPicture:
        """Follow the lattice, stretched and turned by a drift ``(2, 2)``, through an output."""
        net = self.net.over((lab.shape[0], lab.shape[1]))
        net = net.stretch(drift) if np.any(drift) else net
        picture = self.pictures[0]
        if (net.cells <= picture.size).any():
            raise CannotTell("undecided: the output shows fewer than three cells along a lattice vector")
        offset = np.asarray(self.color - lab[..., :3].mean((0, 1)), np.float32)
        followed = FollowedPicture(net, picture.limit, picture.size, lab, (self.model,), offset=offset)
        if not followed.valid.any():
            raise CannotTell("undecided: no window of whole cells lies inside the output")
        return followed

    def misplacement(self, picture: FollowedPicture) -> NDArray[np.float64]:
        """Return how far each node is out of place, ``(R, C)``: 0 in place, 1 wholly out of place.

        To what lies apart from its surroundings (:meth:`~.registration.lattice_nodes.LatticeNodes.misplacement`) it
        adds the cells that show the pattern nowhere (misfit); misfits are relative to those of the output, because a
        change of color or contrast is no fault of the lattice. So is a window without any contrast.
        """
        bad = picture.misplacement(self.slip_limit)
        median, torn = self.usual_misfit
        own = float(np.median(picture.misfit[picture.in_place])) if picture.in_place.any() else median
        return np.where((picture.misfit > torn * max(1.0, own / median)) | self.find_blank(picture), 1.0, bad)

    def find_blank(self, picture: FollowedPicture) -> Mask:
        """Return the nodes whose windows show no pattern, ``(R, C)``: they fit equally well everywhere."""
        usual = np.concatenate([own.contrast[own.valid] for own in self.pictures])
        return np.asarray(picture.contrast < limits.BLANK * float(np.median(usual)))


@lru_cache(maxsize=2)
def perceive_draws(again: Again, shape: Shape) -> tuple[Texture, list[Lab]]:
    """Return the first fresh draw of the reference, and what is seen of all; raises :class:`CannotTell` without any."""
    draws = [again(shape, FIRST_DRAW + k) for k in range(DRAWS)]
    found = [draw for draw in draws if draw is not None]
    if len(found) < DRAWS:
        raise CannotTell(f"not applicable: the texture's dataset gives no fresh draw of {shape[1]}x{shape[0]} px")
    return found[0], [perceive(quantize(draw.image)) for draw in found]


def fresh_images(observation: Observation, number: int) -> list[Image]:
    """Return up to ``number`` fresh draws of the output's shape; none of a photograph."""
    if observation.again is None:
        return []
    shape = (observation.output.shape[0], observation.output.shape[1])
    draws = [observation.again(shape, FIRST_DRAW + k) for k in range(number)]
    return [draw.image for draw in draws if draw is not None]


@lru_cache(maxsize=2)
def reference_from_draws(
    again: Again, vectors: tuple[Vector, Vector], output: Shape, sample_shape: Shape
) -> TextureReference:
    """Learn a texture from fresh draws.

    Parameters
    ----------
    again
        Returns fresh draws. The origin of their lattice may be another than that of the sample's.
    vectors
        The canonical generating vectors of the lattice.
    output, sample_shape
        Shapes of the output and of the sample.

    Raises
    ------
    CannotTell
        If the dataset gives no fresh draw.
    """
    least = np.maximum(_LEAST_TILES * np.abs(vectors).max(0)[::-1], _SIDES[0])
    height, width = np.maximum(np.minimum(output, _SIDES[1]), np.ceil(least)).astype(int).tolist()
    first, labs = perceive_draws(again, (height, width))
    lattice = canonical_lattice(first.lattice or Lattice(*vectors))
    return _learn(labs, lattice, None if first.ideal is None else perceive(first.ideal), None, sample_shape)


@lru_cache(maxsize=2)
def reference_from_sample(sample: SeenSample, lattice: Lattice) -> TextureReference:
    """Learn a texture from its sample. Each of four strips is judged by a model of the cell from the other three.

    Raises
    ------
    CannotTell
        If the sample is too small.
    """
    return _learn([sample.lab], lattice, None, Strips.across(sample.shape, STRIPS), sample.shape, sample.known)


def _learn(
    labs: Sequence[Lab],
    lattice: Lattice,
    ideal: Lab | None,
    strips: Strips | None,
    sample_shape: Shape,
    counted: Mask | None = None,
) -> TextureReference:
    net = LatticeNet((labs[0].shape[0], labs[0].shape[1]), lattice.matrix, np.array(lattice.origin), counted)
    if net.cells.min() < _FEWEST_CELLS:
        raise CannotTell("undecided: the sample shows fewer than three cells along a lattice vector")
    models = (_first_model(labs if ideal is None else [ideal], net),) * (STRIPS if strips else 1)
    size = 2 if net.cells.min() > _FEWEST_CELLS else 1

    def follow(size: int) -> list[FollowedPicture]:
        return [FollowedPicture(net, _ROUGHLY, size, lab, models, strips) for lab in labs]

    for _ in range(3 if strips else 2):
        planes, known = zip(*(picture.straightened for picture in follow(size)), strict=True)
        if not all(k.any() for k in known):
            raise CannotTell("undecided: the lattice cannot be followed through the sample")
        model = CellModel.fold(planes, known, net, strips is not None)
        models = (model,)
        if strips:
            parts = [known[0] & (strips.number(net.points) != k) for k in range(STRIPS)]
            models = tuple(CellModel.fold(planes[:1], [part], net, True) for part in parts)

    pictures = choose_windows(follow, range(1, min(WIDEST, int(net.cells.min()) - 1) + 1), strips is not None)
    if not pictures:
        raise CannotTell("undecided: no window of whole cells lies inside the sample")
    if not any((picture.valid & picture.in_place).any() for picture in pictures):
        raise CannotTell("undecided: the lattice cannot be followed through the sample")
    return TextureReference(pictures, model, sample_shape)


_ROUGHLY = 0.2
"""Largest departure in s of a node in place while the texture is learned."""


def _first_model(labs: Sequence[Lab], net: LatticeNet) -> CellModel:
    """Return the mean cell of pictures that are not straightened, with one variance everywhere."""
    net = replace(net, shape=(labs[0].shape[0], labs[0].shape[1]))
    planes = [sample_planes(lab[..., :3], net.points, net.inside) for lab in labs]
    mean = np.asarray(np.mean([fold_cells(plane, net.inside, net.samples) for plane in planes], 0))
    return CellModel(mean, np.full_like(mean, 100))
