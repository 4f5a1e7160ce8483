"""Known textures that are followed through bent images, and the registration of their windows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates

from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.datasets_procedural.weave import Weave
from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Texture
from nrbench.tracking.growth import Window
from nrbench.tracking.known_texture import FollowedImage, follow_texture
from nrbench.tracking.tracker import MeanTile

MODELS: dict[str, Model] = {
    "brick": Brick(color=0.2, noise=0.03),
    "weave": Weave(color=0.2, noise=0.03),
    "hexagon": Hexagon(color=0.2, noise=0.03, period=21.3),
}
SIDE = 192


def drawn(name: str, bend: float, seed: int) -> tuple[Texture, Lattice, MeanTile]:
    """Return a draw rounded to 8 bits, its reduced lattice, and the mean tile of its ideal image."""
    texture = replace(MODELS[name], bend=bend).render((SIDE, SIDE), np.random.default_rng(seed))
    assert texture.lattice is not None and texture.ideal is not None
    lattice = texture.lattice.reduced()
    return replace(texture, image=quantize(texture.image)), lattice, MeanTile.of(texture.ideal, lattice)


def errors(found: FollowedImage, texture: Texture, lattice: Lattice) -> Points:
    """Return how far each displacement that was found is off, in s, up to one lattice vector for all."""
    x, y = np.moveaxis(found.nodes, -1, 0)
    truth = np.zeros((SIDE, SIDE, 2)) if texture.displacement is None else texture.displacement
    true = np.stack([map_coordinates(plane, (y, x), order=1) for plane in np.moveaxis(truth, -1, 0)], -1)
    off = (found.displacement - true)[found.correlation > 0]
    middle = np.median(off, 0)
    return np.asarray(np.hypot(*(off - (middle - lattice.wrap(middle))).T) / lattice.s)


def found_share(found: FollowedImage, least: float = 0.0) -> float:
    """Return the share of the nodes at least half of s from the border at which the texture was found."""
    last = np.array(found.image.shape[1::-1]) - 1
    inner = ((found.nodes > 10) & (found.nodes < last - 10)).all(-1)
    return float((found.correlation[inner] > least).mean())


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name", MODELS)
def test_warps_of_bend_1_are_followed(name: str, seed: int) -> None:
    """The texture is found at 95 % of the nodes; half of the displacements are right to 0.03 s, 98 % to 0.15 s."""
    texture, lattice, tile = drawn(name, 1.0, seed)
    found = follow_texture(texture.image, tile)
    off = errors(found, texture, lattice)
    assert found_share(found) > 0.95
    assert np.median(off) < 0.03 and (off < 0.15).mean() > 0.98


@pytest.mark.parametrize("name", MODELS)
def test_an_undisturbed_texture_has_no_displacements(name: str) -> None:
    """Without displacements 95 % of those found are zero to 0.03 s, those at the border to 0.1 s."""
    texture, lattice, tile = drawn(name, 0.0, 2)
    found = follow_texture(texture.image, tile)
    off = errors(found, texture, lattice)
    assert found_share(found, 0.8) == 1 and np.quantile(off, 0.95) < 0.03 and off.max() < 0.1


def test_the_phase_of_the_tile_need_not_fit() -> None:
    """A crop that starts elsewhere has the displacements of its place, moved by the crop's corner."""
    texture, lattice, tile = drawn("weave", 0.5, 3)
    corner = np.array([29.0, 17.0])
    whole, part = follow_texture(texture.image, tile), follow_texture(texture.image[17:, 29:], tile)
    x, y = np.moveaxis((part.nodes + corner) / whole.nodes[1, 1], -1, 0)
    same = np.stack([map_coordinates(plane, (y, x), order=3) for plane in np.moveaxis(whole.displacement, -1, 0)], -1)
    off = lattice.wrap((part.displacement + corner - same)[part.correlation > 0])
    assert found_share(part) > 0.95
    assert np.quantile(np.hypot(*off.T), 0.95) < 0.03 * lattice.s


