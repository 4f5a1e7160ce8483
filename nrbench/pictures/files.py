"""Read image files of any common format, and write PNG files."""

from __future__ import annotations

import errno
import io
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import PIL.ExifTags
import PIL.Image
import PIL.ImageOps
import PIL.PngImagePlugin
from numpy.typing import NDArray

from nrbench.errors import BadInput, strip_control
from nrbench.imaging.convert import MIN_SIDE, Image, as_image, to_bytes
from nrbench.storage import find_path, write_aside

ENDINGS = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp"})
"""Endings of picture files."""
_DIRECT = {"L", "LA", "RGB", "RGBA"}
_VIA = {"1": "L", "P": "RGB", "CMYK": "RGB", "YCbCr": "RGB", "LAB": "RGB", "HSV": "RGB"}
_VIA_ALPHA = dict.fromkeys(("1", "L", "LA"), "LA")
"""Modes to which pictures with transparency are converted; the others become RGBA."""
FORMATS = ("PNG", "JPEG", "TIFF", "WEBP", "BMP", "GIF", "PPM", "TGA", "JPEG2000")
"""The formats of Pillow that are read; others start programs, such as Ghostscript for EPS, or are no pictures."""
MOST_PIXELS = 1 << 26
"""Most pixels of a picture that is read, 8192 x 8192: as floats of three colors they take 0.8 GB."""
_TURNED = (5, 6, 7, 8)
"""EXIF orientations that exchange height and width."""


