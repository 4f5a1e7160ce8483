"""Claims about reading and writing pictures."""

import contextlib
import struct
import warnings
from pathlib import Path
from typing import BinaryIO

import numpy as np
import PIL.Image
import pytest
import tifffile

from nrbench.errors import BadInput
from nrbench.imaging.convert import depth_of, quantize
from nrbench.pictures.files import list_pictures, read_image, write_image

RAMP = np.arange(16 * 12, dtype=np.uint8).reshape(12, 16)


def _saved(folder: Path, picture: PIL.Image.Image, name: str = "picture.png", **options: object) -> Path:
    path = folder / name
    picture.save(path, **options)
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

    def fail(target: BinaryIO, *_: object) -> None:
        target.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(PIL.PngImagePlugin, "putchunk", fail)
    with pytest.raises(BadInput, match="No space left on device"):
        write_image(path, np.ones((8, 8, 3), np.float32))
    assert [item.name for item in tmp_path.iterdir()] == ["out.png"]
    assert not read_image(path).any()


@pytest.mark.parametrize(("name", "hint"), [("out.jpg", "PNG, TIFF and WebP"), ("none/out.png", "check its folder")])
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
    options = {"exif": exif, "tiffinfo": {0x0112: turn}}
    for name in ("a.jpg", "a.png", "a.tif"):
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
    picture.putpixel((3, 7), (200,) * (len(mode) - 1) + (249,))
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


WIDE = {
    "plain.tif": {},
    "big-endian.tif": {"byteorder": ">"},
    "deflated.tif": {"compression": "zlib", "predictor": True},
    "tiled.tif": {"tile": (16, 16)},
    "planes.tif": {"planarconfig": "separate"},
    "packed-planes.tif": {"planarconfig": "separate", "compression": "zlib"},
    "opaque.tif": {"extrasamples": ["unassalpha"]},
    "turned.tif": {"extratags": [(274, 3, 1, 6, True)]},
    "color.png": None,
}


@pytest.mark.parametrize("name", WIDE)
def test_sixteen_bits_of_color(tmp_path: Path, name: str) -> None:
    """Color of 16 bits a channel is read exactly: PNG, and TIFF of any layout, also with opaque alpha."""
    color = np.random.default_rng(0).integers(0, 65536, (20, 36, 3)).astype(np.uint16)
    due, options = np.asarray(color / np.float32(65535), np.float32), WIDE[name]
    if options is None:
        write_image(tmp_path / name, due)
    else:
        stored = np.dstack([color, np.full((20, 36), 65535, np.uint16)]) if "extrasamples" in options else color
        stored = np.moveaxis(stored, -1, 0) if "planarconfig" in options else stored
        tifffile.imwrite(tmp_path / name, stored, photometric="rgb", **options)
    due = np.rot90(due, -1) if name == "turned.tif" else due
    np.testing.assert_array_equal(read_image(tmp_path / name), due)


@pytest.mark.parametrize("ending", ["png", "tif", "webp"])
@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("channels", [1, 3])
def test_what_is_read_is_written(tmp_path: Path, ending: str, bits: int, channels: int) -> None:
    """The values of a file of 8 or 16 bits survive PNG and TIFF; WebP has 8 bits, and a warning says what it loses."""
    image = quantize(np.random.default_rng(0).random((16, 24, channels), np.float32), bits)
    assert depth_of(image) == bits
    path = tmp_path / f"a.{ending}"
    rounded = (ending, bits) == ("webp", 16)
    with pytest.warns(UserWarning, match="WebP has 8 bits a channel") if rounded else contextlib.nullcontext():
        write_image(path, image)
    image = quantize(image) if rounded else image
    with warnings.catch_warnings(action="error"):
        again = read_image(path)
    np.testing.assert_array_equal(again, np.repeat(image, 3, 2) if (ending, channels) == ("webp", 1) else image)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("bits", [8, 16])
def test_views_and_long_pictures_are_written(tmp_path: Path, bits: int, channels: int) -> None:
    """A transposed view of more rows than are written at a time is read back by this reader and by Pillow."""
    levels = np.random.default_rng(0).integers(0, 2**bits, (9, 1100, channels)).astype(f"u{bits // 8}")
    path = write_image(tmp_path / "a.png", levels.transpose(1, 0, 2))
    np.testing.assert_allclose(read_image(path), levels.transpose(1, 0, 2) / (2**bits - 1), atol=1e-7)
    with PIL.Image.open(path) as opened:
        assert np.asarray(opened).shape[:2] == (1100, 9)


