"""Compiled loops of :mod:`nrbench.tracking.growth`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nrbench.jit import kernel


@kernel(
    "float64(float32[:, :, ::1], float32[:, ::1], float32[:, :, ::1], float64[:, ::1], float64[::1], float64[::1],"
    " float64[::1], float64[::1], float64, int64)"
)
def register(
    image: NDArray[np.float32],
    template: NDArray[np.float32],
    slopes: NDArray[np.float32],
    offsets: NDArray[np.float64],
    weights: NDArray[np.float64],
    state: NDArray[np.float64],
    predicted: NDArray[np.float64],
    prior: NDArray[np.float64],
    least_seen: float,
    steps: int,
) -> float:
    """Fit a place and an affine map to a template by Gauss-Newton steps; return the correlation, -1 if not seen.

    The point at ``offset`` of the template is read at ``place + map @ offset`` of the image. Means and deviations under
    the window are taken out of both, so that brightness and contrast do not matter.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    template, slopes
        ``(n, C)`` and ``(n, C, 2)``: values, and their derivatives along x and y of the template's plane.
    offsets, weights
        ``(n, 2)`` px and ``(n,)``: the window.
    state
        ``(6,)``: place x, y and the map xx, xy, yx, yy; replaced by the result.
    predicted
        ``(6,)``: the state from which departures cost.
    prior
        ``(2,)``: costs of a squared departure of the place, per px^2, and of the map.
    least_seen
        Share of the window that must lie in the image.
    steps
        Number of steps; 0 only measures the correlation.
    """
    height, width, channels = image.shape
    count = len(weights)
    read = np.empty((count, channels))
    seen = np.empty(count, np.bool_)
    correlation = -1.0
    a, b = np.zeros((6, 6)), np.zeros(6)
    row = np.zeros(6)
    for step in range(steps + 1):
        total = 0.0
        mean, template_mean = np.zeros(channels), np.zeros(channels)
        for k in range(count):
            x = state[0] + state[2] * offsets[k, 0] + state[3] * offsets[k, 1]
            y = state[1] + state[4] * offsets[k, 0] + state[5] * offsets[k, 1]
            seen[k] = x >= 0 and y >= 0 and x <= width - 1 and y <= height - 1
            if not seen[k]:
                continue
            i, j = min(int(y), height - 2), min(int(x), width - 2)
            v, u = y - i, x - j
            total += weights[k]
            for c in range(channels):
                above = (1 - u) * image[i, j, c] + u * image[i, j + 1, c]
                below = (1 - u) * image[i + 1, j, c] + u * image[i + 1, j + 1, c]
                read[k, c] = (1 - v) * above + v * below
                mean[c] += weights[k] * read[k, c]
                template_mean[c] += weights[k] * template[k, c]
        if total < least_seen:
            return -1.0
        power, template_power, product = 1e-12, 1e-12, 0.0
        for c in range(channels):
            mean[c] /= total
            template_mean[c] /= total
        for k in range(count):
            if seen[k]:
                for c in range(channels):
                    one, other = read[k, c] - mean[c], template[k, c] - template_mean[c]
                    power += weights[k] * one * one
                    template_power += weights[k] * other * other
                    product += weights[k] * one * other
        correlation = product / np.sqrt(power * template_power)
        if step == steps:
            break
        gain, template_gain = 1 / np.sqrt(power / total), 1 / np.sqrt(template_power / total)
        a[:] = 0
        b[:] = 0
        for k in range(count):
            if not seen[k]:
                continue
            dx, dy = offsets[k, 0], offsets[k, 1]
            for c in range(channels):
                gx, gy = slopes[k, c, 0] * template_gain, slopes[k, c, 1] * template_gain
                rest = (template[k, c] - template_mean[c]) * template_gain - (read[k, c] - mean[c]) * gain
                row[0], row[1], row[2] = gx, gy, gx * dx
                row[3], row[4], row[5] = gx * dy, gy * dx, gy * dy
                for m in range(6):
                    weighted = weights[k] * row[m]
                    b[m] += weighted * rest
                    for n in range(m + 1):
                        a[m, n] += weighted * row[n]
        for m in range(6):
            for n in range(m):
                a[n, m] = a[m, n]
        # The departure from the prediction, in units of the template's plane.
        determinant = state[2] * state[5] - state[3] * state[4]
        if abs(determinant) < 1e-3:
            return -1.0
        xx, xy = state[5] / determinant, -state[3] / determinant
        yx, yy = -state[4] / determinant, state[2] / determinant
        off_x, off_y = state[0] - predicted[0], state[1] - predicted[1]
        b[0] -= prior[0] * (xx * off_x + xy * off_y)
        b[1] -= prior[0] * (yx * off_x + yy * off_y)
        p, q, r, s = (
            state[2] - predicted[2],
            state[3] - predicted[3],
            state[4] - predicted[4],
            state[5] - predicted[5],
        )
        b[2] -= prior[1] * (xx * p + xy * r)
        b[3] -= prior[1] * (xx * q + xy * s)
        b[4] -= prior[1] * (yx * p + yy * r)
        b[5] -= prior[1] * (yx * q + yy * s)
        for m in range(6):
            a[m, m] += prior[0] if m < 2 else prior[1]
        move = np.linalg.solve(a, b)
        size = np.sqrt(move[0] ** 2 + move[1] ** 2)
        xx, xy, yx, yy = state[2], state[3], state[4], state[5]
        state[0] += xx * move[0] + xy * move[1]
        state[1] += yx * move[0] + yy * move[1]
        state[2] += xx * move[2] + xy * move[4]
        state[3] += xx * move[3] + xy * move[5]
        state[4] += yx * move[2] + yy * move[4]
        state[5] += yx * move[3] + yy * move[5]
        if size < 0.01 and step < steps - 1:
            # One last reading measures the correlation.
            steps = step + 1
    return correlation


@kernel(
    "void(float32[:, :, ::1], float32[:, :, ::1], float32[:, :, :, ::1], int64[:, ::1], float64[:, ::1], float64[::1],"
    " float64[:, ::1], float64[:, :, ::1], float64[:, ::1], int64[::1], float64[::1], float64[::1], float64, float64)"
)
def grow_knots(
    image: NDArray[np.float32],
    templates: NDArray[np.float32],
    slopes: NDArray[np.float32],
    phases: NDArray[np.int64],
    offsets: NDArray[np.float64],
    weights: NDArray[np.float64],
    steps: NDArray[np.float64],
    states: NDArray[np.float64],
    correlations: NDArray[np.float64],
    seed: NDArray[np.int64],
    prior: NDArray[np.float64],
    levels: NDArray[np.float64],
    farthest: float,
    least_seen: float,
) -> None:
    """Find the places of all knots that are connected with a seed, the most surrounded knot first.

    Each knot is predicted by the places and affine maps of the known knots around it, then registered. It is known if
    it is correlated enough and near the prediction. In each further round every knot is registered again, with all
    knots around it known, and the field grows on. The time is linear in knots times points of a window. The scan for
    the next knot is fast, but quadratic in the knots.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    templates, slopes
        ``(p, n, C)`` and ``(p, n, C, 2)``: see :func:`register`, for each phase of a knot in the cell.
    phases
        ``(rows, columns)``: the phase of each knot.
    offsets, weights
        The window, see :func:`register`.
    steps
        ``(2, 2)``: rows: the vector on the plane from a knot to the next one along a row, and along a column.
    states
        ``(rows, columns, 6)``: the seed's state; filled with those of the others.
    correlations
        ``(rows, columns)``: filled with the correlation of each known knot, 0 of the others.
    seed
        Row and column.
    prior
        See :func:`register`.
    levels
        ``(r,)``: correlation from which a knot is known, in each round.
    farthest
        Largest distance, px on the plane, of a known knot from its prediction.
    least_seen
        See :func:`register`.
    """
    rows, columns = correlations.shape
    ranks = np.zeros(rows * columns)
    rank = ranks.reshape(rows, columns)
    tried = np.zeros((rows, columns), np.bool_)
    listed = np.zeros((rows, columns), np.bool_)
    front, waiting = np.zeros(rows * columns, np.int64), 0
    state, best, predicted, start = np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(6)
    first_y, first_x = seed[0], seed[1]
    correlations[first_y, first_x] = 1e-3
    for sweep in range(len(levels)):
        level = levels[sweep]
        # The seed in the first round; then all known knots and those around them.
        waiting = 0
        tried[:] = False
        listed[:] = False
        around = 0 if sweep == 0 else 1
        for y in range(rows):
            for x in range(columns):
                if correlations[y, x] > 0:
                    for b in range(max(y - around, 0), min(y + around + 1, rows)):
                        for a in range(max(x - around, 0), min(x + around + 1, columns)):
                            rank[b, a] += correlations[y, x]
                            if not listed[b, a]:
                                listed[b, a] = True
                                front[waiting] = b * columns + a
                                waiting += 1
        while waiting > 0:
            chosen = 0
            for k in range(1, waiting):
                if (
                    rank[front[k] // columns, front[k] % columns]
                    > rank[front[chosen] // columns, front[chosen] % columns]
                ):
                    chosen = k
            y, x = front[chosen] // columns, front[chosen] % columns
            waiting -= 1
            front[chosen] = front[waiting]
            listed[y, x] = False
            tried[y, x] = True
            is_seed = sweep == 0 and y == first_y and x == first_x
            total = 0.0
            predicted[:] = 0
            for b in range(max(y - 2, 0), min(y + 3, rows)):
                for a in range(max(x - 2, 0), min(x + 3, columns)):
                    if correlations[b, a] <= 0 or (b == y and a == x):
                        continue
                    weight = correlations[b, a] ** 2 / ((b - y) ** 2 + (a - x) ** 2)
                    dx = (x - a) * steps[0, 0] + (y - b) * steps[1, 0]
                    dy = (x - a) * steps[0, 1] + (y - b) * steps[1, 1]
                    total += weight
                    predicted[0] += weight * (states[b, a, 0] + states[b, a, 2] * dx + states[b, a, 3] * dy)
                    predicted[1] += weight * (states[b, a, 1] + states[b, a, 4] * dx + states[b, a, 5] * dy)
                    for m in range(2, 6):
                        predicted[m] += weight * states[b, a, m]
            if is_seed:
                predicted[:] = states[y, x]
            elif total > 0:
                predicted /= total
            else:
                correlations[y, x] = 0
                continue
            known = correlations[y, x] > 0
            phase = phases[y, x]
            state[:] = states[y, x] if sweep > 0 and known else predicted
            value = register(
                image, templates[phase], slopes[phase], offsets, weights, state, predicted, prior, least_seen, 8
            )
            if -1 < value < level + 0.1:
                # The registration may have stopped beside its maximum: it starts from other places nearby.
                best[:] = state
                highest = value
                for corner in range(4):
                    start[:] = predicted
                    dx = (farthest if corner % 2 else -farthest) / 2
                    dy = (farthest if corner // 2 else -farthest) / 2
                    start[0] += predicted[2] * dx + predicted[3] * dy
                    start[1] += predicted[4] * dx + predicted[5] * dy
                    other = register(
                        image, templates[phase], slopes[phase], offsets, weights, start, predicted, prior, least_seen, 4
                    )
                    if other > highest:
                        highest = other
                        best[:] = start
                if highest > value:
                    state[:] = best
                    value = register(
                        image, templates[phase], slopes[phase], offsets, weights, state, predicted, prior, least_seen, 4
                    )
            determinant = predicted[2] * predicted[5] - predicted[3] * predicted[4]
            own = state[2] * state[5] - state[3] * state[4]
            off_x, off_y = state[0] - predicted[0], state[1] - predicted[1]
            near = False
            if own > 0.1 * determinant and determinant > 0:
                across = (predicted[5] * off_x - predicted[3] * off_y) / determinant
                down = (predicted[2] * off_y - predicted[4] * off_x) / determinant
                near = across * across + down * down <= farthest * farthest
            if value >= level and near:
                states[y, x] = state
                correlations[y, x] = value
                for b in range(max(y - 1, 0), min(y + 2, rows)):
                    for a in range(max(x - 1, 0), min(x + 2, columns)):
                        if tried[b, a] or correlations[b, a] > 0:
                            continue
                        rank[b, a] += value
                        if not listed[b, a]:
                            listed[b, a] = True
                            front[waiting] = b * columns + a
                            waiting += 1
            else:
                correlations[y, x] = 0
        rank[:] = 0
