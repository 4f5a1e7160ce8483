"""Claims about reading and writing pictures."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import BinaryIO

import numpy as np
import PIL.Image
import pytest
import skimage.io

from nrbench.errors import BadInput
from nrbench.imaging.convert import quantize
from nrbench.pictures.files import read_image, write_image

RAMP = np.arange(16 * 12, dtype=np.uint8).reshape(12, 16)


def _saved(folder: Path, picture: PIL.Image.Image, name: str = "picture.png", **options: object) -> Path:
    path = folder / name
    picture.save(path, **options)  # type: ignore[arg-type]
    return path


def _refusal(path: Path) -> str:
    with pytest.raises(BadInput) as caught:
        read_image(path)
    message = str(caught.value)
    assert str(path) in message and "\n" not in message
    return message


@pytest.mark.parametrize("channels", [1, 3])
def test_png_round_trip(tmp_path: Path, channels: int) -> None:
    """What is written replaces the old file, reads back rounded to 8 bits, and says that its values are sRGB."""
    image = np.random.default_rng(0).random((9, 14, channels)).astype(np.float32)
    path = write_image(tmp_path / "out.png", 1 - image)
    assert write_image(path, image) == path
    np.testing.assert_array_equal(read_image(path), quantize(image))
    assert [item.name for item in tmp_path.iterdir()] == ["out.png"]
    with PIL.Image.open(path) as opened:
        assert opened.info["srgb"] == 0


def test_interrupted_write_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A write that fails half-way leaves the old picture whole, and no part beside it."""
    path = write_image(tmp_path / "out.png", np.zeros((8, 8, 3), np.float32))

    def fail(self: PIL.Image.Image, target: BinaryIO, *_: object, **__: object) -> None:
        target.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(PIL.Image.Image, "save", fail)
    with pytest.raises(BadInput, match="No space left on device"):
        write_image(path, np.ones((8, 8, 3), np.float32))
    assert [item.name for item in tmp_path.iterdir()] == ["out.png"]
    assert not read_image(path).any()


@pytest.mark.parametrize(("name", "hint"), [("out.jpg", "PNG"), ("none/out.png", "check its folder")])
def test_write_refusals(tmp_path: Path, name: str, hint: str) -> None:
    """Another ending and a missing folder are refused with what to do."""
    with pytest.raises(BadInput, match=hint):
        write_image(tmp_path / name, np.zeros((8, 8, 1), np.float32))


@pytest.mark.parametrize(("name", "order"), [("a.png", "<"), ("a.tif", "<"), ("a.tif", ">")])
def test_sixteen_bits_in_either_byte_order(tmp_path: Path, name: str, order: str) -> None:
    """A 16-bit gray PNG or TIFF keeps its 65536 levels."""
    wide = np.linspace(0, 65535, 16 * 12).astype(f"{order}u2").reshape(12, 16)
    image = read_image(_saved(tmp_path, PIL.Image.fromarray(wide), name))
    assert image.shape == (12, 16, 1)
    np.testing.assert_allclose(image[..., 0], wide / 65535, atol=1e-7)


@pytest.mark.parametrize(
    ("mode", "name", "atol"), [("1", "a.png", 0), ("P", "a.png", 1 / 255), ("CMYK", "a.jpg", 0.05)]
)
def test_other_modes_become_gray_or_color(tmp_path: Path, mode: str, name: str, atol: float) -> None:
    """Pixels of one bit read as 0 and 1, those of a palette and for the press as their colors."""
    plain = PIL.Image.new("L" if mode == "1" else "RGB", (16, 12), 255 if mode == "1" else (255, 0, 0))
    plain.paste(0, (0, 0, 8, 12))
    image = read_image(_saved(tmp_path, plain.convert(mode), name))
    due = np.asarray(plain).reshape(12, 16, -1) / 255
    np.testing.assert_allclose(image[[2, -3]][:, [2, -3]], due[[2, -3]][:, [2, -3]], atol=atol)


@pytest.mark.parametrize("turn", range(1, 9))
def test_every_exif_orientation(tmp_path: Path, turn: int) -> None:
    """All eight orientations that EXIF knows come in upright, from JPEG, PNG and TIFF."""
    upright = np.zeros((16, 24), np.uint8)
    upright[:8, :12] = 255
    undo = [np.asarray, np.fliplr, lambda a: np.rot90(a, 2), np.flipud, np.transpose, np.rot90]
    undo += [lambda a: np.rot90(a, 2).T, lambda a: np.rot90(a, -1)]
    stored = PIL.Image.fromarray(np.ascontiguousarray(undo[turn - 1](upright)))
    exif = PIL.Image.Exif()
    exif[0x0112] = turn
    for name, options in (
        ("a.jpg", {"exif": exif}),
        ("a.png", {"exif": exif}),
        ("a.tif", {"tiffinfo": {0x0112: turn}}),
    ):
        image = read_image(_saved(tmp_path, stored, name, **options))
        assert image.shape == (16, 24, 1)
        np.testing.assert_allclose(image[..., 0], upright / 255, atol=0.1)


