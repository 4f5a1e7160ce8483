"""Compiled loops over the nodes of a net, whose displacements count modulo the lattice."""

from __future__ import annotations

import math

import numpy as np

from nrbench.jit import Boolx2, Float64x1, Float64x2, Float64x3, Int64x2, inlined_kernel, kernel


@inlined_kernel
def _measure_length(u: float, v: float, vectors: Float64x2) -> float:
    """Return the length px of a displacement in cell coordinates, modulo the lattice of reduced vectors."""
    u, v = u - np.rint(u), v - np.rint(v)
    least = math.inf
    for i in range(-1, 2):
        for j in range(-1, 2):
            x = (u + i) * vectors[0, 0] + (v + j) * vectors[1, 0]
            y = (u + i) * vectors[0, 1] + (v + j) * vectors[1, 1]
            least = min(least, x * x + y * y)
    return math.sqrt(least)


@kernel
def measure_lengths(displacements: Float64x2, vectors: Float64x2) -> Float64x1:
    """Return the length px of displacements in cell coordinates, ``(n, 2)``, modulo the lattice of reduced vectors."""
    lengths = np.empty(len(displacements))
    for n in range(len(displacements)):
        lengths[n] = _measure_length(displacements[n, 0], displacements[n, 1], vectors)
    return lengths


@kernel
def count_agreeing(field: Float64x3, valid: Boolx2, vectors: Float64x2, limit: float, reach: int) -> Int64x2:
    """Return how many valid nodes, up to ``reach`` away, have the displacement of each node to within a limit, px."""
    rows, columns = valid.shape
    found = np.zeros((rows, columns), np.int64)
    for r in range(rows):
        for c in range(columns):
            for i in range(max(r - reach, 0), min(r + reach + 1, rows)):
                for j in range(max(c - reach, 0), min(c + reach + 1, columns)):
                    u, v = field[r, c, 0] - field[i, j, 0], field[r, c, 1] - field[i, j, 1]
                    found[r, c] += valid[i, j] and _measure_length(u, v, vectors) < limit
    return found


@kernel
def grow_nodes(
    field: Float64x3, valid: Boolx2, vectors: Float64x2, limit: float, reach: int, seed: int, most: int
) -> tuple[Boolx2, Float64x3, Int64x2]:
    """Grow the set of nodes that lie where the nodes of the set around them put them.

    Parameters
    ----------
    field, valid
        ``(R, C, 2)`` and ``(R, C)``: displacements in cell coordinates, modulo the lattice, and the nodes that count.
    vectors, limit
        The vectors, reduced, and the largest departure of a node of the set, px.
    reach
        Half width of the surroundings.
    seed, most
        The first node, and the largest number of rounds.

    Returns
    -------
    tuple
        The set; the mean displacements around each node, not modulo the lattice; and of how many nodes they are.
    """
    rows, columns = valid.shape
    grown, count = np.zeros((rows, columns), np.bool_), np.zeros((rows, columns), np.int64)
    grown[seed // columns, seed % columns] = True
    unwrapped, mean = field.copy(), np.zeros((rows, columns, 2))
    for turn in range(most):
        wider, least = np.zeros((rows, columns), np.bool_), 1 if turn < 2 else 3
        for r in range(rows):
            for c in range(columns):
                n, u, v = 0, 0.0, 0.0
                for i in range(max(r - reach, 0), min(r + reach + 1, rows)):
                    for j in range(max(c - reach, 0), min(c + reach + 1, columns)):
                        if grown[i, j]:
                            n, u, v = n + 1, u + unwrapped[i, j, 0], v + unwrapped[i, j, 1]
                count[r, c], mean[r, c, 0], mean[r, c, 1] = n, u / max(n, 1), v / max(n, 1)
        for r in range(rows):
            for c in range(columns):
                if count[r, c] > 0:
                    u, v = field[r, c, 0] - mean[r, c, 0], field[r, c, 1] - mean[r, c, 1]
                    unwrapped[r, c, 0] = mean[r, c, 0] + u - np.rint(u)
                    unwrapped[r, c, 1] = mean[r, c, 1] + v - np.rint(v)
                    near = valid[r, c] and count[r, c] >= least and _measure_length(u, v, vectors) <= limit
                    wider[r, c] = near
        if turn > 2 and (wider == grown).all():
            break
        grown = wider
    return grown, mean, count


@kernel
def spread_nodes(nodes: Float64x3, rows: Float64x1, columns: Float64x1) -> Float64x3:
    """Return the values of nodes ``(R, C, k)``, interpolated linearly at numbers of nodes along both axes."""
    count, length, parts = nodes.shape
    spread, line = np.empty((len(rows), len(columns), parts)), np.empty((length, parts))
    for y in range(len(rows)):
        low = int(rows[y])
        high, part = min(low + 1, count - 1), rows[y] - low
        for c in range(length):
            for k in range(parts):
                line[c, k] = nodes[low, c, k] * (1 - part) + nodes[high, c, k] * part
        for x in range(len(columns)):
            low = int(columns[x])
            high, part = min(low + 1, length - 1), columns[x] - low
            for k in range(parts):
                spread[y, x, k] = line[low, k] * (1 - part) + line[high, k] * part
    return spread
