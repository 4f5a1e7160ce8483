"""Random streams, separated by role, so that equal cells give equal bytes anywhere."""

from __future__ import annotations

import hashlib
import json

import numpy as np

from nrbench.imaging.convert import Image


def stream(role: str, *entropy: str | int) -> np.random.Generator:
    """Return the generator of a role and its entropy.

    Parameters
    ----------
    role
        What the numbers are for: ``"render"``, ``"again"``, ``"synthesis"``, ``"metric"`` or ``"detection"``.
    entropy
        What tells this stream from the role's others. The method is never part of it: methods are paired.

    Returns
    -------
    numpy.random.Generator
        PCG64, seeded by a 128-bit hash: the same on every machine, in any process and order.
    """
    digest = hashlib.blake2b(json.dumps([role, *entropy]).encode(), digest_size=16).digest()
    return np.random.Generator(np.random.PCG64(int.from_bytes(digest, "big")))


def pixels_hash(image: Image) -> str:
    """Return a hexadecimal hash of an image's shape and 8-bit pixels."""
    pixels = np.ascontiguousarray(np.rint(image * 255).astype(np.uint8))
    return hashlib.blake2b(repr(pixels.shape).encode() + pixels.tobytes(), digest_size=16).hexdigest()
