"""Claims about colors: what a file says of its values is converted to sRGB, or named."""

import io
import struct
import warnings
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import PIL.ImageCms
import PIL.PngImagePlugin
import pytest
import tifffile
from numpy.typing import NDArray

import nrbench
from nrbench.pictures.files import read_image

SRGB_PROFILE = PIL.ImageCms.ImageCmsProfile(PIL.ImageCms.createProfile("sRGB")).tobytes()
Y, X = np.mgrid[:24, :32] / 32
COLORS = np.stack([0.25 + 0.5 * X + 0.05 * Y, 0.3 + 0.4 * Y + 0.03 * X, 0.65 - 0.3 * X * Y], -1)
"""sRGB, inside all spaces of these tests."""
GRAYS = COLORS[..., :1]
# From linear sRGB, as published: W3C, CSS Color 4; Adobe RGB (1998); ITU-R BT.2087.
TO_P3 = np.array([[0.8224620, 0.1775380, 0], [0.0331941, 0.9668058, 0], [0.0170827, 0.0723974, 0.9105199]])
TO_ADOBE = np.array([[0.7151256, 0.2848744, 0], [0, 1, 0], [0, 0.0411619, 0.9588381]])
TO_2020 = np.array(
    [[0.6274039, 0.3292830, 0.0433131], [0.0690973, 0.9195404, 0.0113623], [0.0163914, 0.0880133, 0.8955953]]
)
ADOBE_XY = 0.3127, 0.3290, 0.64, 0.33, 0.21, 0.71, 0.15, 0.06
LAB_PROFILE = PIL.ImageCms.ImageCmsProfile(PIL.ImageCms.createProfile("LAB")).tobytes()


def _linear(values: NDArray[Any]) -> NDArray[Any]:
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def _srgb_curve(light: NDArray[Any]) -> NDArray[Any]:
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def _pq(light: NDArray[Any]) -> NDArray[Any]:
    """Return SMPTE ST 2084 values of linear light, 1 for 203 cd/m2."""
    power = (light * 203 / 10000) ** 0.1593017578125
    return ((0.8359375 + 18.8515625 * power) / (1 + 18.6875 * power)) ** 78.84375


def _chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def png(values: NDArray[Any], *chunks: tuple[bytes, bytes], bits: int = 8) -> bytes:
    """Return a PNG file of values in [0, 1], ``(H, W, C)``, with some chunks."""
    height, width, channels = values.shape
    pixels = np.rint(values * (2**bits - 1)).astype(">u2" if bits == 16 else np.uint8).reshape(height, -1)
    lines = b"".join(b"\0" + row.tobytes() for row in pixels)
    header = struct.pack(">IIBBBBB", width, height, bits, (0, 0, 4, 2, 6)[channels], 0, 0, 0)
    parts = [(b"IHDR", header), *chunks, (b"IDAT", zlib.compress(lines)), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(*part) for part in parts)


def _icc(profile: bytes) -> tuple[bytes, bytes]:
    return b"iCCP", b"space\0\0" + zlib.compress(profile)


def profile_of(matrix: NDArray[Any] | None, *curves: bytes) -> bytes:
    """Return an ICC profile of version 2: gray without a matrix, else with the matrix from linear sRGB to its RGB."""

    def xyz(column: NDArray[Any]) -> bytes:
        return b"XYZ \0\0\0\0" + np.rint(column * 65536).astype(">i4").tobytes()

    d50 = np.array([[0.43607, 0.38515, 0.14307], [0.22249, 0.71687, 0.06061], [0.01392, 0.09708, 0.71410]])
    tags = {b"desc": b"desc\0\0\0\0" + struct.pack(">I", 5) + b"test\0" + bytes(79), b"wtpt": xyz(d50.sum(1))}
    if matrix is None:
        tags[b"kTRC"] = curves[0]
    else:
        columns = (d50 @ np.linalg.inv(matrix)).T
        for name, column, curve in zip((b"r", b"g", b"b"), columns, (curves * 3)[:3], strict=True):
            tags |= {name + b"XYZ": xyz(column), name + b"TRC": curve}
    table, body, start = b"", b"", 132 + 12 * len(tags)
    for name, data in tags.items():
        data += bytes(-len(data) % 4)
        table += name + struct.pack(">II", start + len(body), len(data))
        body += data
    head = bytearray(128)
    kind = b"GRAY" if matrix is None else b"RGB "
    struct.pack_into(">I4sI4s4s4s", head, 0, start + len(body), b"", 0x02400000, b"mntr", kind, b"XYZ ")
    head[36:40] = b"acsp"
    head[68:80] = np.rint(d50.sum(1) * 65536).astype(">i4").tobytes()
    return bytes(head) + struct.pack(">I", len(tags)) + table + body


