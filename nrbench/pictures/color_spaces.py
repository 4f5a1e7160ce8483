"""Color spaces of picture files: what a file says about its values, and the conversion of these to sRGB."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import PIL.ExifTags
import PIL.Image
import PIL.ImageCms
from numpy.typing import NDArray

Values = NDArray[np.float64]
Curve = Callable[[Values], Values]
"""From stored values in [0, 1] to linear light, which is 1 for white."""

_D65 = 0.3127, 0.3290
_SRGB, _SMPTE_C = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06), (0.63, 0.34, 0.31, 0.595, 0.155, 0.07)
_ADOBE, _PAL = (0.64, 0.33, 0.21, 0.71, 0.15, 0.06), (0.64, 0.33, 0.29, 0.60, 0.15, 0.06)
_REC2020, _P3 = (0.708, 0.292, 0.17, 0.797, 0.131, 0.046), (0.68, 0.32, 0.265, 0.69, 0.15, 0.06)
_PRIMARIES = {1: _SRGB, 2: _SRGB, 5: _PAL, 6: _SMPTE_C, 7: _SMPTE_C, 9: _REC2020, 12: _P3}
"""xy of red, green and blue by the codes of ITU-T H.273 whose white is D65; 2 stands for "unspecified"."""
_VIDEO = (1, 2, 6, 13, 14, 15)
"""Codes of curves that are read as that of sRGB: 13 itself, "unspecified", and those of video, as viewers do."""
_SRGB_D50 = np.array([(0.43607, 0.38515, 0.14307), (0.22249, 0.71687, 0.06061), (0.01392, 0.09708, 0.71410)])
"""XYZ of the primaries of sRGB in the columns, adapted to D50 as in ICC profiles."""
_CODES = re.compile(rb"\0\0\0\x04cICP(..)|colrnclx\0(.)\0(.)", re.DOTALL)
"""Codes of primaries and curve in a PNG, and in the boxes of AVIF and HEIC."""
PAPER_WHITE = 203.0
"""cd/m2 that become white in a PQ picture (ITU-R BT.2408)."""
_SEEN = 1 / 255
"""A conversion that changes no value by more than this is left out."""
_BRIGHTEST = 100.0
"""More than the linear light of any curve; a matrix with larger numbers is that of no color space, either."""
_BAND = 1 << 20
"""Number of pixels that are converted at a time."""
_OUTSIDE, _CLIPPED = 0.02, 0.01
"""Linear values this far outside [0, 1] are named if at least this share of the pixels has one."""


@dataclass(frozen=True)
class ColorSpace:
    """The meaning of the values of a file.

    Parameters
    ----------
    name
        What the file says, for messages.
    curve
        From values to linear light; None if it is not known.
    matrix
        ``(3, 3)``: from linear values to linear sRGB; None for gray.
    profile
        An ICC profile that has tables instead of a curve and a matrix.
    """

    name: str
    curve: Curve | None = None
    matrix: Values | None = None
    profile: bytes = b""

    def to_srgb(self, pixels: NDArray[Any]) -> tuple[NDArray[Any], str]:
        """Return pixels in sRGB, and a remark if they are not exactly the colors of the file.

        Parameters
        ----------
        pixels
            ``(H, W, C)`` of uint8, uint16 or float in [0, 1], with or without alpha. Floats become uint16.
        """
        if self.curve is None:
            return pixels, f"{self.name} cannot be converted; its values are read as sRGB"
        colors = 3 if pixels.shape[2] > 2 else 1
        dtype = pixels.dtype if pixels.dtype.kind == "u" else np.dtype(np.uint16)
        peak = np.iinfo(dtype).max
        table = _find_light(self.curve, np.arange(peak + 1) / peak) if dtype == pixels.dtype else None
        stored, clipped = pixels.astype(dtype) if table is not None else np.rint(pixels * peak).astype(dtype), 0
        step = max(1, _BAND // pixels.shape[1])
        for top in range(0, len(pixels), step):  # a large picture leaves no room for copies
            values = pixels[top : top + step, :, :colors]
            light = _find_light(self.curve, values) if table is None else table[values]
            if self.matrix is not None and colors == 3:
                light = light @ self.matrix.T.astype(np.float32)
            clipped += int(((light < -_OUTSIDE) | (light > 1 + _OUTSIDE)).any(-1).sum())
            np.clip(light, 0, 1, out=light)
            light = np.where(light > 0.0031308, 1.055 * light ** np.float32(1 / 2.4) - 0.055, 12.92 * light)
            stored[top : top + step, :, :colors] = np.rint(light * peak)
        share = clipped / (pixels.shape[0] * pixels.shape[1])
        lost = f"{self.name}: {share:.0%} of the pixels have colors outside sRGB, which are clipped"
        if table is not None and np.abs(np.subtract(stored, pixels, dtype=np.int32)).max() <= _SEEN * peak:
            stored = pixels
        return stored, lost if share >= _CLIPPED else ""


LINEAR = ColorSpace("linear light", lambda values: values)


def _find_light(curve: Curve, values: NDArray[Any]) -> NDArray[np.float32]:
    """Return finite linear light, also by the curve of a damaged file."""
    with np.errstate(all="ignore"):
        return np.clip(np.nan_to_num(curve(values)), 0, _BRIGHTEST).astype(np.float32)


def find_color_space(picture: PIL.Image.Image, head: bytes) -> ColorSpace | None:
    """Return the color space that a file names; None if it names none, or sRGB.

    Of several statements one counts: the first of cICP, ICC profile, sRGB chunk, gAMA and cHRM, the nclx box of AVIF
    and HEIC, EXIF, the tags of TIFF.

    Parameters
    ----------
    picture
        The opened picture.
    head
        The first bytes of its file.
    """
    info, codes = picture.info, _CODES.search(head)
    if codes is not None and (codes[1] or not info.get("icc_profile")):
        return _from_codes(*(codes[1] or codes[2] + codes[3]))
    profile = info.get("icc_profile") or _find_box(head)
    if profile:
        return None if picture.mode == "LAB" else read_profile(profile)  # Pillow knows what L*a*b* is
    if "srgb" in info:
        return None
    if "gamma" in info or "chromaticity" in info:
        gamma, chromaticity = info.get("gamma") or 1 / 2.2, info.get("chromaticity") or (*_D65, *_SRGB)
        name = f"gAMA {gamma:g}" + (" with cHRM" if "chromaticity" in info else "")
        return _from_primaries(name, chromaticity[2:], chromaticity[:2], 1 / gamma)
    try:
        return _from_exif(picture.getexif())
    except Exception:  # a broken block says nothing
        return None


def _find_box(head: bytes) -> bytes:
    """Return the ICC profile in the header of a JPEG 2000 file, which Pillow does not read; empty if there is none."""
    at = head.find(b"colr") if head[4:8] == b"jP  " else -1
    return head[at + 7 : at - 4 + int.from_bytes(head[at - 4 : at], "big")] if at > 0 and head[at + 4] == 2 else b""


def _from_codes(primaries: int, transfer: int) -> ColorSpace | None:
    """Return the color space of codes of ITU-T H.273."""
    name, xy = f"CICP {primaries}/{transfer}", _PRIMARIES.get(primaries)
    curves: dict[int, Curve] = {4: lambda v: v**2.2, 5: lambda v: v**2.8, 8: lambda v: v, 16: _decode_pq}
    curve = curves.get(transfer, _decode_srgb if transfer in _VIDEO else None)
    if xy is None or curve is None:
        return ColorSpace(name + {18: " (HLG)"}.get(transfer, ""))
    if xy is _SRGB and curve is _decode_srgb:
        return None
    return ColorSpace(name, curve, _matrix_to_srgb(xy, _D65))


def _from_primaries(name: str, xy: Sequence[float], white: Sequence[float], gamma: float) -> ColorSpace | None:
    """Return a color space of a power law; with the primaries of sRGB, 2.2 stands for its curve, as usual in PNG."""
    if abs(gamma - 2.2) < 0.005 and np.allclose((*xy, *white), (*_SRGB, *_D65), atol=0.005):
        return None
    try:
        return ColorSpace(name, lambda values: values**gamma, _matrix_to_srgb(xy, white))
    except (ValueError, ZeroDivisionError):
        return ColorSpace(name)


def _from_exif(exif: PIL.Image.Exif) -> ColorSpace | None:
    """Return the color space of EXIF, where R03 stands for Adobe RGB, or of the tags of TIFF."""
    tags = PIL.ExifTags.Base
    space = exif.get_ifd(PIL.ExifTags.IFD.Exif).get(tags.ColorSpace)
    if space == 2 or (space != 1 and exif.get_ifd(PIL.ExifTags.IFD.Interop).get(1) == "R03"):
        return ColorSpace("EXIF Adobe RGB", lambda values: values ** (563 / 256), _matrix_to_srgb(_ADOBE, _D65))
    if space not in (None, 1):
        return ColorSpace(f"EXIF color space {'uncalibrated' if space == 65535 else space} without a profile")
    xy, white = (
        [float(number) for number in exif.get(tag, ())] for tag in (tags.PrimaryChromaticities, tags.WhitePoint)
    )
    return _from_primaries("TIFF primaries", xy, white or _D65, 2.2) if len(xy) == 6 else None


def read_profile(content: bytes) -> ColorSpace | None:
    """Return the color space of an ICC profile."""
    try:
        profile = PIL.ImageCms.ImageCmsProfile(io.BytesIO(content))
        name = f"ICC profile {PIL.ImageCms.getProfileDescription(profile).strip()!r}"
        tags = np.frombuffer(content, ">u4", 3 * int.from_bytes(content[128:132], "big"), 132).reshape(-1, 3).tolist()
        data = {tag.to_bytes(4, "big"): content[start : start + size] for tag, start, size in tags}
        curves = {data[tag] for tag in (b"rTRC", b"gTRC", b"bTRC", b"kTRC") if tag in data}
        if len(curves) != 1 or b"A2B0" in data or content[20:24] != b"XYZ ":
            return ColorSpace(name, profile=content)
        curve = _curve_of_tag(curves.pop())
        if b"kTRC" in data:
            return ColorSpace(name, curve)
        columns = np.stack([_fixed(data[tag][8:20]) for tag in (b"rXYZ", b"gXYZ", b"bXYZ")], -1)
        return ColorSpace(name, curve, _sound(np.linalg.solve(_SRGB_D50, columns)))
    except (OSError, ValueError, KeyError, IndexError, ZeroDivisionError, PIL.ImageCms.PyCMSError):
        return ColorSpace("a broken ICC profile")


def apply_profile(picture: PIL.Image.Image, content: bytes) -> PIL.Image.Image | None:
    """Return a picture of 8 bits in sRGB, by an ICC profile of any kind; gray stays gray. None if it does not fit."""
    alpha = picture.convert("RGBA").getchannel("A") if picture.has_transparency_data else None
    profile, gray = PIL.ImageCms.ImageCmsProfile(io.BytesIO(content)), picture.mode in ("1", "L", "LA")
    mode = {b"GRAY": "L", b"RGB ": "RGB", b"CMYK": "CMYK"}.get(content[16:20], "")
    if not mode or (mode == "CMYK") != (picture.mode == "CMYK") or (mode == "L" and not gray):
        return None
    intent, flags = PIL.ImageCms.Intent.RELATIVE_COLORIMETRIC, PIL.ImageCms.Flags.BLACKPOINTCOMPENSATION
    srgb, color = PIL.ImageCms.createProfile("sRGB"), picture if picture.mode == mode else picture.convert(mode)
    try:
        made = PIL.ImageCms.profileToProfile(color, profile, srgb, intent, "RGB", flags=flags)
    except PIL.ImageCms.PyCMSError:
        return None
    assert made is not None
    made = made.getchannel("G") if gray else made
    if alpha is not None:
        made.putalpha(alpha)
    return made


def _curve_of_tag(data: bytes) -> Curve:
    """Return the curve of an ICC tag of type ``curv`` or ``para``."""
    count = int.from_bytes(data[8:12], "big")
    if data[:4] == b"curv":
        table = np.frombuffer(data, ">u2", count, 12)
        if count > 1:
            return lambda values: np.interp(values, np.linspace(0, 1, count), table / 65535)
        gamma = float(table[0]) / 256 if count else 1.0
        return lambda values: values**gamma
    kind = count >> 16
    if data[:4] != b"para" or kind > 4:
        raise ValueError(data[:4])
    numbers = _fixed(data[12 : 12 + 4 * (1, 3, 4, 5, 7)[kind]]).tolist()
    g, a, b, c, d, e, f = numbers + [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0][len(numbers) :]
    if kind in (1, 2):  # below -b / a the curve is flat, at the last number
        e = f = c if kind == 2 else 0.0
        c, d = 0.0, -b / a
    return lambda values: np.where(values >= d, np.maximum(a * values + b, 0) ** g + e, c * values + f)


def _fixed(data: bytes) -> Values:
    """Return numbers that an ICC profile holds with 16 bits after the point."""
    return np.frombuffer(data, ">i4") / 65536


def _matrix_to_srgb(xy: Sequence[float], white: Sequence[float]) -> Values:
    """Return the matrix from linear values of primaries to linear sRGB; white becomes white."""
    matrix = np.linalg.solve(_matrix_to_xyz(_SRGB, _D65), _matrix_to_xyz(xy, white))
    with np.errstate(all="ignore"):
        return _sound(matrix / matrix.sum(1, keepdims=True))


def _matrix_to_xyz(xy: Sequence[float], white: Sequence[float]) -> Values:
    columns = np.array([xy[::2], xy[1::2], 1 - np.add(xy[::2], xy[1::2])])
    return np.asarray(
        columns * np.linalg.solve(columns, (white[0] / white[1], 1, (1 - white[0] - white[1]) / white[1]))
    )


def _sound(matrix: Values) -> Values:
    """Return a matrix; raise ValueError if it is that of no color space."""
    if not np.abs(matrix).max() < _BRIGHTEST:
        raise ValueError(matrix)
    return matrix


def _decode_srgb(values: Values) -> Values:
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def _decode_pq(values: Values) -> Values:
    """Return linear light of values of SMPTE ST 2084, 1 for :data:`PAPER_WHITE`."""
    power = values ** (4096 / (128 * 2523))
    light = np.maximum(power - 3424 / 4096, 0) / (32 * 2413 / 4096 - 32 * 2392 / 4096 * power)
    return np.asarray(10000 / PAPER_WHITE * light ** (16384 / 2610))
