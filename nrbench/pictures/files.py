"""Read image files of any common format as sRGB, and write PNG, TIFF and WebP files."""

from __future__ import annotations

import errno
import io
import logging
import os
import struct
import sys
import warnings
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO, Any, TypeVar

import numpy as np
import PIL.ExifTags
import PIL.Image
import PIL.ImageCms
import PIL.ImageFile
import PIL.ImageOps
import PIL.PngImagePlugin
import PIL.TiffImagePlugin
import tifffile
from numpy.typing import NDArray

from nrbench.errors import BadInput, require, strip_control
from nrbench.imaging.convert import MIN_SIDE, Image, as_image, as_layers, depth_of, to_bytes, to_integers
from nrbench.imaging.masks import Mask, MaskedImage, as_mask, as_masked
from nrbench.pictures.color_spaces import LINEAR, ColorSpace, apply_profile, find_color_space, read_profile
from nrbench.storage import find_path, write_aside

for _library in ("PIL", "tifffile"):  # they print the faults of a damaged file, of which we make one error
    logging.getLogger(_library).addHandler(logging.NullHandler())
Read = TypeVar("Read", NDArray[Any], MaskedImage)
_Opened = PIL.ImageFile.ImageFile | tifffile.TiffPage
ENDINGS = frozenset(
    {
        *(".png", ".jpg", ".jpeg", ".jfif", ".tif", ".tiff", ".bmp", ".webp", ".gif", ".tga", ".jp2"),
        *(".ppm", ".pgm", ".pbm", ".pnm", ".avif", ".heic", ".heif"),
    }
)
"""Endings of picture files."""
WRITTEN = (".png", ".tif", ".tiff", ".webp")
"""Endings of the files that are written. None of them loses a pixel; WebP has 8 bits a channel."""
_WRITTEN = "PNG, TIFF and WebP (.png, .tif, .webp)"
_COMPANIONS = frozenset({".csv", ".json", ".txt", ".md", ".db", ".ini"})
"""Endings of files beside pictures, which nobody takes for pictures."""
_DIRECT = {"L", "LA", "RGB", "RGBA"}
_VIA = {"1": "L", "P": "RGB", "CMYK": "RGB", "YCbCr": "RGB", "LAB": "RGB", "HSV": "RGB"}
_VIA_ALPHA = dict.fromkeys(("1", "L", "LA"), "LA")
"""Modes to which pictures with transparency are converted; the others become RGBA."""
FORMATS = ("PNG", "JPEG", "TIFF", "WEBP", "BMP", "GIF", "PPM", "TGA", "JPEG2000", "AVIF", "HEIF")
"""The formats of Pillow that are read; others start programs, such as Ghostscript for EPS, or are no pictures."""
MOST_PIXELS = 1 << 26
"""Most pixels of a picture that is read, 8192 x 8192: as floats of three colors they take 0.8 GB."""
_TURNED = (5, 6, 7, 8)
"""EXIF orientations that exchange height and width."""
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_HEIC = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1")
_OTHERS = {b"v/1\1": "OpenEXR", b"#?RAD": "Radiance HDR", b"\xff\n": "JPEG XL", b"\0\0\0\x0cJXL ": "JPEG XL"}
_FRAMES = "has several frames; the first one is read"
_NO_PICTURE = "is no picture that can be read; pass a PNG, JPEG or TIFF file"
_FLIPPED = {2: (1,), 3: (0, 1), 4: (0,), 6: (1,), 7: (0, 1), 8: (0,)}
"""The axes that each orientation turns over after that."""
_HEAD = 1 << 16
"""Bytes at the beginning of a file in which statements about color and depth are searched for."""
_LOW = 0.25
"""A picture that uses less of its scale is named."""
_SAMPLED = 1 << 13
"""About the most values of a picture from which this is determined; 1 in 1000 may lie outside at each end."""