@pytest.mark.parametrize(("mode", "name"), [("RGBA", "a.png"), ("LA", "a.png"), ("RGBA", "a.tif"), ("PA", "a.tif")])
def test_opaque_alpha_is_left_out(tmp_path: Path, mode: str, name: str) -> None:
    """A picture whose alpha is full everywhere reads as the picture without it."""
    plain = PIL.Image.fromarray(RAMP).convert("L" if mode == "LA" else "P")
    image = read_image(_saved(tmp_path, plain.convert(mode), name))
    assert image.shape == (12, 16, 1 if mode == "LA" else 3)
    np.testing.assert_allclose(image[..., 0], RAMP / 255, atol=1e-6)


@pytest.mark.parametrize("mode", ["RGBA", "LA"])
def test_transparent_pixels_are_refused(tmp_path: Path, mode: str) -> None:
    """One transparent pixel is enough; the message says where it is and what to do."""
    picture = PIL.Image.new(mode, (10, 12), (200,) * (len(mode) - 1) + (255,))
    picture.putpixel((3, 7), (200,) * (len(mode) - 1) + (254,))
    message = _refusal(_saved(tmp_path, picture))
    assert "1 transparent pixels, the first at (3, 7)" in message and "flatten" in message


@pytest.mark.parametrize("mode", ["1", "L", "P", "RGB", "I;16"])
def test_transparent_color(tmp_path: Path, mode: str) -> None:
    """A color that a PNG declares transparent is refused where a pixel has it, and does no harm otherwise."""
    picture = PIL.Image.fromarray(RAMP.astype(np.uint16)) if mode == "I;16" else PIL.Image.fromarray(RAMP).convert(mode)
    if mode == "1":
        picture = PIL.Image.new("1", (16, 12), 1)
    used, free = {"RGB": ((5, 5, 5), (9, 8, 7)), "1": (255, 0)}.get(mode, (5, 250))
    assert "transparent" in _refusal(_saved(tmp_path, picture, "used.png", transparency=used))
    without = read_image(_saved(tmp_path, picture, "without.png"))
    np.testing.assert_array_equal(read_image(_saved(tmp_path, picture, "free.png", transparency=free)), without)


def test_sixteen_bits_of_color(tmp_path: Path) -> None:
    """A TIFF of 16 bits a channel, in color and with opaque alpha, is rounded to 8 bits."""
    color = np.random.default_rng(0).integers(0, 65536, (12, 16, 3)).astype(np.uint16)
    opaque = np.dstack([color, np.full((12, 16), 65535, np.uint16)])
    for pixels in (color, opaque):
        skimage.io.imsave(tmp_path / "a.tif", pixels)
        np.testing.assert_allclose(read_image(tmp_path / "a.tif"), color / 65535, atol=1 / 255)


NOT_READ = {
    "text.png": (b"hello, I am no picture", "no picture that can be read"),
    "page.png": (b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 32 32\n%%EndComments\nshowpage\n", "is no picture"),
    "empty.png": (b"", "0 bytes"),
    "folder": (None, "is a directory"),
    "missing.png": (None, "no such file"),
}


@pytest.mark.parametrize("name", NOT_READ)
def test_files_that_are_no_picture(tmp_path: Path, name: str) -> None:
    """Text, PostScript, an empty file, a directory and a missing file have messages with a remedy."""
    content, hint = NOT_READ[name]
    if content is not None:
        (tmp_path / name).write_bytes(content)
    elif name == "folder":
        (tmp_path / name).mkdir()
    assert hint in _refusal(tmp_path / name)


def test_pictures_that_are_cut_short_small_or_of_floats(tmp_path: Path) -> None:
    """A PNG that ends half-way, a picture of 4 px a side and one of float pixels are refused, each with a remedy."""
    noise = np.random.default_rng(0).integers(0, 256, (64, 64), np.uint8)
    path = _saved(tmp_path, PIL.Image.fromarray(noise))
    path.write_bytes(path.read_bytes()[:2000])
    assert "save it again" in _refusal(path)
    assert "at least 8 px" in _refusal(_saved(tmp_path, PIL.Image.new("L", (4, 4)), "small.png"))
    assert "8 or 16 bits" in _refusal(_saved(tmp_path, PIL.Image.new("F", (10, 10)), "floats.tiff"))


@pytest.mark.parametrize("kind", ["gif", "tiff"])
def test_the_first_of_several_frames_is_read_with_a_warning(tmp_path: Path, kind: str) -> None:
    """A file of two frames gives its first one and a warning; a file of one frame gives none."""
    frames = [PIL.Image.new("RGB", (16, 16), color) for color in ("red", "blue")]
    frames[0].save(tmp_path / f"two.{kind}", save_all=True, append_images=frames[1:])
    frames[0].save(tmp_path / f"one.{kind}")
    with pytest.warns(UserWarning, match="two.*has several frames; the first one is read"):
        first = read_image(tmp_path / f"two.{kind}")
    with warnings.catch_warnings(action="error"):
        assert np.array_equal(first, read_image(tmp_path / f"one.{kind}"))
