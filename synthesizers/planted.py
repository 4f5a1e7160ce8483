"""Fresh draws with one known defect, on which scores are tested."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final, Protocol

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from nrbench.errors import require, require_ranges
from nrbench.imaging.convert import MIN_SIDE, Image
from nrbench.imaging.mean_tile import fold, interpolate_planes
from nrbench.lattice.geometry import Lattice, Points, Vector
from nrbench.plugins.forms import Again, Refused, Shape, Synthesis, Task, Texture
from nrbench.plugins.parameters import nearest

from .lattice_places.equal_places import EqualPlaces, pixel_grid

Field = NDArray[np.intp]
"""``(H, W, 2)``: how far, (x, y) whole px, the content at each pixel has moved."""
Mask = NDArray[np.bool_]
FIRST_DRAW = 1 << 20
"""Defects are planted in fresh draws from this number on; the scores use those before it."""
_PATCH_TILES = 2.0
"""Side of a patch, in tiles."""
_MOST = 0.5
"""Size at which a dropped or doubled row and a doubled tile saturate."""
_BLUR = 8.0
"""Standard deviation in px of the blur at size 1."""
_COARSE = 4.0
"""Standard deviation in px of the Gaussian above which variation is coarse: tones of elements, not their texture."""
_TINT_WINDOW = 7
"""Side in px of the window whose median is the tint of the element at its middle."""
_RING = 0.02
"""Width in cycles/px of the rings of frequencies on which the coefficients of the detail change places."""
_LUMA = np.array([0.299, 0.587, 0.114])
_HUES = 24
"""Number of hues of the new colors that are tried."""
_SATURATIONS = (0.2, 0.3, 0.4, 0.5, 0.6)
"""Their distances from gray of equal brightness, in values."""
_LOOKS = 400
"""Largest number of places whose colors are compared with a new color."""
_FAR = 0.25
"""Mean distance, in values, of a new color from the colors of the elements, that is enough."""
_INSIDE = 0.2
"""Largest distance, along both lattice vectors and as a share of them, of the place where a tile is torn."""
_TEAR = 0.25
"""Distance, in s, by which one part of a torn tile is moved."""
_SEAM_REACH = 16.0
"""Distance in px from a seam at which its change of brightness ends."""
_SPLINE_MARGIN = 8
"""Margin in px that a draw needs for splines at its border."""


@dataclass(frozen=True)
class Planted:
    """A fresh draw of the texture with one known defect: validates scores.

    Size 0 is the unchanged fresh draw, for every kind. The extras hold the truth: ``displacement`` (``float32 (H, W,
    2)``: how far, (x, y) px, the content at each pixel has moved from its place in the draw; where content is repeated,
    a lattice vector in whole pixels), and ``covered`` (``float32 (H, W)``, 1 at the pixels of the defect). The note
    gives the actual size. Content moves by whole pixels, so that only its place differs from the rest; ``warp`` and
    ``stretch`` interpolate by cubic splines, which smooths a little.

    Parameters
    ----------
    kind
        One of :data:`DEFECTS`. s is the length of the shortest lattice vector. Where a kind saturates at 1/2, larger
        sizes either count as 1/2 (where the table says so) or approach another lattice point, and are no worse:

        =============== ============================================================== ===========================
        kind            defect                                                         size; where it saturates
        =============== ============================================================== ===========================
        none            none                                                           has no meaning
        phase-step      everything beyond a line through the middle is moved           distance, in s; 1/2
        slipped-course  one course of lattice points along t1 slides along t1          distance, in s; counts as
                                                                                       half of t1 at most
        dropped-row     a part of a course is missing, and the gap is closed           share of its height; counts
                                                                                       as 1/2 at most, since a
                                                                                       lattice can be whole again
                                                                                       without a whole course
        doubled-row     a part of a course is there twice, and everything beyond is    as dropped-row
                        moved
        displaced-tile  the content of one cell is moved                               distance, in s; 1/2
        missing-tile    one cell is covered by its mean color                          opacity of the cover; none
        doubled-tile    a copy of one cell covers it and its neighbors                 the copy's distance, in s;
                                                                                       counts as 1/2 at most
        warp            content moves smoothly, over a correlation length (to 1/e) of  largest distance, in s; 1/2
                        2 s
        stretch         the draw is stretched along a random axis about the middle     lengthening (0.02: 2 %);
                                                                                       where the ends have moved
                                                                                       by half a tile; needs no
                                                                                       lattice
        off-lattice     patches two tiles wide, each moved in a random direction       distance, in s; 1/2
        blurred-band    a band across, a quarter of the output wide, is blurred        standard deviation of the
                                                                                       Gaussian, in 8 px; where it
                                                                                       spans a tile; needs no
                                                                                       lattice
        blur            the whole draw is blurred                                      standard deviation of the
                                                                                       Gaussian, in px; needs no
                                                                                       lattice
        contrast        all values are moved toward their mean                         share of the contrast that is
                                                                                       lost; needs no lattice
        noise           white noise replaces the texture inside elements (less than    share of its variance; needs
                        about 4 px wide), with equal variance                          a geometry that is constant
        wrong-surface   Gaussian grain without direction replaces the detail inside    share of its variance; needs
                        elements, with equal power in each octave and at each place    a geometry that is constant
                        of the cell: streaks, pits and relief are lost. On a texture
                        that is flat but for its grain this is no defect
        new-color       elements keep brightness and grain, and get a hue and a        share of tiles; none; needs
                        saturation that no element has                                 colors
        seam            one side of a line is brighter and the other darker, by half   step of values at the line;
                        of the step each, fading linearly to nothing 16 px away        where values are clipped;
                                                                                       needs no lattice
        color-mean      one color is added to all pixels, towards the middle of values its Euclidean length, in
                                                                                       values; where values are
                                                                                       clipped, about 0.5; needs
                                                                                       no lattice
        two-tone        tiles cut in half across t1, one half replaced by that of      share of tiles; none
                        another draw
        torn            tiles cut in two by a line through a random place inside; the  share of tiles; none
                        part beyond it is another draw's, moved along the line by s/4
        over-regular    the draw mixed with the repetition of one of its tiles         weight of the repetition
                                                                                       (1: all tiles are
                                                                                       identical); none
        verbatim        patches up to two tiles wide are exact copies of equivalent    share of the output's area
                        places                                                         that is copied; counts as
                                                                                       1/2 at most: the other half
                                                                                       is what they are copies of
        =============== ============================================================== ===========================
    size
        Size in [0, 1], in the unit of the kind.
    """

    reference: ClassVar[bool] = True
    uses_lattice: ClassVar[bool] = False
    version: ClassVar[str] = "3"

    kind: str = "phase-step"
    size: float = 0.25

    def __post_init__(self) -> None:
        require(self.kind in DEFECTS, f"kind {self.kind!r} is unknown{nearest(self.kind, DEFECTS)}")
        require_ranges(self, size=(0, 1))

    @property
    def label(self) -> str:
        """The name in tables: kind and size, even at their defaults."""
        return f"planted:kind={self.kind},size={self.size}"

    def synthesize(self, task: Task) -> Synthesis:
        """Return a fresh draw with the defect in it.

        Raises
        ------
        Refused
            When the texture has no fresh draws, when the kind needs a lattice and there is none, or when a defect of a
            size above 0 covers no pixel: it is less than a pixel, or has no room in the output.
        """
        # All draws share one lattice: the smallest draw gives it.
        first = task.again((MIN_SIDE, MIN_SIDE), FIRST_DRAW) if task.again is not None else None
        if task.again is None or first is None:
            raise Refused("planted: this texture has no fresh draws")
        site = Site(task.shape, first.lattice, self.size, task.rng, task.again)
        planted = DEFECTS[self.kind](site)
        if self.size > 0 and self.kind != "none" and not planted.mask.any():
            height, width = task.shape
            what = f"planted: {self.kind} of size {self.size:g} covers no pixel of an output of {width}x{height} px"
            raise Refused(f"{what}: it is less than a pixel, or has no room; give a larger size or output")
        extras = {
            "displacement": planted.displacement.astype(np.float32),
            "covered": planted.mask.astype(np.float32),
        }
        return Synthesis(planted.image, extras=extras, note=f"planted {self.kind}{_amount(site, planted)}")


def _amount(site: Site, planted: PlantedImage) -> str:
    """Return the actual size of the defect, for the note: its own words, or the largest displacement."""
    if planted.amount or site.known is None:
        return f" of {planted.amount}" if planted.amount else ""
    distance = float(np.sqrt((planted.displacement**2).sum(-1)).max())
    return f" of {distance / site.lattice.s:.3f} s ({distance:.1f} px)"


@dataclass(frozen=True)
class Site:
    """The output and the texture in which a defect is planted, and random choices of its place.

    Parameters
    ----------
    shape
        Shape of the output.
    known
        The texture's lattice; None if it has none.
    size
        The defect's size, in [0, 1].
    rng
        Decides the defect's place and direction.
    again
        Returns fresh draws.
    """

    shape: Shape
    known: Lattice | None
    size: float
    rng: np.random.Generator
    again: Again

    @property
    def lattice(self) -> Lattice:
        """The texture's lattice, in the pixels of a draw without margin; raises :class:`Refused` if there is none."""
        if self.known is None:
            raise Refused("planted: this texture has no lattice")
        return self.known

    @property
    def extent(self) -> Points:
        """Width and height of the output in px."""
        return np.array(self.shape[::-1], np.float64)

    @property
    def tile_size(self) -> Points:
        """Width and height in px of a tile of the reduced lattice."""
        return np.asarray(np.sqrt((self.lattice.reduced().matrix ** 2).sum(0)))

    @property
    def border(self) -> Points:
        """Least distance in px, along x and y, of :meth:`random_point` to the border: a tile, or a third of a side."""
        return np.asarray(np.minimum(self.tile_size, self.extent / 3))

    def draw(self, margin: int = 0) -> Texture:
        """Return a fresh draw, ``margin`` px wider than the output on every side."""
        height, width = self.shape
        draw = self.again((height + 2 * margin, width + 2 * margin), FIRST_DRAW + int(self.rng.integers(1, 1 << 30)))
        if draw is None:
            raise Refused("planted: this texture has no fresh draw of the output's size")
        return draw

    def pixels(self) -> Points:
        """Return (x, y) of every pixel, ``(H, W, 2)``."""
        return pixel_grid(*self.shape[::-1]).astype(np.float64)

    def zeros(self) -> Field:
        """Return a displacement field of zeros."""
        return np.zeros((*self.shape, 2), np.intp)

    def random_step(self, most: float = 1.0) -> NDArray[np.intp]:
        """Return a random vector of whole px whose length is as near as possible to ``size`` times s.

        Parameters
        ----------
        most
            Largest length, in s.
        """
        angle = self.rng.uniform(0, 2 * math.pi)
        distance = min(self.size, most) * self.lattice.s
        wanted = distance * np.array([math.cos(angle), math.sin(angle)])
        corners = np.floor(wanted).astype(np.intp) + np.array([(0, 0), (0, 1), (1, 0), (1, 1)])
        return np.asarray(corners[np.argmin(np.abs(np.hypot(*corners.T) - distance))])

    def random_cell(self) -> Mask:
        """Return the pixels of one cell: those nearer to a random point than to any equivalent point."""
        away = self.pixels() - self.random_point()
        return np.asarray(np.abs(self.lattice.wrap(away) - away).max(-1) < 1e-6)

    def random_point(self) -> Points:
        """Return a random point (x, y) around which a whole cell fits, if the output holds one."""
        return np.asarray(self.border + self.rng.random(2) * (self.extent - 1 - 2 * self.border))

    def random_central_point(self) -> Points:
        """Return a random point (x, y) of the middle half of the output."""
        return np.asarray((self.extent - 1) * (0.25 + self.rng.random(2) / 2))