def read_image(path: str | Path, smallest: int = MIN_SIDE) -> Image:
    """Read an image file as sRGB: PNG, JPEG, TIFF or another of :data:`FORMATS`.

    One warning says if the values are not exactly those of the file, if their meaning is not known, if they use less
    than a quarter of their scale, and if the file has several frames, of which the first one is read.

    Parameters
    ----------
    path
        Gray, color or palette of 8 or 16 bits a channel; or float in [0, 1], which is linear light unless a profile
        says otherwise. What the file says of its colors is converted to sRGB: a profile (ICC), gAMA and cHRM, cICP, the
        color space of EXIF. An EXIF rotation is applied; a broken EXIF block is ignored. An alpha channel is left out
        if it is opaque everywhere. HEIC needs the package pillow-heif.
    smallest
        Least number of px a side.

    Returns
    -------
    Image
        One channel for gray files, three for color and palette. The values are those of 8 bits for files of 8 bits,
        else of 16 bits.

    Raises
    ------
    BadInput
        If there is no such file, or it is no image, has transparent pixels or more than :data:`MOST_PIXELS`, or is
        smaller than ``smallest``.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from nrbench import read_image, texture, write_image
    >>> path = Path(tempfile.mkdtemp()) / "brick.png"
    >>> written = write_image(path, texture("brick", shape=(64, 96)).image)
    >>> read_image(path).shape
    (64, 96, 3)
    """
    return _read(path, smallest, as_image)


def read_masked(path: str | Path, smallest: int = MIN_SIDE) -> MaskedImage:
    """Read an image file as :func:`read_image` does; transparent pixels do not count."""
    return _read(path, smallest, as_masked)


def read_layers(path: str | Path, smallest: int = MIN_SIDE) -> Image:
    """Read an image file as :func:`read_image` does, with alpha as the last of 2 or 4 channels."""
    return _read(path, smallest, as_layers)


def read_map(path: str | Path) -> tuple[NDArray[Any], bytes]:
    """Read the values of a picture file that are no colors, such as normals or heights, as they are stored.

    Nothing is converted: what a file says of its colors says nothing about heights, and a map of colors keeps its
    profile. A palette is replaced by its colors, by one channel if they are gray.

    Parameters
    ----------
    path
        As for :func:`read_image`; also float TIFF of any range.

    Returns
    -------
    values
        ``(H, W)`` or ``(H, W, C)``: uint8, uint16 or float32.
    profile
        The ICC profile of the file; empty if it has none.

    Raises
    ------
    BadInput
        If there is no such file, or it is no image.
    """
    where, notes = f"picture {path}", list[str]()
    values, _, profile = _load(path, where, notes, stored=True)
    if notes:
        warnings.warn(f"{where}: {'; '.join(notes)}", UserWarning, stacklevel=2)
    return values, profile or b""


def read_mask(path: str | Path, shape: tuple[int, int]) -> Mask:
    """Read a picture as a mask of ``shape`` (height, width): white counts, and black is left out."""
    with warnings.catch_warnings(action="ignore"):  # of what its colors mean
        return as_mask(read_masked(path, 1), shape, f"mask {path}")


def _read(path: str | Path, smallest: int, convert: Callable[[NDArray[Any], str, int], Read]) -> Read:
    """Return what ``convert`` makes of the pixels of a file, which may have alpha, and warn of what is odd."""
    where, notes = f"picture {path}", list[str]()
    pixels, space, _ = _load(path, where, notes)
    pixels = pixels if pixels.ndim == 3 else pixels[..., np.newaxis]
    if pixels.dtype.kind == "f":
        pixels = pixels.astype(np.float32) if pixels.dtype == np.float16 else pixels
        convert(pixels, where, smallest)  # the range of floats is checked before the conversion
        if space is None:
            notes.append("float values without a profile are read as linear light; store other quantities with 16 bits")
        space = space or LINEAR
    if space is not None:
        pixels, remark = space.to_srgb(pixels)
        notes += [remark] if remark else []
    read = convert(pixels, where, smallest)
    notes += _range_remark(read.image if isinstance(read, MaskedImage) else read)
    if notes:
        warnings.warn(f"{where}: {'; '.join(notes)}", UserWarning, stacklevel=3)
    return read


