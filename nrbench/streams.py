"""Random streams, separated by role, so that equal cells draw equal numbers on any machine."""

from __future__ import annotations

import hashlib
import json

import numpy as np
from numpy.typing import NDArray


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
    """Return a hexadecimal hash of the shape and the 8-bit pixels of an image.

    Parameters
    ----------
    image
        ``(H, W, C)`` in [0, 1].
    """
    pixels = np.ascontiguousarray(np.rint(image * 255).astype(np.uint8))
    return hashlib.blake2b(repr(pixels.shape).encode() + pixels.tobytes(), digest_size=16).hexdigest()