def read_image(path: str | Path, smallest: int = MIN_SIDE) -> Image:
    """Read an image file: PNG, JPEG, TIFF or another of :data:`FORMATS`.

    Of several frames the first one is read, with a warning.

    Parameters
    ----------
    path
        Gray, color or palette of up to 16 bits a channel; 16-bit color is rounded to 8 bits. An EXIF rotation is
        applied; a broken EXIF block is ignored. An alpha channel is left out if it is opaque everywhere.
    smallest
        Least number of px a side.

    Returns
    -------
    Image
        One channel for gray files, three for color and palette.

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
    where = f"picture {path}"
    with _opened(path, where) as picture:
        several = _has_several_frames(picture)
        pixels = _pixels(PIL.ImageOps.exif_transpose(picture), where)
    if several:
        warnings.warn(f"{where}: has several frames; the first one is read", UserWarning, stacklevel=2)
    return as_image(pixels, where, smallest)


@contextmanager
def _opened(path: str | Path, where: str) -> Iterator[PIL.Image.Image]:
    """Yield an opened picture of one of :data:`FORMATS`; turn every error of Pillow into BadInput.

    Crafted files make Pillow raise errors of many types. The file is opened here because Pillow maps some TIFF files
    that it opens itself and garbles the rotated ones.
    """
    path = find_path(Path(path))
    _check_file(Path(path), where)
    try:
        with (
            warnings.catch_warnings(action="ignore"),
            Path(path).open("rb") as file,
            PIL.Image.open(file, formats=FORMATS) as picture,
        ):
            width, height = picture.size
            if width * height > MOST_PIXELS:
                most = f"at most {MOST_PIXELS} px in all are read"
                raise BadInput(f"{where}: {width}x{height} px; {most}: crop it, or scale it down")
            yield picture
    except BadInput:
        raise
    except PIL.UnidentifiedImageError:
        raise BadInput(f"{where}: is no picture that can be read; pass a PNG, JPEG or TIFF file") from None
    except PIL.Image.DecompressionBombError:
        raise BadInput(f"{where}: has more than {MOST_PIXELS} px; crop it, or scale it down") from None
    except MemoryError:
        raise BadInput(f"{where}: needs more memory than there is; crop it, or scale it down") from None
    except Exception as error:
        why = strip_control(str(error))[:200]
        raise BadInput(f"{where}: cannot be read ({why}); it may be cut short: save it again as PNG") from None


def list_pictures(folder: Path) -> list[Path]:
    """Return the pictures of a folder by the endings of their names, sorted by name; hidden files are left out.

    Raises
    ------
    BadInput
        If there is no such folder.
    """
    if not folder.is_dir():
        raise BadInput(f"directory {folder}: there is no such directory; check the path")
    names = sorted(entry.name for entry in os.scandir(folder) if entry.is_file() and not entry.name.startswith("."))
    return [folder / name for name in names if Path(name).suffix.lower() in ENDINGS]


def read_shape(path: str | Path) -> tuple[int, int]:
    """Return height and width of the picture in a file, after its EXIF rotation, without reading its pixels.

    Raises
    ------
    BadInput
        If there is no such file, or it is no image.
    """
    with _opened(path, f"picture {path}") as picture:
        width, height = picture.size
        turned = picture.getexif().get(PIL.ExifTags.Base.Orientation, 1) in _TURNED
    return (width, height) if turned else (height, width)


def _check_file(path: Path, where: str) -> None:
    if path.is_dir():
        raise BadInput(f"{where}: is a directory; pass one picture in it")
    if not path.is_file():
        raise BadInput(f"{where}: there is no such file; check the path")
    if path.stat().st_size == 0:
        raise BadInput(f"{where}: is empty (0 bytes); save or download it again")


def _has_several_frames(picture: PIL.Image.Image) -> bool:
    """Return whether a picture is animated or has pages; the previews in a photograph as JPEG do not count."""
    if picture.format in ("JPEG", "MPO"):
        return False
    try:
        return bool(getattr(picture, "is_animated", False))
    except Exception:  # the second frame is broken, the first one may not be
        return False


def _pixels(picture: PIL.Image.Image, where: str) -> NDArray[Any]:
    if picture.mode.startswith("I"):
        return _sixteen_bits(np.asarray(picture), picture.info.get("transparency"), where)
    if picture.has_transparency_data:
        picture = picture.convert(_VIA_ALPHA.get(picture.mode, "RGBA"))
    elif picture.mode in _VIA:
        picture = picture.convert(_VIA[picture.mode])
    if picture.mode not in _DIRECT:
        found = "float pixels" if picture.mode == "F" else f"pixels of mode {picture.mode}"
        raise BadInput(f"{where}: has {found}; save it with 8 or 16 bits a channel")
    return np.asarray(picture)


def _sixteen_bits(pixels: NDArray[Any], transparent: int | None, where: str) -> NDArray[np.uint16]:
    """Return gray values of more than 8 bits, which some formats store in 32 bits; with alpha if one is transparent."""
    if pixels.min() < 0 or pixels.max() > 65535:
        raise BadInput(f"{where}: has gray values outside 0 to 65535; save it with 8 or 16 bits a channel")
    values = pixels.astype(np.uint16)
    if transparent is None:
        return values
    return np.stack([values, np.where(values == transparent, 0, 65535).astype(np.uint16)], -1)


def to_pil(image: Image) -> PIL.Image.Image:
    """Return an image as a picture of Pillow, of 8 bits a channel; gray if it has one channel."""
    pixels = to_bytes(image)
    return PIL.Image.fromarray(pixels[..., 0] if pixels.shape[2] == 1 else pixels)


def encode_png(image: Image) -> bytes:
    """Return an image, with or without an axis of channels, as the content of a PNG file of 8 bits a channel."""
    file = io.BytesIO()
    to_pil(as_image(image, smallest=1)).save(file, "PNG")
    return file.getvalue()


def write_image(path: str | Path, image: Image) -> Path:
    """Write a PNG file of 8 bits a channel, marked as sRGB, in one step: no reader sees an incomplete file.

    Parameters
    ----------
    path
        The path; its name must end in ``.png``. An existing file is replaced.
    image
        float32 ``(H, W, C)`` in [0, 1]; rounded to 8 bits; values outside are clipped.

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
    target = Path(path)
    if target.suffix.lower() != ".png":
        raise BadInput(f"picture {path}: only PNG is written, which keeps every pixel; end its name in .png")
    picture, chunks = to_pil(image), PIL.PngImagePlugin.PngInfo()
    chunks.add(b"sRGB", b"\x00")
    try:
        if not target.parent.is_dir():
            raise NotADirectoryError(errno.ENOENT, "No such file or directory")
        write_aside(target, lambda file: picture.save(file, "PNG", compress_level=1, pnginfo=chunks))
    except OSError as error:
        raise BadInput(f"picture {path}: cannot be written ({error.strerror}); check its folder") from None
    return target