def _gamma(power: float) -> bytes:
    return b"curv\0\0\0\0" + struct.pack(">IH", 1, round(power * 256))


LINEAR_CURVE = b"curv\0\0\0\0\0\0\0\0"
TABLE = (
    b"curv\0\0\0\0"
    + struct.pack(">I", 1024)
    + np.rint(_linear(np.linspace(0, 1, 1024)) * 65535).astype(">u2").tobytes()
)
PARAMETRIC = (
    b"para\0\0\0\0\0\3\0\0"
    + np.rint(np.array([2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045]) * 65536).astype(">i4").tobytes()
)

LIGHT = _linear(COLORS)
SPACES = {
    "icc of display p3, parametric": (_srgb_curve(LIGHT @ TO_P3.T), _icc(profile_of(TO_P3, PARAMETRIC))),
    "icc of display p3, table": (_srgb_curve(LIGHT @ TO_P3.T), _icc(profile_of(TO_P3, TABLE))),
    "icc of adobe rgb": ((LIGHT @ TO_ADOBE.T) ** (256 / 563), _icc(profile_of(TO_ADOBE, _gamma(563 / 256)))),
    "icc of linear light": (LIGHT, _icc(profile_of(np.eye(3), LINEAR_CURVE))),
    "gAMA 1": (LIGHT, (b"gAMA", struct.pack(">I", 100000))),
    "cICP of display p3": (_srgb_curve(LIGHT @ TO_P3.T), (b"cICP", bytes([12, 13, 0, 1]))),
    "cICP of linear light": (LIGHT, (b"cICP", bytes([1, 8, 0, 1]))),
    "cICP of BT.2020 and PQ": (_pq(LIGHT @ TO_2020.T), (b"cICP", bytes([9, 16, 0, 1]))),
}


def _read(path: Path, content: bytes) -> NDArray[Any]:
    """Return a picture that is read without a warning."""
    path.write_bytes(content)
    with warnings.catch_warnings(action="error"):
        return read_image(path)


@pytest.mark.parametrize("name", SPACES)
def test_png_becomes_srgb(tmp_path: Path, name: str) -> None:
    """A PNG in another color space reads as the sRGB picture from which it was made, of 8 bits or of 16."""
    values, chunk = SPACES[name]
    steps = 5 if name.endswith("PQ") or "linear" in name or name == "gAMA 1" else 2
    np.testing.assert_allclose(_read(tmp_path / "a.png", png(values, chunk)), COLORS, atol=1.1 * steps / 255)
    wide = _read(tmp_path / "b.png", png(values, chunk, bits=16))
    np.testing.assert_allclose(wide, COLORS, atol=2e-4)
    assert len(np.unique(wide)) > 700


def test_gamma_with_primaries(tmp_path: Path) -> None:
    """The chunks gAMA and cHRM together describe a space, here Adobe RGB."""
    primaries = struct.pack(">8I", *(round(1e5 * each) for each in ADOBE_XY))
    chunks = (b"gAMA", struct.pack(">I", 45471)), (b"cHRM", primaries)
    values = (LIGHT @ TO_ADOBE.T) ** 0.45471
    np.testing.assert_allclose(_read(tmp_path / "a.png", png(values, *chunks, bits=16)), COLORS, atol=2e-4)


