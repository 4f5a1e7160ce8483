"""Contact sheets hold every picture and every caption."""

import numpy as np
import pytest

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice
from nrbench.pictures.overlays import COLOR, break_lines, contact_sheet, draw_lattice, draw_overview, zoom_panels


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


def line_columns(picture: Image) -> list[int]:
    """Return the columns that are drawn in the full color of a lattice."""
    return np.flatnonzero((np.abs(picture - COLOR).max(-1) < 0.02).all(0)).tolist()


def test_panels_show_one_part_of_the_image() -> None:
    """Each panel shows the same part from the middle, enlarged by a whole factor, with the lines at their places."""
    image = np.zeros((90, 120, 1), np.float32)
    image[:, 3::10] = 0.5  # a line of the image at x = 3 + 10 k
    lattices = [Lattice((10.0, 0.0), (0.0, 10.0), (3.0, 0.0)), Lattice((20.0, 0.0), (0.0, 10.0), (3.0, 0.0))]
    first, second = zoom_panels(image, lattices, 240)
    factor, left = 4, (120 - 50) // 2  # five cells of 10 px
    assert first.shape == second.shape == (200, 200, 3)
    plain = zoom_panels(image, [Lattice((10.0, 0.0), (0.0, 10.0), (8.0, 5.0))], 240)[0]
    at = np.flatnonzero(np.abs(plain[2, :, 1] - 0.5) < 0.01)
    assert set((at // factor + left) % 10) == {3}
    for panel, step in ((first, 10), (second, 20)):
        drawn = np.flatnonzero(panel[12, :, 1] != np.where(np.isin(np.arange(200), at), 0.5, 0))
        places = (drawn + 0.5) / factor - 0.5 + left
        assert len(drawn) and np.abs((places - 3 + step / 2) % step - step / 2).max() < 0.5


def test_the_whole_image_is_scaled() -> None:
    """A large image is shrunk and a small one enlarged; lines whose cells would be too small are left out."""
    large = draw_overview(
        np.full((500, 1000, 3), 0.5, np.float32), Lattice((100.0, 0.0), (0.0, 1000.0), (49.5, 600.0)), 200
    )
    assert large.shape == (100, 200, 3) and np.abs(np.diff(line_columns(large)) - 20).max(initial=0) == 0
    assert draw_overview(np.full((30, 40, 1), 0.5, np.float32), None, 200).shape == (150, 200, 3)
    fine = draw_overview(np.full((1000, 1000, 3), 0.5, np.float32), Lattice((20.0, 0.0), (0.0, 20.0)), 200)
    np.testing.assert_allclose(fine, 0.5, atol=0.003)


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


def test_captions_are_broken_not_cut() -> None:
    """A long caption loses no letter: its lines end between words, or within a word that is wider than its column.

    A sheet with it is higher, and its picture lies below its last line.
    """
    text = "quality at most 0.61, rank 1-4\ncannot tell: integrity; no peril: randomness\n" + "x" * 30
    lines = break_lines(text, lambda line: len(line) <= 16)
    assert max(map(len, lines)) <= 16 and lines[:3] == ["quality at most", "0.61, rank 1-4", "cannot tell:"]
    assert "".join(lines).replace(" ", "") == "".join(text.split())
    assert break_lines("", lambda line: False) == [""] and break_lines("abc", lambda line: False) == list("abc")
    assert break_lines("e\u0301", lambda line: True) == ["\u00e9"]
    picture = np.zeros((20, 40, 3), np.float32)
    short, long = (contact_sheet([picture], [caption], letters=15) for caption in ("a", text))
    assert long.shape[0] >= short.shape[0] + 4 * 19 and long.shape[1] == short.shape[1]
    assert (long[-28:-8, 8:48] == 0).all()