def _load(
    path: str | Path, where: str, notes: list[str], stored: bool = False
) -> tuple[NDArray[Any], ColorSpace | None, bytes | None]:
    """Return the pixels of a file, the color space from which they must be converted, and its profile; add notes.

    ``stored``: the values as they are stored, without a color space.
    """
    with _opened(path, where) as (picture, file, head):
        if isinstance(picture, tifffile.TiffPage):
            return *_page_pixels(picture, where, notes), picture.iccprofile
        pixels, space = _pixels(picture, file, head, where, notes, stored)
        if stored and picture.mode == "P" and pixels.ndim == 3 and not np.ptp(pixels, axis=2).any():
            pixels = pixels[..., 0]
        return pixels, space, picture.info.get("icc_profile")


def _range_remark(image: Image) -> list[str]:
    """Return a remark if an image uses little of its scale; single bright or dark pixels do not count."""
    values = image.reshape(-1, image.shape[2])[:: image.size // _SAMPLED | 1]  # an odd step meets all columns
    low, high = np.quantile(values, (0.001, 0.999)).tolist()
    if high - low >= _LOW or not np.ptp(values, axis=0).any():
        return []
    return [f"uses only {low:.3f} to {high:.3f} of its scale from 0 to 1; stretch its values unless it shall look so"]


@contextmanager
def _opened(path: str | Path, where: str) -> Iterator[tuple[_Opened, IO[bytes], bytes]]:
    """Yield an opened picture of one of :data:`FORMATS`, its file, and its first bytes; turn errors into BadInput.

    A TIFF that Pillow does not know, such as one of floats in color, is a page of tifffile. Crafted files make the
    libraries raise errors of many types. The file is opened here because Pillow maps some TIFF files that it opens
    itself and garbles the rotated ones.
    """
    path = find_path(Path(path))
    _check_file(Path(path), where)
    try:
        with warnings.catch_warnings(action="ignore"), Path(path).open("rb") as file, ExitStack() as opened:
            head = file.read(_HEAD)
            picture: _Opened
            try:
                picture = opened.enter_context(PIL.Image.open(file, formats=_formats(head)))
                width, height = picture.size
                tags = picture.tag_v2 if isinstance(picture, PIL.TiffImagePlugin.TiffImageFile) else {}
                if tags.get(284) == 2 and tags.get(258, (8,))[0] > 8:
                    raise PIL.UnidentifiedImageError("planes of more than 8 bits, which Pillow garbles")
            except PIL.UnidentifiedImageError:
                file.seek(0)
                if head[:4] not in _TIFF:
                    raise BadInput(f"{where}: {_name_format(head, file)}") from None
                picture = opened.enter_context(tifffile.TiffFile(file)).pages.first
                width, height = picture.imagewidth, picture.imagelength
            require(width * height > 0, f"{where}: {_NO_PICTURE}")
            if width * height > MOST_PIXELS:
                most = f"at most {MOST_PIXELS} px in all are read"
                raise BadInput(f"{where}: {width}x{height} px; {most}: crop it, or scale it down")
            yield picture, file, head
    except BadInput:
        raise
    except PIL.Image.DecompressionBombError:
        raise BadInput(f"{where}: has more than {MOST_PIXELS} px; crop it, or scale it down") from None
    except MemoryError:
        raise BadInput(f"{where}: needs more memory than there is; crop it, or scale it down") from None
    except Exception as error:
        why = strip_control(str(error))[:200]
        raise BadInput(f"{where}: cannot be read ({why}); it may be cut short: save it again as PNG") from None


def _formats(head: bytes) -> tuple[str, ...]:
    """Return the formats to try on a file: those of :data:`FORMATS` that this installation can read."""
    if head[4:8] != b"ftyp":
        return FORMATS[:-2]
    with suppress(ImportError):
        import pillow_heif  # type: ignore[import-not-found,unused-ignore]

        pillow_heif.register_heif_opener()
    PIL.Image.init()
    return tuple(name for name in FORMATS[-2:] if name in PIL.Image.OPEN)


def _name_format(head: bytes, file: IO[bytes]) -> str:
    """Return what a file is that is no picture of the formats to try, and what to do."""
    if head[4:8] == b"ftyp" and head[8:11] == b"avi":
        return "is AVIF, which this Pillow cannot read; install Pillow 11.3 or later, or save it as PNG"
    if head[4:8] == b"ftyp" and head[8:12] in _HEIC:
        return "is HEIC, which needs the package pillow-heif: pip install 'nrbench[heic]'; or save it as PNG"
    name = next((name for start, name in _OTHERS.items() if head.startswith(start)), None)
    with suppress(Exception), PIL.Image.open(file) as other:
        name = other.format
    return f"is no picture that can be read, but {name}; save it as PNG" if name else _NO_PICTURE


def list_pictures(folder: Path) -> list[Path]:
    """Return the pictures of a folder by the endings of their names, sorted by name; hidden files are left out.

    A warning counts and names the other files, but for texts and tables.

    Raises
    ------
    BadInput
        If there is no such folder.
    """
    require(folder.is_dir(), f"directory {folder}: there is no such directory; check the path")
    names = sorted(entry.name for entry in os.scandir(folder) if entry.is_file() and not entry.name.startswith("."))
    skipped = [name for name in names if Path(name).suffix.lower() not in ENDINGS | _COMPANIONS]
    if skipped:
        some = ", ".join(map(strip_control, skipped[:5])) + (", ..." if len(skipped) > 5 else "")
        why = "files skipped, as their names do not end as those of pictures"
        warnings.warn(f"directory {folder}: {why}: {len(skipped)} ({some})", stacklevel=2)
    return [folder / name for name in names if Path(name).suffix.lower() in ENDINGS]


def read_shape(path: str | Path) -> tuple[int, int]:
    """Return height and width of the picture in a file, after its EXIF rotation, without reading its pixels.

    Raises
    ------
    BadInput
        If there is no such file, or it is no image.
    """
    with _opened(path, f"picture {path}") as (picture, *_):
        if isinstance(picture, tifffile.TiffPage):
            width, height, turned = picture.imagewidth, picture.imagelength, _orientation(picture) in _TURNED
        else:
            width, height = picture.size
            turned = picture.getexif().get(PIL.ExifTags.Base.Orientation, 1) in _TURNED
    return (width, height) if turned else (height, width)


def _check_file(path: Path, where: str) -> None:
    require(not path.is_dir(), f"{where}: is a directory; pass one picture in it")
    require(path.is_file(), f"{where}: there is no such file; check the path")
    require(path.stat().st_size > 0, f"{where}: is empty (0 bytes); save or download it again")


def _has_several_frames(picture: PIL.Image.Image) -> bool:
    """Return whether a picture is animated or has pages; the previews in a photograph as JPEG do not count."""
    if picture.format in ("JPEG", "MPO"):
        return False
    try:
        return bool(getattr(picture, "is_animated", False))
    except Exception:  # the second frame is broken, the first one may not be
        return False


def _pixels(
    picture: PIL.ImageFile.ImageFile,
    file: IO[bytes],
    head: bytes,
    where: str,
    notes: list[str],
    stored: bool = False,
) -> tuple[NDArray[Any], ColorSpace | None]:
    """Return the pixels of a picture, upright, and the color space from which they must be converted; add notes.

    ``stored``: the values as they are stored, without a color space.
    """
    if _has_several_frames(picture):
        notes.append(_FRAMES)
    deep, twelve = _is_deep(picture, head), "I;12" in str(picture.tile)
    # Before EXIF is read, for which Pillow decodes a PNG.
    wide = _read_wide(picture, file) if deep and picture.tile else None
    space = None if stored else find_color_space(picture, head)
    upright = PIL.ImageOps.exif_transpose(picture)
    if upright.mode.startswith("I"):
        wide = np.rint(np.asarray(upright) * (65535 / 4095)) if twelve else np.asarray(upright)
    if wide is not None:
        wide = _sixteen_bits(wide, picture.info.get("transparency"), where)
        if space is None or not space.profile:
            return wide, space
        upright, deep = PIL.Image.fromarray(np.rint(wide / 257).astype(np.uint8)), True
    managed = apply_profile(upright, space.profile) if space is not None and space.profile else None
    if upright.mode == "CMYK" and managed is None:
        notes.append("is CMYK without a profile that fits; its colors are estimated")
    if deep:
        notes.append("has more than 8 bits a channel, which are rounded to 8")
    return _plain_pixels(managed or upright, where), None if managed else space


def _is_deep(picture: PIL.ImageFile.ImageFile, head: bytes) -> bool:
    """Return whether a file has more than 8 bits a channel, of which Pillow reads 8."""
    if picture.format in ("PNG", "TIFF"):
        return picture.mode[0] not in "IF" and any(mark in str(picture.tile) for mark in (";16B", ";16L", ";16N"))
    if picture.format == "PPM":
        args: Any = picture.tile[0].args
        return picture.mode == "RGB" and not isinstance(args, str) and args[1] > 255
    at = head.find(b"av1C") if picture.format == "AVIF" else -1
    return int(picture.info.get("bit_depth", 8)) > 8 or (at >= 0 and bool(head[at + 6] & 0x40))


def _read_wide(picture: PIL.ImageFile.ImageFile, file: IO[bytes]) -> NDArray[np.uint16] | None:
    """Return color, or gray with alpha, of 16 bits, upright; None if the pixels have another layout.

    Pillow keeps the upper of two bytes. If it is given the wrong order of the bytes, it keeps the lower one.
    """
    plain, modes = picture.format == "PNG", list[str]()
    given: Any = picture.tile[0].args
    mode = given if plain else given[0]
    if mode == "LA;16B":
        modes = ["RGBA"]  # four bytes
    elif mode[:-1] in ("RGB;16", "RGBX;16", "RGBA;16"):
        modes = [mode[:-1] + order for order in ("BL" if mode[-1] == "B" or sys.byteorder == "big" else "LB")]
    planes = []
    for each in modes:
        file.seek(0)
        with PIL.Image.open(file, formats=[str(picture.format)]) as again:
            tiles: Any = again.tile
            again.tile = [tile._replace(args=each if plain else (each, *tile.args[1:])) for tile in tiles]
            planes.append(np.asarray(PIL.ImageOps.exif_transpose(again)))
    if len(planes) == 2:
        return np.asarray(planes[0] * np.uint16(256) + planes[1])
    return np.ascontiguousarray(planes[0]).view(">u2").astype(np.uint16) if planes else None


def _page_pixels(page: tifffile.TiffPage, where: str, notes: list[str]) -> tuple[NDArray[Any], ColorSpace | None]:
    """Return the pixels of a page of tifffile, upright, and its color space; add notes."""
    if len(page.parent.pages) > 1:
        notes.append(_FRAMES)
    if page.photometric not in (1, 2) or not 0 < page.size <= 4 * MOST_PIXELS:
        raise BadInput(f"{where}: has pixels of another kind than gray or RGB; save it as PNG")
    pixels = page.asarray()
    pixels = np.moveaxis(pixels, 0, -1) if page.planarconfig == 2 and pixels.ndim == 3 else pixels
    turn = _orientation(page)
    pixels = np.flip(pixels.swapaxes(0, 1) if turn in _TURNED else pixels, _FLIPPED.get(turn, ()))
    return pixels, read_profile(page.iccprofile) if page.iccprofile else None


def _orientation(page: tifffile.TiffPage) -> int:
    return int(page.tags.valueof("Orientation", 1))


def _plain_pixels(picture: PIL.Image.Image, where: str) -> NDArray[Any]:
    if picture.mode == "F":
        return np.asarray(picture)
    if picture.has_transparency_data:
        picture = picture.convert(_VIA_ALPHA.get(picture.mode, "RGBA"))
    elif picture.mode in _VIA:
        picture = picture.convert(_VIA[picture.mode])
    require(picture.mode in _DIRECT, f"{where}: has pixels of mode {picture.mode}; save it with 8 or 16 bits a channel")
    return np.asarray(picture)


def _sixteen_bits(pixels: NDArray[Any], transparent: Any, where: str) -> NDArray[np.uint16]:
    """Return values of more than 8 bits, which some formats store in 32 bits; with alpha if a color is transparent."""
    if pixels.min() < 0 or pixels.max() > 65535:
        raise BadInput(f"{where}: has gray values outside 0 to 65535; save it with 8 or 16 bits a channel")
    values = pixels.astype(np.uint16)
    if transparent is None:
        return values
    values = values.reshape(*values.shape[:2], -1)
    return np.dstack([values, np.where((values == transparent).all(-1), 0, 65535).astype(np.uint16)])


def to_rgb(picture: PIL.Image.Image) -> NDArray[np.uint8]:
    """Return a picture of a run as color of 8 bits, ``(H, W, 3)``; Pillow clips gray of 16 bits."""
    if picture.mode.startswith("I"):
        picture = PIL.Image.fromarray(np.rint(np.asarray(picture) / 257).astype(np.uint8))
    return np.asarray(picture.convert("RGB"))


def to_pil(image: Image) -> PIL.Image.Image:
    """Return an image as a picture of Pillow, of 8 bits a channel; gray if it has one channel."""
    return _to_pil(to_bytes(image))


def encode_png(image: Image) -> bytes:
    """Return an image, with or without an axis of channels, as the content of a PNG file of 8 bits a channel."""
    file = io.BytesIO()
    to_pil(as_image(image, smallest=1)).save(file, "PNG")
    return file.getvalue()


def write_image(path: str | Path, image: Image) -> Path:
    """Write a PNG, TIFF or WebP file, marked as sRGB, in one step: no reader sees an incomplete file.

    The file has 16 bits a channel if the image has the values of such a file, as :func:`read_image` returns them;
    others are rounded to 8 bits.

    Parameters
    ----------
    path
        The path; its name must end in ``.png``, ``.tif``, ``.tiff`` or ``.webp``. An existing file is replaced. All
        pixels are kept, but that WebP has only 8 bits; then there is a warning.
    image
        uint8, uint16, or float in [0, 1], ``(H, W)`` or ``(H, W, C)``; floats outside are clipped. Alpha is opaque.

    Returns
    -------
    Path
        The path written.

    Raises
    ------
    BadInput
        If the name ends otherwise, or the folder is missing or cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from nrbench import read_image, texture, write_image
    >>> path = Path(tempfile.mkdtemp()) / "brick.png"
    >>> written = write_image(path, texture("brick", shape=(64, 96)).image)
    >>> read_image(path).shape
    (64, 96, 3)
    """
    image = np.asarray(image)
    image = as_image(np.clip(image, 0, 1) if image.dtype.kind == "f" else image, f"picture {path}", 1)
    return write_map(path, to_integers(image, depth_of(image)))


def write_map(path: str | Path, values: NDArray[Any], profile: bytes | None = None) -> Path:
    """Write the values of a map as :func:`write_image` writes an image, with the profile of :func:`read_map`.

    Parameters
    ----------
    path
        As for :func:`write_image`. Floats need TIFF.
    values
        ``(H, W)`` or ``(H, W, C)``: uint8, uint16 or float32.
    profile
        An ICC profile; empty: none, the values are no colors. None: the values are sRGB.

    Returns
    -------
    Path
        The path written.

    Raises
    ------
    BadInput
        As for :func:`write_image`.
    """
    target, deep = Path(path), values.dtype == np.uint16
    kind, pixels = target.suffix.lower(), values if values.ndim == 3 else values[..., np.newaxis]
    if kind not in WRITTEN:
        raise BadInput(f"picture {path}: is not written, because only {_WRITTEN} keep every pixel; end its name so")
    if kind == ".webp" and deep:
        kept = "WebP has 8 bits a channel; .png and .tif keep the 16 of the image"
        warnings.warn(f"picture {path}: {kept}", stacklevel=2)
    write = {".png": _write_png, ".webp": _write_webp}.get(kind, _write_tiff)
    try:
        if not target.parent.is_dir():
            raise NotADirectoryError(errno.ENOENT, "No such file or directory")
        write_aside(target, lambda file: write(file, pixels, profile))
    except OSError as error:
        raise BadInput(f"picture {path}: cannot be written ({error.strerror}); check its folder") from None
    return target


def _to_pil(pixels: NDArray[Any]) -> PIL.Image.Image:
    return PIL.Image.fromarray(pixels[..., 0] if pixels.shape[2] == 1 else pixels)


_ROWS = 512
"""Rows of a PNG that are filtered at a time."""


def _write_png(file: IO[bytes], pixels: NDArray[Any], profile: bytes | None) -> None:
    """Write a PNG of 8 or 16 bits a channel.

    Pillow writes 16 bits in gray alone. Of 8 bits, it tries five filters on each row, which takes twice the time and
    saves 3 % of the bytes.
    """
    height, width, channels = pixels.shape
    kind = np.dtype(">u2" if pixels.dtype == np.uint16 else np.uint8)
    deflate, above = zlib.compressobj(1), np.zeros((1, width * channels * kind.itemsize), np.uint8)
    coded: list[bytes] = []
    for top in range(0, height, _ROWS):
        rows = pixels[top : top + _ROWS].astype(kind, "C", "equiv").reshape(-1, width * channels).view(np.uint8)
        lines = np.full((len(rows), 1 + rows.shape[1]), 2, np.uint8)  # 2: differences from the line above
        lines[:, 1:] = np.diff(rows, axis=0, prepend=above)
        coded.append(deflate.compress(lines.data))
        above = rows[-1:]
    file.write(b"\x89PNG\r\n\x1a\n")
    header = struct.pack(">IIBBBBB", width, height, 8 * kind.itemsize, (0, 4, 2, 6)[channels - 1], 0, 0, 0)
    meaning = (b"iCCP", b"ICC profile\0\0" + zlib.compress(profile)) if profile else (b"sRGB", b"\x00")
    for name, data in (
        (b"IHDR", header),
        *([] if profile == b"" else [meaning]),
        (b"IDAT", b"".join((*coded, deflate.flush()))),
        (b"IEND", b""),
    ):
        PIL.PngImagePlugin.putchunk(file, name, data)


def _write_webp(file: IO[bytes], pixels: NDArray[Any], profile: bytes | None) -> None:
    pixels = np.rint(pixels / 257).astype(np.uint8) if pixels.dtype == np.uint16 else pixels
    _to_pil(pixels).save(file, "WEBP", lossless=True, exact=True, icc_profile=profile)


def _write_tiff(file: IO[bytes], pixels: NDArray[Any], profile: bytes | None) -> None:
    """Write a TIFF; one in color has the profile of sRGB, without which the meaning of its values would be open."""
    color, alpha = pixels.shape[2] > 2, pixels.shape[2] % 2 == 0
    if profile is None and color:
        profile = PIL.ImageCms.ImageCmsProfile(PIL.ImageCms.createProfile("sRGB")).tobytes()
    tifffile.imwrite(
        file,
        pixels if pixels.shape[2] > 1 else pixels[..., 0],
        photometric="rgb" if color else "minisblack",
        planarconfig="contig" if pixels.shape[2] > 1 else None,
        extrasamples=["unassalpha"] if alpha else None,
        compression="zlib",
        iccprofile=profile or None,
    )
