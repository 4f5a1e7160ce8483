"""The compiled loop that moves the vertices of a lattice, one after the other, given their neighbors."""

from __future__ import annotations

import numpy as np

from nrbench.jit import Float64x2, Float64x3, kernel


@kernel
def move_vertices(start: Float64x3, maps: Float64x3, step: float, moves: Float64x2, sweeps: int) -> Float64x3:
    """Return the displacements of the vertices after some rounds (report, appendix A, equation 3).

    In each round every vertex, in the order of rows, takes its most likely move. The likelihood of a move is the
    product of the densities of the offsets to the neighbors that exist. O(rows columns sweeps moves).

    Parameters
    ----------
    start
        ``(rows, columns, 2)``: first displacements (x, y) px.
    maps
        ``(8, g, g)``: logarithm of the density of each neighbor's displacement less the vertex's own, by y and x;
        0 is in the middle. Beyond the map the outermost value holds.
    step
        Step of the maps, px.
    moves
        ``(m, 2)``: the possible moves (x, y) px.
    sweeps
        Number of rounds.

    Notes
    -----
    ::

        for each round, and each vertex:
            for each neighbor that exists, and each move:
                offset = displacement of the neighbor - displacement of the vertex - move
                likelihood of the move += the neighbor's map at the offset, interpolated linearly
            displacement of the vertex += the likeliest move
    """
    field = start.copy()
    rows, columns = field.shape[0], field.shape[1]
    side, count = maps.shape[1], len(moves)
    middle = (side - 1) / 2
    likelihood = np.empty(count)
    for _ in range(sweeps):
        for y in range(rows):
            for x in range(columns):
                # Sum the logarithms of the densities over the neighbors; `number` is the map of the neighbor.
                likelihood[:] = 0
                number = 0
                for down in range(-1, 2):
                    for right in range(-1, 2):
                        if down == 0 and right == 0:
                            continue
                        b, a = y + down, x + right
                        if 0 <= b < rows and 0 <= a < columns:
                            off_x, off_y = field[b, a, 0] - field[y, x, 0], field[b, a, 1] - field[y, x, 1]
                            for m in range(count):
                                # The place in the map of the offset after the move, moved onto the border from beyond.
                                at_x = min(max((off_x - moves[m, 0]) / step + middle, 0.0), side - 1.0)
                                at_y = min(max((off_y - moves[m, 1]) / step + middle, 0.0), side - 1.0)
                                i, j = min(int(at_y), side - 2), min(int(at_x), side - 2)
                                # Interpolate along x in two rows of the map, then between the rows.
                                v, u = at_y - i, at_x - j
                                above = (1 - u) * maps[number, i, j] + u * maps[number, i, j + 1]
                                below = (1 - u) * maps[number, i + 1, j] + u * maps[number, i + 1, j + 1]
                                likelihood[m] += (1 - v) * above + v * below
                        number += 1
                # The vertex moves at once, so the next ones see its new place.
                best = int(np.argmax(likelihood))
                field[y, x, 0] += moves[best, 0]
                field[y, x, 1] += moves[best, 1]
    return field