@dataclass(frozen=True)
class PlantedImage:
    """An image with a defect, and the defect's place and amount.

    Parameters
    ----------
    image
        The output.
    displacement
        ``(H, W, 2)``: how far, (x, y) px, the content at each pixel has moved from its place in the fresh draw.
    covered
        The pixels of the defect; None: those whose content has moved.
    amount
        The defect's actual size, for the note; empty: the largest displacement.
    """

    image: Image
    displacement: Field | Points
    covered: Mask | None = None
    amount: str = ""

    @property
    def mask(self) -> Mask:
        """The pixels of the defect."""
        return np.asarray(self.displacement.any(-1)) if self.covered is None else self.covered


class Defect(Protocol):
    """A function that plants a defect."""

    __name__: str

    def __call__(self, site: Site) -> PlantedImage:
        """Return a fresh draw with the defect."""


# Content in the wrong place


def none(site: Site) -> PlantedImage:
    """Leave the fresh draw as it is."""
    return _displace(site, site.zeros())


def phase_step(site: Site) -> PlantedImage:
    """Move everything beyond a line through the middle."""
    field = site.zeros()
    half = np.s_[site.shape[0] // 2 :] if site.rng.integers(2) else np.s_[:, site.shape[1] // 2 :]
    field[half] = site.random_step()
    return _displace(site, field)


def slipped_course(site: Site) -> PlantedImage:
    """Slide one course along t1, by half of t1 at most."""
    courses = _LatticeCourses(site, reach=site.lattice.s)
    distance = min(site.size * site.lattice.s, courses.length / 2)
    field = site.zeros()
    field[(courses.beyond >= 0) & (courses.beyond < 1)] = _round(courses.sign * distance * courses.along)
    return _displace(site, field, courses.margin)


def dropped_row(site: Site) -> PlantedImage:
    """Remove a part of a course, half of it at most, and close the gap."""
    courses = _LatticeCourses(site, reach=site.lattice.area / math.hypot(*site.lattice.t1) / 2)
    field = site.zeros()
    field[courses.beyond >= 0] = -_round(min(site.size, _MOST) * courses.height * courses.across)
    return _displace(site, field, courses.margin)


def doubled_row(site: Site) -> PlantedImage:
    """Repeat a part of a course, half of it at most, and move everything beyond."""
    courses = _LatticeCourses(site, reach=site.lattice.area / math.hypot(*site.lattice.t1) / 2)
    step = _round(min(site.size, _MOST) * courses.height * courses.across)
    field = site.zeros()
    field[courses.at(site.pixels() - step) >= 0] = step
    return _displace(site, field, courses.margin)


def displaced_tile(site: Site) -> PlantedImage:
    """Move the content of one cell."""
    field = site.zeros()
    field[site.random_cell()] = site.random_step()
    return _displace(site, field)


def doubled_tile(site: Site) -> PlantedImage:
    """Copy one cell over itself and its neighbors, at a distance of half of s at most."""
    cell, step = site.random_cell(), site.random_step(_MOST)
    field = site.zeros()
    y, x = np.nonzero(cell)
    x, y = x + step[0], y + step[1]
    inside = (x >= 0) & (y >= 0) & (x < site.shape[1]) & (y < site.shape[0])
    field[y[inside], x[inside]] = step
    return _displace(site, field, 0)


def off_lattice(site: Site) -> PlantedImage:
    """Move every patch of two tiles in a random direction."""
    field = site.zeros()
    width, height = np.maximum(np.rint(_PATCH_TILES * site.tile_size), 1).astype(int)
    for top in range(0, site.shape[0], height):
        for left in range(0, site.shape[1], width):
            field[top : top + height, left : left + width] = site.random_step()
    return _displace(site, field)


def warp(site: Site) -> PlantedImage:
    """Move content smoothly, by white noise under a Gaussian of standard deviation s (correlation length 2 s)."""
    scale = site.lattice.s
    margin = math.ceil(3 * scale)
    noise = site.rng.standard_normal((site.shape[0] + 2 * margin, site.shape[1] + 2 * margin, 2))
    smooth = scipy.ndimage.gaussian_filter(noise, (scale, scale, 0), truncate=3, mode="constant")[
        margin:-margin, margin:-margin
    ]
    field = smooth * (site.size * scale / np.hypot(*np.moveaxis(smooth, -1, 0)).max())
    return _resample(site, field, math.ceil(scale) + _SPLINE_MARGIN)


def stretch(site: Site) -> PlantedImage:
    """Stretch along a random axis, away from the middle."""
    angle = site.rng.uniform(0, math.pi)
    axis = np.array([math.cos(angle), math.sin(angle)])
    away = (site.pixels() - (site.extent - 1) / 2) @ axis
    field = site.size / (1 + site.size) * away[..., np.newaxis] * axis
    moved = _resample(site, field, _SPLINE_MARGIN)
    return PlantedImage(
        moved.image, field, np.full(site.shape, field.any()), f"{100 * site.size:g} % at {angle:.2f} rad"
    )


class _LatticeCourses:
    """The courses of a lattice, the rows along t1 with joints halfway between lattice points, and one chosen course.

    ``margin`` is the margin of the draw: wide enough for content to move by ``reach`` px, whatever the size.
    """

    def __init__(self, site: Site, reach: float) -> None:
        self.margin = math.ceil(reach) + 1
        lattice = site.lattice.shifted((-self.margin, -self.margin))
        self._lattice = lattice
        self.length = math.hypot(*lattice.t1)
        self.height = lattice.area / self.length
        self.along = lattice.matrix[0] / self.length
        right = np.array([-self.along[1], self.along[0]])
        self.across = right if right @ lattice.matrix[1] > 0 else -right
        self._course = np.rint(lattice.to_cell(site.random_central_point())[1])
        self.sign = 1 if site.rng.integers(2) else -1
        self.beyond = self.at(site.pixels())

    def at(self, points: Points) -> Points:
        """Return the distance of points beyond the near joint of the chosen course, in courses."""
        return np.asarray(self._lattice.to_cell(points)[..., 1] - self._course + 0.5)


def _round(vector: Points) -> Field:
    return np.rint(vector).astype(np.intp)


def _displace(site: Site, field: Field, margin: int | None = None) -> PlantedImage:
    """Displace the content of a draw by whole pixels; the draw is wider than the output by the margin."""
    margin = int(np.abs(field).max()) if margin is None else margin
    return PlantedImage(read_displaced(site.draw(margin).image, margin, field), field)


def _resample(site: Site, field: Points, margin: int) -> PlantedImage:
    """Displace the content of a draw by fractions of a pixel, interpolated by cubic splines."""
    draw = site.draw(margin).image
    if not field.any():
        return PlantedImage(read_displaced(draw, margin, site.zeros()), field)
    y, x = np.indices(site.shape) + margin
    moved = interpolate_planes(draw, np.stack([y - field[..., 1], x - field[..., 0]]), 3, "mirror")
    return PlantedImage(np.clip(moved, 0, 1).astype(np.float32), field)


def read_displaced(draw: Image, margin: int, field: Field) -> Image:
    """Return ``draw`` without its margin, each pixel read from the place that its content came from.

    Raises
    ------
    IndexError
        When the margin is too small for the displacement.
    """
    rows, columns = np.indices(field.shape[:2])
    y, x = rows + margin - field[..., 1], columns + margin - field[..., 0]
    if min(y.min(), x.min()) < 0 or y.max() >= draw.shape[0] or x.max() >= draw.shape[1]:
        raise IndexError(f"a margin of {margin} px is too small for displacements of {np.abs(field).max()} px")
    return np.asarray(draw[y, x])


# Content that looks wrong in its place


def missing_tile(site: Site) -> PlantedImage:
    """Cover one cell with its mean color."""
    covered, fresh = site.random_cell(), site.draw().image
    image = np.array(fresh)
    image[covered] += np.float32(site.size) * (image[covered].mean(0) - image[covered])
    return PlantedImage(image, site.zeros(), covered & (image != fresh).any(), f"opacity {site.size:g}")


def blurred_band(site: Site) -> PlantedImage:
    """Blur a band across the output, a quarter of it wide."""
    axis = int(site.rng.integers(2))
    width = max(site.shape[axis] // 4, 1)
    start = int(site.rng.integers(site.shape[axis] - width + 1))
    covered = np.zeros(site.shape, np.bool_)
    np.moveaxis(covered, axis, 0)[start : start + width] = True
    fresh, deviation = site.draw().image, _BLUR * site.size
    image = np.array(fresh)
    if deviation:
        image[covered] = scipy.ndimage.gaussian_filter(image, (deviation, deviation, 0), mode="mirror")[covered]
    return PlantedImage(image, site.zeros(), covered & (image != fresh).any(), f"standard deviation {deviation:g} px")


def blur(site: Site) -> PlantedImage:
    """Blur the whole draw."""
    fresh = site.draw().image
    image = scipy.ndimage.gaussian_filter(fresh, (site.size, site.size, 0), mode="mirror") if site.size else fresh
    return PlantedImage(image, site.zeros(), _changed(image, fresh), f"standard deviation {site.size:g} px")


def contrast(site: Site) -> PlantedImage:
    """Move all values toward their mean."""
    fresh = site.draw().image
    image = fresh + np.float32(site.size) * (fresh.mean((0, 1), np.float64).astype(np.float32) - fresh)
    return PlantedImage(image, site.zeros(), _changed(image, fresh), f"contrast times {1 - site.size:g}")


def noise(site: Site) -> PlantedImage:
    """Replace a share of the variance of the texture inside elements by white noise.

    The texture inside elements is what the periodic image does not explain, less its Gaussian blur of 4 px.
    """
    image, rest = _split_draw(site)
    fine = rest - scipy.ndimage.gaussian_filter(rest, (_COARSE, _COARSE, 0), mode="mirror")
    white = site.rng.standard_normal(fine.shape) * fine.std((0, 1), dtype=np.float64)
    return _replace_share(site, image, fine, white)


def wrong_surface(site: Site) -> PlantedImage:
    """Replace a share of the variance of the detail inside elements by Gaussian grain of equal power.

    The detail is what the periodic image and the tints of elements do not explain. The tint at a pixel is the median
    of the departures around it, times the part of it that is usual at this place of the cell: nothing in joints. The
    amplitudes of the Fourier coefficients of the detail change places on rings of equal frequency, and get random
    phases, so that no direction and no form is left.
    """
    image, rest = _split_draw(site)
    near = scipy.ndimage.median_filter(rest, (_TINT_WINDOW, _TINT_WINDOW, 1), mode="mirror")
    products = np.stack([(rest * near).sum(-1), (near * near).sum(-1)], -1)
    usual = fold(products, site.lattice).unfold(site.shape)
    detail = rest - near * (usual[..., :1] / np.maximum(usual[..., 1:], 1e-12)).clip(0, 1)
    level = np.sqrt(np.maximum(fold(detail * detail, site.lattice).unfold(site.shape), 1e-12))
    spectrum = np.fft.fft2(detail / level, axes=(0, 1)).reshape(-1, detail.shape[2])
    radius = np.hypot(*np.meshgrid(*map(np.fft.fftfreq, site.shape), indexing="ij")).ravel()
    mixed = spectrum[np.argsort(radius + site.rng.uniform(0, _RING, radius.shape))]
    spectrum[np.argsort(radius)] = mixed * np.exp(2j * np.pi * site.rng.random((len(radius), 1)))
    grain = math.sqrt(2) * np.fft.ifft2(spectrum.reshape(detail.shape), axes=(0, 1)).real * level
    return _replace_share(site, image, detail, grain)


def _split_draw(site: Site) -> tuple[Image, Image]:
    """Return a draw of a texture whose geometry is constant, and what its periodic image does not explain."""
    if site.known is None:
        raise Refused("planted: this texture has no lattice")
    draw = site.draw()
    if draw.ideal is None or draw.displacement is not None:
        raise Refused("planted: this kind needs a texture model whose geometry does not vary")
    return draw.image, draw.image - draw.ideal


def _replace_share(site: Site, fresh: Image, part: Image, other: NDArray[np.float64]) -> PlantedImage:
    """Replace a share of the variance of a part of the draw by another one of equal variance."""
    change = (math.sqrt(1 - site.size) - 1) * part + math.sqrt(site.size) * other
    image = np.clip(fresh + change, 0, 1).astype(np.float32) if site.size else fresh
    return PlantedImage(image, site.zeros(), _changed(image, fresh), f"{site.size:g} of the variance")


def new_color(site: Site) -> PlantedImage:
    """Give tiles a hue and a saturation that no tile has, at equal brightness.

    It is the least saturated of some colors that is far from those of all elements. It shows at each place as much as
    elements vary there, so that joints keep their color.
    """
    index, _, chosen, amount = _choose_tiles(site)
    fresh = site.draw().image
    if fresh.shape[2] != 3:
        raise Refused("planted: a gray texture has no hues")
    rest = fresh - fold(fresh, site.lattice).unfold(site.shape)
    varies = fold((rest * rest).sum(-1, keepdims=True), site.lattice).unfold(site.shape) + 1e-6
    weight = (2 * varies / np.quantile(varies, 0.75) - 0.5).clip(0, 1)
    seen = scipy.ndimage.gaussian_filter(fresh, (1.5, 1.5, 0))[weight[..., 0] > 0.5]
    seen = seen[:: len(seen) // _LOOKS + 1]
    turns = np.linspace(0, 2 * math.pi, _HUES, endpoint=False)
    hues = np.stack([np.cos(turns), np.sin(turns)], -1) @ scipy.linalg.null_space(_LUMA[np.newaxis]).T
    colors = [saturation * hue for saturation in _SATURATIONS for hue in hues]
    bright = (seen @ _LUMA)[:, np.newaxis]
    far = [cdist((bright + color).clip(0, 1), seen).min(1).mean() for color in colors]
    new = (fresh @ _LUMA)[..., np.newaxis] + colors[int(np.argmax(np.minimum(far, _FAR)))]
    change = np.where(chosen[index][..., np.newaxis], weight * (new - fresh), 0)
    image = np.clip(fresh + change, 0, 1).astype(np.float32)
    return PlantedImage(image, site.zeros(), _changed(image, fresh), amount)


def _changed(image: Image, fresh: Image) -> Mask:
    return np.asarray((image != fresh).any(-1))


def seam(site: Site) -> PlantedImage:
    """Brighten one side of a line and darken the other, less with the distance from it."""
    angle = site.rng.uniform(0, 2 * math.pi)
    beyond = (site.pixels() - site.random_central_point()) @ np.array([math.cos(angle), math.sin(angle)])
    weight = np.maximum(1 - np.abs(beyond) / _SEAM_REACH, 0)
    change = site.size / 2 * np.where(beyond >= 0, weight, -weight)
    image = np.clip(site.draw().image + change[..., np.newaxis].astype(np.float32), 0, 1)
    return PlantedImage(image, site.zeros(), (weight > 0) & (site.size > 0), f"contrast {site.size:g}")


def color_mean(site: Site) -> PlantedImage:
    """Add one color of random proportions to all pixels, in each channel towards the middle of [0, 1]."""
    proportions = site.rng.uniform(0.2, 1, 3)
    fresh = site.draw().image
    mean = fresh.mean((0, 1), np.float64)
    direction = np.where(mean < 0.5, 1, -1) * proportions[: len(mean)]
    change = site.size * direction / np.hypot.reduce(direction)
    image = np.clip(fresh + change.astype(np.float32), 0, 1)
    actual = float(np.hypot.reduce(image.mean((0, 1), np.float64) - mean))
    covered = np.full(site.shape, site.size > 0)
    return PlantedImage(image, site.zeros(), covered, f"{site.size:g} ({actual:.3f} after clipping)")


# Content that is repeated too often, or joined of two draws


def two_tone(site: Site) -> PlantedImage:
    """Cut tiles in half across t1, and replace one half by that of another fresh draw."""
    index, away, chosen, amount = _choose_tiles(site)
    covered = chosen[index] & (away @ site.lattice.matrix[0] > 0)
    image, other = site.draw().image, site.draw().image
    return PlantedImage(np.where(covered[..., np.newaxis], other, image), site.zeros(), covered, amount)


def torn(site: Site) -> PlantedImage:
    """Cut tiles by a line through a place inside, and show beyond it another draw, moved along the line by s/4."""
    index, away, chosen, amount = _choose_tiles(site)
    angle = site.rng.uniform(0, 2 * math.pi, len(chosen))
    along, across = (np.stack([np.cos(turn), np.sin(turn)], -1) for turn in (angle, angle + math.pi / 2))
    place = site.rng.uniform(-_INSIDE, _INSIDE, (len(chosen), 2)) @ site.lattice.matrix
    covered = chosen[index] & (((away - place[index]) * across[index]).sum(-1) > 0)
    field = np.where(covered[..., np.newaxis], _round(_TEAR * site.lattice.s * along)[index], 0)
    margin = math.ceil(_TEAR * site.lattice.s)
    image, other = site.draw().image, read_displaced(site.draw(margin).image, margin, field)
    return PlantedImage(np.where(covered[..., np.newaxis], other, image), field, covered, amount)


def _choose_tiles(site: Site) -> tuple[NDArray[np.intp], Points, Mask, str]:
    """Return the number of the tile of each pixel, the vector to it from the tile's middle, and the chosen tiles."""
    tile, away = _tiles(site.pixels(), site.lattice)
    tiles, index = np.unique(tile.reshape(-1, 2), axis=0, return_inverse=True)
    chosen = site.rng.permutation(len(tiles)) < round(site.size * len(tiles))
    return index.reshape(site.shape), away, chosen, f"{chosen.sum()} of {len(tiles)} tiles"


def over_regular(site: Site) -> PlantedImage:
    """Mix the draw with the periodic repetition of one of its tiles."""
    length = math.hypot(*site.lattice.t1)
    diagonal = math.hypot(length, site.lattice.area / length) + 1
    margin = math.ceil(max(*site.tile_size, length, diagonal - site.border.min()))
    lattice = site.lattice.shifted((-margin, -margin))
    tile, _ = _tiles(site.pixels(), lattice)
    chosen, _ = _tiles(site.random_point(), lattice)
    field: Field = np.rint((tile - chosen) @ lattice.matrix).astype(np.intp) if site.size else site.zeros()
    draw = site.draw(margin).image
    image, repeated = read_displaced(draw, margin, site.zeros()), read_displaced(draw, margin, field)
    mixed = repeated if site.size == 1 else image + np.float32(site.size) * (repeated - image)
    return PlantedImage(mixed, field, amount=f"weight {site.size:g}")


def verbatim(site: Site) -> PlantedImage:
    """Replace patches in one half of the output by copies of equivalent places in the other half."""
    halves = _Halves.of(site)
    field, order = site.zeros(), np.full(site.shape, site.shape[0] * site.shape[1], np.intp)
    count = 0
    for corner in site.rng.permutation(halves.corners()):
        patch, move = halves.patch(corner), _source(site, halves, corner)
        if move is not None:
            pixels = order[patch]
            pixels[...] = count + np.arange(pixels.size).reshape(pixels.shape)
            field[patch], count = move, count + pixels.size
    covered: Mask = order < min(round(site.size * order.size), count)
    field[~covered] = 0
    return PlantedImage(
        read_displaced(site.draw().image, 0, field), field, covered, f"{covered.mean():.3f} of the area"
    )


def _tiles(points: Points, lattice: Lattice) -> tuple[Points, Points]:
    """Return for each point the cell numbers of its tile, and the vector to it from the tile's middle.

    The middles are the lattice's points. On a hexagonal lattice, a tile is the Voronoi cell of its middle; otherwise it
    is a rectangle as long as t1 and as high as a course, like a brick.
    """
    if lattice.kind == "hexagonal":
        away = lattice.wrap(points - np.array(lattice.origin))
        return np.rint(lattice.to_cell(points - away)), away
    row = np.rint(lattice.to_cell(points)[..., 1])
    t1, t2 = lattice.matrix
    in_row = points - np.array(lattice.origin) - row[..., np.newaxis] * t2
    column = np.rint(in_row @ t1 / (t1 @ t1))
    return np.stack([column, row], -1), in_row - column[..., np.newaxis] * t1


@dataclass(frozen=True)
class _Halves:
    """The half that copies come from and the half they go to (both x0, y0, x1, y1), and the size of the patches."""

    source: tuple[int, int, int, int]
    target: tuple[int, int, int, int]
    width: int
    height: int

    @classmethod
    def of(cls, site: Site) -> _Halves:
        """Cut the output across its longer side. Patches are at most half as wide and high as the source."""
        height, width = site.shape
        low, high = (
            ((0, 0, width // 2, height), (width // 2, 0, width, height))
            if width >= height
            else ((0, 0, width, height // 2), (0, height // 2, width, height))
        )
        source, target = (low, high) if site.rng.integers(2) else (high, low)
        half = np.array([source[2] - source[0], source[3] - source[1]]) // 2
        patch = np.maximum(np.minimum(np.rint(_PATCH_TILES * site.tile_size).astype(int), half), 1)
        return cls(source, target, int(patch[0]), int(patch[1]))

    def corners(self) -> NDArray[np.intp]:
        """Return the first pixels (x, y) of the patches of the target."""
        x0, y0, x1, y1 = self.target
        x, y = np.meshgrid(np.arange(x0, x1, self.width), np.arange(y0, y1, self.height))
        return np.stack([x, y], -1).reshape(-1, 2).astype(np.intp)

    def patch(self, corner: NDArray[np.intp]) -> tuple[slice, slice]:
        """Return the patch at a corner, cut off where the target ends."""
        x, y = (int(value) for value in corner)
        return slice(y, min(y + self.height, self.target[3])), slice(x, min(x + self.width, self.target[2]))


def _source(site: Site, halves: _Halves, corner: NDArray[np.intp]) -> NDArray[np.intp] | None:
    """Return the vector to a patch from an equivalent place of the source, near whole pixels; None if there is none."""
    x0, y0, x1, y1 = halves.source
    room = (y1 - y0 - halves.height + 1, x1 - x0 - halves.width + 1)
    at: Vector = (float(corner[0] - x0), float(corner[1] - y0))
    places = EqualPlaces(site.lattice, room).find_places(at)
    if not len(places):
        return None
    pixels = np.floor(places + 0.5)
    error = np.hypot(*(pixels - places).T)
    good = np.flatnonzero(error <= np.median(error))
    chosen = pixels[good[site.rng.integers(len(good))]]
    return np.asarray(np.array(at) - chosen).astype(np.intp)


DEFECTS: Final[Mapping[str, Defect]] = {
    defect.__name__.replace("_", "-"): defect
    for defect in (
        *(none, phase_step, slipped_course, dropped_row, doubled_row, displaced_tile, missing_tile, doubled_tile),
        *(warp, stretch, off_lattice, blurred_band, blur, contrast, noise, seam, color_mean),
        *(wrong_surface, new_color, two_tone, torn, over_regular, verbatim),
    )
}
"""The defects by name; a new defect is one more entry."""