def test_curves_that_differ_by_channel(tmp_path: Path) -> None:
    """A profile without one curve for all channels is applied, to 8 bits; a file of 16 bits brings a warning."""
    light = LIGHT @ TO_P3.T
    values = np.stack([light[..., i] ** (1 / power) for i, power in enumerate((2.0, 2.2, 1.8))], -1)
    chunk = _icc(profile_of(TO_P3, _gamma(2), _gamma(2.2), _gamma(1.8)))
    np.testing.assert_allclose(_read(tmp_path / "a.png", png(values, chunk)), COLORS, atol=3.1 / 255)
    (tmp_path / "b.png").write_bytes(png(values, chunk, bits=16))
    with pytest.warns(UserWarning, match="more than 8 bits a channel, which are rounded to 8"):
        np.testing.assert_allclose(read_image(tmp_path / "b.png"), COLORS, atol=3.1 / 255)


def test_agrees_with_the_color_management_of_pillow(tmp_path: Path) -> None:
    """Our own conversion by a curve and a matrix equals that of LittleCMS to one level."""
    profile = profile_of(TO_P3, PARAMETRIC)
    picture = PIL.Image.fromarray(np.random.default_rng(0).integers(60, 190, (24, 32, 3), np.uint8))
    given = PIL.ImageCms.ImageCmsProfile(io.BytesIO(profile))
    theirs = PIL.ImageCms.profileToProfile(picture, given, PIL.ImageCms.createProfile("sRGB"))
    picture.save(tmp_path / "a.png", icc_profile=profile)
    np.testing.assert_allclose(read_image(tmp_path / "a.png"), np.asarray(theirs) / 255, atol=1.01 / 255)


@pytest.mark.parametrize("how", ["tag", "DCF"])
def test_exif_of_adobe_rgb(tmp_path: Path, how: str) -> None:
    """EXIF names Adobe RGB by the color space 2, or by "uncalibrated" with the index R03 of cameras."""
    exif = PIL.Image.Exif()
    exif[0x0112] = 1
    exif.get_ifd(0x8769)[0xA001] = 2 if how == "tag" else 65535
    if how == "DCF":
        exif.get_ifd(0x8769)[0xA005] = {1: "R03"}
    values = np.rint(255 * (LIGHT @ TO_ADOBE.T) ** (256 / 563)).astype(np.uint8)
    for ending in ("webp", "png"):
        PIL.Image.fromarray(values).save(tmp_path / f"a.{ending}", exif=exif, lossless=True)
        np.testing.assert_allclose(_read(path := tmp_path / f"a.{ending}", path.read_bytes()), COLORS, atol=2.1 / 255)


@pytest.mark.parametrize("layout", ["contiguous", "planes", "turned"])
def test_floats_are_linear_light(tmp_path: Path, layout: str) -> None:
    """A TIFF of floats, in color or gray, is read as linear light, with a warning that says so; 16 bits remain."""
    for light in (LIGHT, LIGHT[..., 0]):
        options: dict[str, Any] = {"photometric": "rgb" if light.ndim == 3 else "minisblack"}
        stored, due = light, _srgb_curve(light).reshape(24, 32, -1)
        if layout == "planes" and light.ndim == 3:
            stored, options["planarconfig"] = np.moveaxis(light, -1, 0), "separate"
        if layout == "turned":
            options["extratags"], due = [(274, 3, 1, 6, True)], np.rot90(due, -1)
        tifffile.imwrite(tmp_path / "a.tif", stored.astype(np.float32), **options)
        with pytest.warns(UserWarning, match=r"a\.tif: float values without a profile are read as linear light"):
            np.testing.assert_allclose(read_image(tmp_path / "a.tif"), due, atol=2e-5)


