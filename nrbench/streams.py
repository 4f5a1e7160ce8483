"""Random streams, separated by role, so that equal cells draw equal numbers on any machine."""

from __future__ import annotations

import hashlib
import json

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import depth_of, to_integers


def stream(role: str, *entropy: str | int) -> np.random.Generator:
    """Return the generator of a role and its entropy.

    Parameters
    ----------
    role
        What the numbers are for, e.g. ``"render"``, ``"again"``, ``"synthesis"``, ``"metric"`` or ``"detection"``.
    entropy
        Distinguishes this stream from others of the role. It never contains the method, so all methods get equal draws.

    Returns
    -------
    numpy.random.Generator
        PCG64, seeded by a 128-bit hash of role and entropy.
    """
    digest = hashlib.blake2b(json.dumps([role, *entropy]).encode(), digest_size=16).digest()
    return np.random.Generator(np.random.PCG64(int.from_bytes(digest, "big")))


def pixels_hash(image: NDArray[np.float32]) -> str:
    """Return a hexadecimal hash of the shape and the pixels of an image, as its file of 8 or 16 bits holds them.

    Parameters
    ----------
    image
        ``(H, W, C)`` in [0, 1].
    """
    pixels = np.ascontiguousarray(to_integers(image, depth_of(image)))
    return hashlib.blake2b(repr(pixels.shape).encode() + pixels.tobytes(), digest_size=16).hexdigest()