def test_what_does_not_show_the_texture_is_not_found() -> None:
    """A gray square and noise count as not found; around the square the displacements are right."""
    texture, lattice, tile = drawn("hexagon", 0.5, 4)
    image = texture.image.copy()
    image[60:130, 60:130] = 0.5
    found = follow_texture(image, tile)
    inside = ((found.nodes > 80) & (found.nodes < 110)).all(-1)
    assert not (found.correlation[inside] > 0.6).any() and found_share(found, 0.6) > 0.75
    assert np.quantile(errors(found, texture, lattice), 0.9) < 0.1
    noise = np.random.default_rng(0).random((SIDE, SIDE, 3), np.float32)
    assert (follow_texture(noise, tile).correlation > 0.6).mean() < 0.05


@given(st.floats(0.3, 1.0), st.floats(0.0, 0.3))
@settings(max_examples=5)
def test_brightness_and_contrast_do_not_matter(contrast: float, brightness: float) -> None:
    """Displacements and correlations of a darker, fainter image are the same to 0.01 s."""
    texture, lattice, tile = drawn("weave", 0.5, 5)
    changed: Image = np.asarray(brightness + 0.7 * contrast * texture.image, np.float32)
    one, other = follow_texture(texture.image, tile), follow_texture(changed, tile)
    assert np.abs(lattice.wrap(one.displacement - other.displacement)).max() < 0.01 * lattice.s
    assert np.abs(one.correlation - other.correlation).max() < 0.01


def test_an_image_of_a_few_tiles_is_followed() -> None:
    """Of 48 x 44 px, about three cells a side, most is found; an image smaller than a window raises no error."""
    texture, _, tile = drawn("weave", 0.25, 6)
    assert found_share(follow_texture(texture.image[:44, :48], tile), 0.5) > 0.9
    assert np.isfinite(follow_texture(texture.image[:9, :8], tile).displacement).all()


@pytest.mark.parametrize("place", [(32.0, 30.0), (7.0, 58.0)])
def test_a_window_is_registered_with_an_affine_map(place: tuple[float, float]) -> None:
    """The place and the map of a pattern that is known as a formula are found, inside and at the border of an image."""

    def pattern(points: Points) -> Points:
        x, y = np.moveaxis(points, -1, 0)
        return np.asarray(np.sin(0.5 * x) + np.cos(0.4 * y) + 0.5 * np.sin(0.3 * x + 0.35 * y))

    x, y = np.meshgrid(np.arange(-9.0, 10.0), np.arange(-9.0, 10.0))
    offsets = np.stack([x, y], -1).reshape(-1, 2)
    weights = np.exp(-(offsets**2).sum(1) / 40)
    tiles = [pattern(offsets + np.array(step)) for step in ((0, 0), (0.01, 0), (-0.01, 0), (0, 0.01), (0, -0.01))]
    slopes = (tiles[1] - tiles[2]) / 0.02, (tiles[3] - tiles[4]) / 0.02
    values, across, down = (np.asarray(one[np.newaxis, :, np.newaxis], np.float32) for one in (tiles[0], *slopes))
    window = Window.of(offsets, weights / weights.sum(), (values, across, down), 20.0, 10.0)
    true = np.array([[1.08, 0.06], [-0.05, 0.95]])
    pixels = np.stack(np.meshgrid(np.arange(64.0), np.arange(64.0)), -1)
    image = np.asarray(pattern((pixels - place) @ np.linalg.inv(true).T)[..., np.newaxis], np.float32)
    state = np.array([place[0] + 0.8, place[1] - 0.9, 1.0, 0.0, 0.0, 1.0])
    assert window.register(image, 0, state) > 0.99
    assert np.abs(state[:2] - place).max() < 0.05 and np.abs(state[2:] - true.ravel()).max() < 0.02