def test_floats_with_a_profile(tmp_path: Path) -> None:
    """Floats with a profile have the meaning that it gives them, without a warning."""
    values = _srgb_curve(LIGHT @ TO_P3.T).astype(np.float32)
    profile = profile_of(TO_P3, PARAMETRIC)
    tifffile.imwrite(tmp_path / "a.tif", values, photometric="rgb", iccprofile=profile, compression="zlib")
    np.testing.assert_allclose(_read(tmp_path / "a.tif", (tmp_path / "a.tif").read_bytes()), COLORS, atol=2e-4)


@pytest.mark.parametrize("channels", [1, 2])
@pytest.mark.parametrize("bits", [8, 16])
def test_gray_stays_gray(tmp_path: Path, channels: int, bits: int) -> None:
    """Gray, with or without alpha, keeps one channel under a profile of gray or of color, and under gAMA."""
    alpha = [np.ones_like(GRAYS)] * (channels - 1)
    for curve, chunk in (
        (2.0, _icc(profile_of(None, _gamma(2)))),
        (2.0, _icc(profile_of(TO_P3, _gamma(2)))),
        (1.8, (b"gAMA", struct.pack(">I", 55556))),
        (1.0, _icc(profile_of(np.eye(3), _gamma(1), _gamma(1), LINEAR_CURVE))),
    ):
        values = np.dstack([_linear(GRAYS) ** (1 / curve), *alpha])
        with warnings.catch_warnings(action="ignore"):  # the last profile rounds 16 bits to 8
            (tmp_path / "a.png").write_bytes(png(values, chunk, bits=bits))
            image = read_image(tmp_path / "a.png")
        assert image.shape == (24, 32, 1)
        np.testing.assert_allclose(image, GRAYS, atol=(6.6 if curve == 1 else 1.1) / 255)


SAME = {
    "nothing": (),
    "sRGB chunk before gAMA": ((b"sRGB", b"\0"), (b"gAMA", struct.pack(">I", 100000))),
    "gAMA 1 / 2.2": ((b"gAMA", struct.pack(">I", 45455)),),
    "icc": (_icc(SRGB_PROFILE),),
    "cICP before icc": ((b"cICP", bytes([1, 13, 0, 1])), _icc(profile_of(TO_P3, TABLE))),
}


@pytest.mark.parametrize("name", SAME)
@pytest.mark.parametrize("bits", [8, 16])
def test_srgb_is_left_alone(tmp_path: Path, name: str, bits: int) -> None:
    """A file that says in whatever way that it is sRGB reads as its very values."""
    due = np.rint(COLORS * (2**bits - 1)) / np.float32(2**bits - 1)
    image = _read(tmp_path / "a.png", png(COLORS, *SAME[name], bits=bits))
    np.testing.assert_array_equal(image, due.astype(np.float32))


def test_profile_of_jpeg_2000(tmp_path: Path) -> None:
    """The profile in the header of a JPEG 2000 file counts, and that of L*a*b* pixels is no fault."""
    wide = np.rint(255 * SPACES["icc of display p3, table"][0]).astype(np.uint8)
    PIL.Image.fromarray(wide).save(tmp_path / "a.jp2", irreversible=False)
    content, profile = (tmp_path / "a.jp2").read_bytes(), profile_of(TO_P3, TABLE)
    header, box = content.index(b"jp2h") - 4, content.index(b"colr") - 4
    length = int.from_bytes(content[box : box + 4], "big")
    new = struct.pack(">I", 11 + len(profile)) + b"colr\2\0\0" + profile
    size = int.from_bytes(content[header : header + 4], "big") + len(new) - length
    parts = content[:header] + struct.pack(">I", size), content[header + 4 : box], new, content[box + length :]
    np.testing.assert_allclose(_read(tmp_path / "b.jp2", b"".join(parts)), COLORS, atol=2 / 255)
    picture = PIL.Image.fromarray(np.rint(255 * COLORS).astype(np.uint8))
    lab = PIL.ImageCms.profileToProfile(picture, *map(PIL.ImageCms.createProfile, ("sRGB", "LAB")), outputMode="LAB")
    lab.save(tmp_path / "a.tif", icc_profile=LAB_PROFILE)
    image = _read(tmp_path / "a.tif", (tmp_path / "a.tif").read_bytes())
    assert np.abs(image - COLORS).mean() < 2 / 255  # eight bits of L*a*b*


