"""Contact sheets hold every picture and every caption."""

from __future__ import annotations

import numpy as np
import pytest

from nrbench.imaging.drawing import COLOR, contact_sheet, draw_lattice
from nrbench.lattice.geometry import Lattice


@pytest.mark.parametrize("channels", [1, 3])
def test_lines_pass_through_the_lattice(channels: int) -> None:
    """Lines lie at their sub-pixel places: two neighbors share a line between them; pixels a px away are unchanged."""
    image = np.full((300, 40, channels), 0.5, np.float32)
    drawn = draw_lattice(image, Lattice((10.0, 0.0), (0.0, 400.0), (3.25, 350.0)))
    assert drawn.shape == (300, 40, 3) and (image == 0.5).all()
    share = (drawn[..., 0] - 0.5) / (COLOR[0] - 0.5)
    np.testing.assert_allclose(
        share[:, [2, 3, 4, 5, 13, 23]], np.tile([0, 0.75, 0.25, 0, 0.75, 0.75], (300, 1)), atol=1e-5
    )


def test_the_origin_moves_the_lines() -> None:
    """A lattice point on a pixel is drawn in full color, and so are all others at whole pixels."""
    drawn = draw_lattice(
        np.zeros((60, 60, 3), np.float32), Lattice((12.0, 4.0), (-4.0, 16.0), (7.0, 5.0)), (0.0, 1.0, 0.0)
    )
    for x, y in Lattice((12.0, 4.0), (-4.0, 16.0), (7.0, 5.0)).points((60, 60)).astype(int):
        np.testing.assert_allclose(drawn[y, x], (0, 1, 0), atol=1e-6)


def test_every_picture_is_there() -> None:
    """Pictures of any size and channels stand whole on the sheet, in rows, with something written above each."""
    pictures = [np.full((20 + i, 30, 3 if i % 2 else 1), 0.1 * (i + 1), np.float32) for i in range(5)]
    sheet = contact_sheet(pictures, [f"number {i}\nand more" for i in range(5)], columns=2)
    for picture in pictures:
        same = np.abs(sheet - picture.flat[0]).max(-1) < 0.003
        rows, columns = np.flatnonzero(same.any(1)), np.flatnonzero(same.any(0))
        assert same.sum() >= picture.shape[0] * picture.shape[1]
        above = sheet[rows[-1] - picture.shape[0] - 20 : rows[-1] - picture.shape[0], columns[0] : columns[0] + 40]
        assert above.min() < 0.3 and above.max() == 1


def test_long_captions_are_cut() -> None:
    """A caption never runs into the next column."""
    pictures = [np.ones((10, 10, 3), np.float32)] * 2
    sheet = contact_sheet(pictures, ["W" * 300, ""], columns=2)
    middle = sheet.shape[1] // 2
    assert sheet[:20, : middle - 8].min() < 0.5 and sheet[:20, middle + 4 :].min() == 1


@pytest.mark.parametrize("captions", [[], ["a"]])
def test_as_many_captions(captions: list[str]) -> None:
    """Nothing to show, and captions that do not match, are refused."""
    with pytest.raises(ValueError, match="as many of both"):
        contact_sheet([np.ones((10, 10, 3), np.float32)] * 2 * bool(captions), captions)
