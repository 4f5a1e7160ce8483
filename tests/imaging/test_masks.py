"""Tests of images of which some pixels do not count."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest

from nrbench import BadInput
from nrbench.api.arguments import masked_in
from nrbench.imaging.masks import as_mask, as_masked, known_at

COLORS = np.random.default_rng(4).integers(0, 255, (20, 30, 3), np.uint8)
HOLE = np.zeros((20, 30), bool)
HOLE[5:12, 8:20] = True


def _palette() -> PIL.Image.Image:
    pixels = np.where(HOLE, 3, COLORS[..., 0] % 3).astype(np.uint8)
    picture = PIL.Image.fromarray(pixels)
    picture.putpalette([250, 0, 0, 0, 250, 0, 0, 0, 250, 9, 9, 9])
    picture.info["transparency"] = 3
    return picture


def _alpha(mode: str) -> PIL.Image.Image:
    picture = PIL.Image.fromarray(COLORS).convert(mode)
    picture.putalpha(PIL.Image.fromarray(np.where(HOLE, 0, 255).astype(np.uint8)))
    return picture


KINDS: dict[str, Callable[[], PIL.Image.Image]] = {
    "color with alpha": lambda: _alpha("RGB"),
    "gray with alpha": lambda: _alpha("L"),
    "palette": _palette,
}


@pytest.mark.parametrize("kind", KINDS)
def test_transparent_pixels_do_not_count(tmp_path: Path, kind: str) -> None:
    """Of any kind of picture, the transparent pixels do not count, and have the color of the nearest one that does."""
    KINDS[kind]().save(tmp_path / "a.png")
    image, known = masked_in(tmp_path / "a.png")
    assert known is not None and np.array_equal(known, ~HOLE)
    assert image.shape[2] == (1 if kind == "gray with alpha" else 3)
    np.testing.assert_array_equal(image[5, 12:16], image[4, 12:16])
    np.testing.assert_array_equal(image[11, 12:16], image[12, 12:16])


def test_soft_edges_do_not_count() -> None:
    """Only pixels that are opaque to within 2 % count; an image that is opaque so everywhere has no mask."""
    alpha = np.full((20, 30), 255, np.uint8)
    alpha[5], alpha[6] = 251, 248
    known = as_masked(np.dstack([COLORS, alpha])).known
    assert known is not None and not known[6].any() and known.sum() == 19 * 30
    assert as_masked(np.dstack([COLORS, np.maximum(alpha, 250)])).known is None


@pytest.mark.parametrize("kind", ["bool", "0 and 1", "bytes", "floats", "color", "alpha", "file"])
def test_masks_of_any_kind(tmp_path: Path, kind: str) -> None:
    """White, True, 1 or opaque white counts; so does what is nearly white, as in a JPEG."""
    white = np.where(HOLE, 0, 253).astype(np.uint8)
    PIL.Image.fromarray(white).save(tmp_path / "mask.png")
    masks: dict[str, Any] = {
        "bool": ~HOLE,
        "0 and 1": (~HOLE).astype(int),
        "bytes": white,
        "floats": white / 255,
        "color": np.repeat(white[..., np.newaxis], 3, 2),
        "alpha": np.dstack([np.full_like(white, 255), white]),
        "file": tmp_path / "mask.png",
    }
    known = masked_in(COLORS, masks[kind]).known
    assert known is not None and np.array_equal(known, ~HOLE)


def test_a_mask_and_transparent_pixels_are_both_left_out() -> None:
    """A pixel counts if it is opaque and white in the mask; a mask that leaves out nothing is none."""
    mask = np.ones((20, 30), bool)
    mask[:, :3] = False
    known = masked_in(_as_array(), mask).known
    assert known is not None and np.array_equal(known, mask & ~HOLE)
    assert masked_in(COLORS, np.ones((20, 30))).known is None


def _as_array() -> np.ndarray[Any, Any]:
    return np.dstack([COLORS, np.where(HOLE, 0, 255).astype(np.uint8)])


@pytest.mark.parametrize(
    ("image", "mask", "message"),
    [
        (COLORS, np.ones((30, 20)), r"mask: is 20x30 px, the picture 30x20; make a mask of the same size"),
        (COLORS, np.zeros((20, 30)), "mask: leaves no pixel that counts; white counts, and black is left out"),
        (_as_array(), HOLE, "mask: leaves no pixel that counts"),
        (np.dstack([COLORS, np.zeros((20, 30), np.uint8)]), None, "image: has no opaque pixel"),
    ],
)
def test_what_leaves_nothing_is_refused(image: Any, mask: Any, message: str) -> None:
    """A mask of another size, one that leaves nothing, and a picture that shows nothing: one clear error."""
    with pytest.raises(BadInput, match=message):
        masked_in(image, mask)


def test_interpolated_values_count_away_from_the_hole() -> None:
    """A value that is interpolated counts if no pixel within 2 px of it was left out."""
    points = np.array([[5.4, 8.0], [5.6, 8.0], [21.4, 8.0], [21.6, 8.0], [0.0, 0.0], [29.0, 19.0]])
    assert known_at(as_mask(~HOLE, HOLE.shape), points).tolist() == [True, False, False, True, True, True]