UNKNOWN = {
    r"CICP 9/18 \(HLG\)": (b"cICP", bytes([9, 18, 0, 1])),
    "CICP 200/13": (b"cICP", bytes([200, 13, 0, 1])),
    "a broken ICC profile": _icc(b"no profile at all" * 20),
    "ICC profile 'Lab identity built-in'": _icc(LAB_PROFILE),
    "EXIF color space uncalibrated": (
        b"eXIf",
        b"II*\0\x08\0\0\0\x01\0\x69\x87\4\0\1\0\0\0\x1a\0\0\0\0\0\0\0\1\0\1\xa0\3\0\1\0\0\0\xff\xff\0\0\0\0\0\0",
    ),
}


@pytest.mark.parametrize("name", UNKNOWN)
def test_what_cannot_be_converted_is_named(tmp_path: Path, name: str) -> None:
    """A space that is not known brings one warning, which names file and space; the values are those stored."""
    (tmp_path / "a.png").write_bytes(png(COLORS, UNKNOWN[name]))
    with pytest.warns(UserWarning, match=rf"a\.png: {name}.*its values are read as sRGB") as caught:
        image = read_image(tmp_path / "a.png")
    assert len(caught) == 1
    np.testing.assert_allclose(image, COLORS, atol=0.6 / 255)


def test_colors_that_srgb_lacks_are_named(tmp_path: Path) -> None:
    """A picture of which much is clipped brings one warning, with the share."""
    values = np.full((16, 16, 3), 0.4)
    values[:4], values[8:] = (1, 0, 0), 0.8
    (tmp_path / "a.png").write_bytes(png(values, (b"cICP", bytes([12, 13, 0, 1]))))
    with pytest.warns(UserWarning, match="CICP 12/13: 25% of the pixels have colors outside sRGB") as caught:
        assert read_image(tmp_path / "a.png")[0, 0].tolist() == [1, 0, 0]
    assert len(caught) == 1


def test_boxes_of_avif(tmp_path: Path) -> None:
    """An AVIF is read, and its box of color codes counts."""
    picture = PIL.Image.fromarray(np.rint(255 * COLORS).astype(np.uint8))
    picture.save(tmp_path / "a.avif", quality=100, subsampling="4:4:4")
    content = (tmp_path / "a.avif").read_bytes()
    np.testing.assert_allclose(_read(tmp_path / "a.avif", content), COLORS, atol=4 / 255)
    assert content.count(b"colrnclx\0\1\0\x0d") == 1
    wide = _read(tmp_path / "b.avif", content.replace(b"colrnclx\0\1\0\x0d", b"colrnclx\0\x0c\0\x0d"))
    np.testing.assert_allclose(_srgb_curve(_linear(wide) @ TO_P3.T), COLORS, atol=5 / 255)


def test_the_judge_sees_one_wall_in_two_spaces(tmp_path: Path) -> None:
    """A red wall in Display P3 looks like the same wall in sRGB, to the judge and in what a method makes of both."""
    brick = nrbench.texture("brick", shape=(96, 96), seed=2, color=0.3)
    wall = np.clip(brick.image * (1, 0.8, 0.7), 0.1, 0.9)
    chunk = _icc(profile_of(TO_P3, PARAMETRIC))
    (tmp_path / "p3.png").write_bytes(png(_srgb_curve(_linear(wall) @ TO_P3.T), chunk))
    (tmp_path / "srgb.png").write_bytes(png(wall))
    scores = nrbench.score(tmp_path / "srgb.png", tmp_path / "p3.png", metrics="appearance")
    assert scores.values["appearance.score"] == 1
    made = [
        nrbench.synthesize("tiling", tmp_path / name, (96, 96), brick.lattice).image for name in ("p3.png", "srgb.png")
    ]
    np.testing.assert_allclose(*made, atol=2.1 / 255)
