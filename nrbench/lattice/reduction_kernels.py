"""The compiled twin of :func:`nrbench.lattice.geometry.reduce_pairs`."""

from __future__ import annotations

import numpy as np

from nrbench.jit import Float64x3, kernel


@kernel
def reduce_bases(bases: Float64x3, acute: bool) -> Float64x3:
    """Return the reduced bases of many lattices, ``(n, 2, 2)``.

    If the vectors of a basis are parallel, one of the returned vectors is 0, or as short as rounding errors.

    Parameters
    ----------
    bases
        ``(n, 2, 2)``, rows (x, y) of each basis.
    acute
        Whether the vectors point to the right and make no obtuse angle, as those of
        :meth:`nrbench.lattice.geometry.Lattice.reduced`.
    """
    out = np.zeros_like(bases)
    for i in range(bases.shape[0]):
        ax, ay, bx, by = bases[i, 0, 0], bases[i, 0, 1], bases[i, 1, 0], bases[i, 1, 1]
        if ax * ax + ay * ay > bx * bx + by * by:
            ax, ay, bx, by = bx, by, ax, ay
        while True:
            square = ax * ax + ay * ay
            steps = np.rint((ax * bx + ay * by) / max(square, 1e-300))
            bx, by = bx - steps * ax, by - steps * ay
            if bx * bx + by * by >= square * (1 - 1e-12):
                break
            ax, ay, bx, by = bx, by, ax, ay
        if acute and (ax < 0 or (ax == 0 and ay <= 0)):
            ax, ay = -ax, -ay
        if acute and (bx < 0 or (bx == 0 and by <= 0)):
            bx, by = -bx, -by
        dot = ax * bx + ay * by
        if acute and dot < 0 and abs(dot) >= 1e-9 * (ax * ax + ay * ay):
            bx, by = -bx, -by
        out[i, 0, 0], out[i, 0, 1], out[i, 1, 0], out[i, 1, 1] = ax, ay, bx, by
    return out