def test_values_of_no_file_are_written_with_8_bits(tmp_path: Path) -> None:
    """Values that neither 8 nor 16 bits hold exactly, such as those of a drawing, are rounded to 8 bits."""
    image = np.random.default_rng(0).random((16, 24, 3), np.float32)
    np.testing.assert_array_equal(read_image(write_image(tmp_path / "a.png", image)), quantize(image))


@pytest.mark.parametrize("dtype", ["u1", "<u2", ">u2"])
@pytest.mark.parametrize("channels", [(), (1,), (3,)])
def test_arrays_of_whole_numbers_are_written(tmp_path: Path, dtype: str, channels: tuple[int, ...]) -> None:
    """``uint8`` and ``uint16`` of any order of bytes, with or without an axis of channels, are images."""
    pixels = (RAMP.reshape(*RAMP.shape, *(1,) * len(channels)) * np.ones(channels)).astype(dtype)
    again = read_image(write_image(tmp_path / "a.png", pixels))
    peak = 255 if dtype == "u1" else 65535
    np.testing.assert_allclose(again, (pixels if channels else pixels[..., np.newaxis]) / peak, atol=1e-7)


@pytest.mark.parametrize("bits", [8, 16])
def test_gray_tiff_with_alpha_stays_gray(tmp_path: Path, bits: int) -> None:
    """A TIFF of gray with opaque alpha has one channel; a transparent pixel is refused."""
    pixels = np.dstack([RAMP.astype(f"u{bits // 8}") * (1 if bits == 8 else 257), np.full((12, 16), 2**bits - 1)])
    options = {"photometric": "minisblack", "extrasamples": ["unassalpha"], "planarconfig": "contig"}
    tifffile.imwrite(tmp_path / "a.tif", pixels.astype(f"u{bits // 8}"), **options)
    np.testing.assert_allclose(read_image(tmp_path / "a.tif"), RAMP[..., np.newaxis] / 255, atol=1e-6)
    pixels[3, 4, 1] = 0
    tifffile.imwrite(tmp_path / "a.tif", pixels.astype(f"u{bits // 8}"), **options)
    assert "1 transparent pixels, the first at (4, 3)" in _refusal(tmp_path / "a.tif")


@pytest.mark.parametrize("depth", [8, 12, 16])
def test_little_of_the_scale_is_named(tmp_path: Path, depth: int) -> None:
    """A picture that uses under a quarter of its scale brings a warning with its range, also if one pixel is white."""
    values = np.random.default_rng(0).random((64, 64)) * (2**12 if depth == 12 else 2**depth / 5)
    pixels = (values + 100).astype(np.uint8 if depth == 8 else np.uint16)
    pixels[5, 5] = np.iinfo(pixels.dtype).max
    low, high = (f"{each / np.iinfo(pixels.dtype).max:.2f}" for each in np.quantile(pixels, (0.001, 0.999)))
    with pytest.warns(UserWarning, match=rf"a\.png: uses only {low}\d to {high}\d of its scale") as caught:
        read_image(_saved(tmp_path, PIL.Image.fromarray(pixels), "a.png"))
    assert len(caught) == 1
    wide = RAMP.astype(pixels.dtype) * pixels.dtype.type(1 if depth == 8 else 257)
    with warnings.catch_warnings(action="error"):
        read_image(_saved(tmp_path, PIL.Image.fromarray(wide), "b.png"))


