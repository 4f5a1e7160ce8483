"""Compiled loops of :func:`nrbench.tracking.tracker.unwrap`."""

from __future__ import annotations

import heapq

import numpy as np

from nrbench.jit import Float32x4, Float64x2, Float64x3, kernel


@kernel
def grow(
    surfaces: Float32x4, trust: Float64x2, steps: Float64x3, costs: Float64x2, matrix: Float64x2, sweeps: int
) -> Float64x3:
    """Return a continuous displacement (x, y) px of each node, ``(rows, columns, 2)``.

    The field grows from the most trusted node. Of the nodes next to the field, the most trusted one is added first.
    Then every node is revised ``sweeps`` times. The time is linear in nodes times displacements.

    Parameters
    ----------
    surfaces
        ``(rows, columns, n, n)``: correlation at displacement (i t1 + j t2) / n.
    trust
        ``(rows, columns)``, positive: weight of each node in the mean over neighbors.
    steps
        ``(n, n, 2)``: each displacement as its shortest representative.
    costs
        ``(n, n)``: cost of that step away from the neighbors' mean.
    matrix
        Rows t1 and t2.
    sweeps
        How often every node is revised.
    """
    rows, columns, n = surfaces.shape[0], surfaces.shape[1], surfaces.shape[2]
    count = rows * columns
    field, state = np.zeros((rows, columns, 2)), np.zeros((rows, columns), np.int64)
    order = np.zeros(count, np.int64)
    front = [(0.0, int(np.argmax(trust)))]
    determinant = matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0]
    for turn in range(count * (1 + sweeps)):
        if turn < count:
            order[turn] = heapq.heappop(front)[1]
        y, x = order[turn % count] // columns, order[turn % count] % columns
        state[y, x] = 1
        total, near_x, near_y = 0.0, 0.0, 0.0
        for b in range(max(y - 1, 0), min(y + 2, rows)):
            for a in range(max(x - 1, 0), min(x + 2, columns)):
                if state[b, a] == 0:
                    state[b, a] = 2
                    heapq.heappush(front, (-trust[b, a], b * columns + a))
                elif state[b, a] == 1 and (a != x or b != y):
                    total += trust[b, a]
                    near_x += trust[b, a] * field[b, a, 0]
                    near_y += trust[b, a] * field[b, a, 1]
        if total > 0:
            near_x, near_y = near_x / total, near_y / total
        i = int(np.rint(n * (near_x * matrix[1, 1] - near_y * matrix[1, 0]) / determinant))
        j = int(np.rint(n * (near_y * matrix[0, 0] - near_x * matrix[0, 1]) / determinant))
        highest, u, v = -1e30, 0, 0
        for k in range(n):
            for m in range(n):
                value = surfaces[y, x, (k + i) % n, (m + j) % n] - costs[k, m]
                if value > highest:
                    highest, u, v = value, k, m
        for axis in range(2):
            field[y, x, axis] = (i * matrix[0, axis] + j * matrix[1, axis]) / n + steps[u, v, axis]
    return field