NOT_READ = {
    "text.png": (b"hello, I am no picture", "no picture that can be read"),
    "page.png": (b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 32 32\n%%EndComments\nshowpage\n", "is no picture"),
    "wall.heic": (b"\0\0\0\x18ftypheic\0\0\0\0mif1heic" + bytes(32), "is HEIC|cannot be read"),
    "wall.exr": (b"v/1\x01" + bytes(32), "OpenEXR"),
    "wall.jxl": (b"\xff\n" + bytes(32), "JPEG XL"),
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
    message = _refusal(tmp_path / name)
    assert any(each in message for each in hint.split("|"))


def test_pictures_that_are_cut_short_small_or_out_of_range(tmp_path: Path) -> None:
    """A PNG that ends half-way, a picture of 4 px a side, and floats outside [0, 1] are refused, each with a remedy."""
    noise = np.random.default_rng(0).integers(0, 256, (64, 64), np.uint8)
    path = _saved(tmp_path, PIL.Image.fromarray(noise))
    path.write_bytes(path.read_bytes()[:2000])
    assert "save it again" in _refusal(path)
    assert "at least 8 px" in _refusal(_saved(tmp_path, PIL.Image.new("L", (4, 4)), "small.png"))
    for pixels in (noise / 63, np.stack([noise / 100] * 3, -1), np.where(noise > 9, np.nan, noise / 255)):
        photometric = "rgb" if pixels.ndim == 3 else 1
        tifffile.imwrite(tmp_path / "floats.tif", pixels.astype(np.float32), photometric=photometric)
        assert "[0, 1]" in (message := _refusal(tmp_path / "floats.tif")) or "NaN" in message


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


def test_a_folder_names_what_it_skips(tmp_path: Path) -> None:
    """The pictures of a folder have any ending of a format that is read; other files are counted and named once."""
    names = ["a.PNG", "b.heic", "c.avif", "d.jp2", "e.gif", "f.tga"]
    for name in (*names, "truth.csv", ".hidden.psd", "Thumbs.db"):
        (tmp_path / name).touch()
    with warnings.catch_warnings(action="error"):
        assert [path.name for path in list_pictures(tmp_path)] == names
    for name in ("g.psd", "h.exr"):
        (tmp_path / name).touch()
    with pytest.warns(UserWarning, match=r"files skipped, .*: 2 \(g\.psd, h\.exr\)$") as caught:
        assert len(list_pictures(tmp_path)) == 6
    assert len(caught) == 1


def test_heic(tmp_path: Path) -> None:
    """With pillow-heif a HEIC is read, and its profile counts."""
    pillow_heif = pytest.importorskip("pillow_heif")
    picture = PIL.Image.new("RGB", (64, 48), (200, 120, 80))
    picture.paste((20, 40, 60), (0, 0, 32, 48))
    pillow_heif.register_heif_opener()
    image = read_image(_saved(tmp_path, picture, "a.heic", quality=-1, chroma=444))
    np.testing.assert_allclose(image, np.asarray(picture) / 255, atol=4 / 255)
    wide = (np.asarray(picture) * np.uint16(257)).tobytes()
    pillow_heif.from_bytes("RGB;16", picture.size, wide).save(tmp_path / "b.heic", quality=-1, chroma=444)
    with pytest.warns(UserWarning, match="more than 8 bits a channel"):
        np.testing.assert_allclose(read_image(tmp_path / "b.heic"), image, atol=4 / 255)


def test_twelve_bits_fill_the_scale(tmp_path: Path) -> None:
    """A TIFF that packs 12 bits a pixel has its white at 4095; color of 16 bits in a PPM is rounded, with a warning."""
    values = np.linspace(0, 4095, 12 * 16).astype(np.uint16).reshape(12, 16)
    bits = np.unpackbits(values.astype(">u2").view(np.uint8).reshape(12, 16, 2), axis=2)[..., 4:]
    rows = np.packbits(bits.reshape(12, -1), axis=1)
    tags = {256: 16, 257: 12, 258: 12, 259: 1, 262: 1, 273: 8, 277: 1, 278: 12, 279: rows.size}
    table = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in sorted(tags.items()))
    content = b"II*\0" + struct.pack("<I", 8 + rows.size) + rows.tobytes() + struct.pack("<H", len(tags)) + table
    (tmp_path / "a.tif").write_bytes(content + bytes(4))
    np.testing.assert_allclose(read_image(tmp_path / "a.tif")[..., 0], values / 4095, atol=1e-5)
    color = np.random.default_rng(0).integers(0, 65536, (12, 16, 3)).astype(">u2")
    (tmp_path / "a.ppm").write_bytes(b"P6\n16 12\n65535\n" + color.tobytes())
    with pytest.warns(UserWarning, match="more than 8 bits a channel"):
        np.testing.assert_allclose(read_image(tmp_path / "a.ppm"), color / 65535, atol=1 / 255)
