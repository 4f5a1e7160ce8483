"""Compiled loops of :mod:`nrbench.tracking.growth`."""

from __future__ import annotations

import heapq

import numpy as np

from nrbench.jit import Float32x2, Float32x3, Float32x4, Float64x1, Float64x2, Float64x3, Int64x1, Int64x2, kernel


@kernel
def register(
    image: Float32x3,
    template: Float32x2,
    rows: Float32x3,
    normal: Float64x2,
    sums: Float64x2,
    offsets: Float64x2,
    weights: Float64x1,
    reach: Float64x1,
    state: Float64x1,
    predicted: Float64x1,
    prior: Float64x1,
    least_seen: float,
    steps: int,
) -> float:
    """Fit a place and an affine map to a template by Gauss-Newton steps; return the correlation, -1 if not seen.

    The point at ``offset`` of the template is read at ``place + map @ offset`` of the image. Means and deviations under
    the window are taken out of both, so that brightness and contrast do not matter. Only the image is read again in
    each step; where it shows the whole window, all sums over the template alone are given.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    template
        ``(C, n)``: values, of mean 0 in each channel and of variance 1 under the window.
    rows
        ``(6, C, n)``: derivatives of the values by place and map.
    normal
        ``(6, 6)``: mean products of ``rows`` under the window.
    sums
        ``(C + 1, 6)``: mean of ``rows`` under the window in each channel, and mean of their products with the template.
    offsets, weights
        ``(n, 2)`` px and ``(n,)``: the window; the weights have sum 1.
    reach
        ``(2,)``: largest offset along x and y, px.
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
    read, seen = np.zeros((channels, count)), np.zeros(count)
    correlation = -1.0
    a, b = np.zeros((6, 6)), np.zeros(6)
    partial = np.zeros((6, 6))
    has_partial = False
    mean, template_mean = np.zeros(channels), np.zeros(channels)
    for step in range(steps + 1):
        x0, y0 = state[0], state[1]
        xx, xy, yx, yy = state[2], state[3], state[4], state[5]
        across = abs(xx) * reach[0] + abs(xy) * reach[1]
        down = abs(yx) * reach[0] + abs(yy) * reach[1]
        whole = x0 - across >= 0 and y0 - down >= 0 and x0 + across <= width - 1 and y0 + down <= height - 1
        total = 0.0
        for k in range(count):
            x = x0 + xx * offsets[k, 0] + xy * offsets[k, 1]
            y = y0 + yx * offsets[k, 0] + yy * offsets[k, 1]
            if not (whole or (x >= 0 and y >= 0 and x <= width - 1 and y <= height - 1)):
                seen[k] = 0.0
                for c in range(channels):
                    read[c, k] = 0.0
                continue
            seen[k] = weights[k]
            total += weights[k]
            i, j = min(int(y), height - 2), min(int(x), width - 2)
            v, u = y - i, x - j
            for c in range(channels):
                above = (1 - u) * image[i, j, c] + u * image[i, j + 1, c]
                below = (1 - u) * image[i + 1, j, c] + u * image[i + 1, j + 1, c]
                read[c, k] = (1 - v) * above + v * below
        if total < least_seen:
            return -1.0
        power, template_power, product = 0.0, 0.0, 0.0
        for c in range(channels):
            one, square, both = 0.0, 0.0, 0.0
            for k in range(count):
                weighted = seen[k] * read[c, k]
                one += weighted
                square += weighted * read[c, k]
                both += weighted * template[c, k]
            mean[c] = one / total
            power += square - total * mean[c] * mean[c]
            product += both
            template_mean[c] = 0.0
            if not whole:
                own, own_square = 0.0, 0.0
                for k in range(count):
                    own += seen[k] * template[c, k]
                    own_square += seen[k] * template[c, k] * template[c, k]
                template_mean[c] = own / total
                template_power += own_square - total * template_mean[c] * template_mean[c]
                product -= total * template_mean[c] * mean[c]
        if whole:
            template_power = 1.0
        power, template_power = max(power, 1e-12), max(template_power, 1e-12)
        correlation = product / np.sqrt(power * template_power)
        if step == steps:
            break
        gain, template_gain = 1 / np.sqrt(power / total), 1 / np.sqrt(template_power / total)
        for m in range(6):
            of_template = sums[channels, m] if whole else 0.0
            of_image = 0.0
            for c in range(channels):
                one, other, alone = 0.0, 0.0, 0.0
                for k in range(count):
                    one += seen[k] * rows[m, c, k] * read[c, k]
                if whole:
                    alone = sums[c, m]
                else:
                    for k in range(count):
                        weighted = seen[k] * rows[m, c, k]
                        alone += weighted
                        other += weighted * template[c, k]
                of_template += other - alone * template_mean[c]
                of_image += one - alone * mean[c]
            b[m] = template_gain * (template_gain * of_template - gain * of_image)
        if not whole and not has_partial:
            # The part that is seen changes little from step to step.
            has_partial = True
            for m in range(6):
                for n in range(m + 1):
                    one = 0.0
                    for c in range(channels):
                        for k in range(count):
                            one += seen[k] * rows[m, c, k] * rows[n, c, k]
                    partial[m, n] = one
                    partial[n, m] = one
        for m in range(6):
            for n in range(6):
                a[m, n] = template_gain * template_gain * (normal[m, n] if whole else partial[m, n])
        # The departure from the prediction, in units of the template's plane.
        determinant = xx * yy - xy * yx
        if abs(determinant) < 1e-3:
            return -1.0
        ixx, ixy, iyx, iyy = yy / determinant, -xy / determinant, -yx / determinant, xx / determinant
        off_x, off_y = x0 - predicted[0], y0 - predicted[1]
        b[0] -= prior[0] * (ixx * off_x + ixy * off_y)
        b[1] -= prior[0] * (iyx * off_x + iyy * off_y)
        p, q, r, s = xx - predicted[2], xy - predicted[3], yx - predicted[4], yy - predicted[5]
        b[2] -= prior[1] * (ixx * p + ixy * r)
        b[3] -= prior[1] * (ixx * q + ixy * s)
        b[4] -= prior[1] * (iyx * p + iyy * r)
        b[5] -= prior[1] * (iyx * q + iyy * s)
        for m in range(6):
            a[m, m] += prior[0] if m < 2 else prior[1]
        move = np.linalg.solve(a, b)
        state[0] += xx * move[0] + xy * move[1]
        state[1] += yx * move[0] + yy * move[1]
        state[2] += xx * move[2] + xy * move[4]
        state[3] += xx * move[3] + xy * move[5]
        state[4] += yx * move[2] + yy * move[4]
        state[5] += yx * move[3] + yy * move[5]
        if np.sqrt(move[0] ** 2 + move[1] ** 2) < 0.01 and step < steps - 1:
            # One last reading measures the correlation.
            steps = step + 1
    return correlation


@kernel
def grow_knots(
    image: Float32x3,
    templates: Float32x3,
    rows: Float32x4,
    normals: Float64x3,
    sums: Float64x3,
    phases: Int64x2,
    offsets: Float64x2,
    weights: Float64x1,
    points: Float64x3,
    states: Float64x3,
    correlations: Float64x2,
    seed: Int64x1,
    prior: Float64x1,
    levels: Float64x1,
    farthest: float,
    margin: float,
    least_seen: float,
) -> None:
    """Find the places of all knots that are connected with a seed, or with known ones, the most surrounded knot first.

    Each knot is predicted by the places and affine maps of the known knots around it, then registered. It is known if
    it is correlated enough and near the prediction. In each further round every knot is registered again, with all
    knots around it known, and the field grows on. The time is linear in knots times points of a window.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    templates, rows, normals, sums
        ``(p, C, n)``, ``(p, 6, C, n)``, ``(p, 6, 6)`` and ``(p, C + 1, 6)``: see :func:`register`, for each phase of a
        knot in the cell.
    phases
        ``(rows, columns)``: the phase of each knot.
    offsets, weights
        The window, see :func:`register`.
    points
        ``(rows, columns, 2)``: the knots on the plane of the lattice, (x, y) px.
    states
        ``(rows, columns, 6)``: the states of the seed and of known knots; filled with those of the others.
    correlations
        ``(rows, columns)``: those of knots that are known already, 0 of the others; filled with those found.
    seed
        Row and column; negative if there are known knots instead.
    prior
        See :func:`register`.
    levels
        ``(r,)``: correlation from which a knot is known, in each round.
    farthest
        Largest distance, px on the plane, of a known knot from its prediction.
    margin
        Correlation above the level below which a knot is searched for in other places nearby.
    least_seen
        See :func:`register`.
    """
    height, width = correlations.shape
    reach = np.array([np.abs(offsets[:, 0]).max(), np.abs(offsets[:, 1]).max()])
    rank = np.zeros((height, width))
    tried, listed = np.zeros((height, width), np.bool_), np.zeros((height, width), np.bool_)
    state, best, predicted, start = np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(6)
    first_y, first_x = seed[0], seed[1]
    seeded = first_y >= 0
    if seeded:
        correlations[first_y, first_x] = 1e-3
    # The front holds a knot again whenever its rank has grown; what is popped later is old.
    front = [(0.0, 0)]
    for sweep in range(len(levels)):
        level = levels[sweep]
        # A seed alone in its round; else all known knots and those around them.
        tried[:] = False
        listed[:] = False
        first = seeded and sweep == 0
        around = 0 if first else 1
        for y in range(height):
            for x in range(width):
                if correlations[y, x] > 0:
                    for b in range(max(y - around, 0), min(y + around + 1, height)):
                        for a in range(max(x - around, 0), min(x + around + 1, width)):
                            rank[b, a] += correlations[y, x]
                            listed[b, a] = True
        front.clear()
        for y in range(height):
            for x in range(width):
                if listed[y, x]:
                    heapq.heappush(front, (-rank[y, x], y * width + x))
        while len(front) > 0:
            _, chosen = heapq.heappop(front)
            y, x = chosen // width, chosen % width
            if tried[y, x]:
                continue
            tried[y, x] = True
            is_seed = first and y == first_y and x == first_x
            total = 0.0
            predicted[:] = 0
            for b in range(max(y - 2, 0), min(y + 3, height)):
                for a in range(max(x - 2, 0), min(x + 3, width)):
                    if correlations[b, a] <= 0 or (b == y and a == x):
                        continue
                    weight = correlations[b, a] ** 2 / ((b - y) ** 2 + (a - x) ** 2)
                    dx, dy = points[y, x, 0] - points[b, a, 0], points[y, x, 1] - points[b, a, 1]
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
            k = phases[y, x]
            state[:] = states[y, x] if known and not first else predicted
            value = register(
                image,
                templates[k],
                rows[k],
                normals[k],
                sums[k],
                offsets,
                weights,
                reach,
                state,
                predicted,
                prior,
                least_seen,
                8,
            )
            if -1 < value < level + margin:
                # The registration may have stopped beside its maximum. It starts from other places nearby.
                best[:] = state
                highest = value
                for corner in range(4):
                    start[:] = predicted
                    dx = (farthest if corner % 2 else -farthest) / 2
                    dy = (farthest if corner // 2 else -farthest) / 2
                    start[0] += predicted[2] * dx + predicted[3] * dy
                    start[1] += predicted[4] * dx + predicted[5] * dy
                    other = register(
                        image,
                        templates[k],
                        rows[k],
                        normals[k],
                        sums[k],
                        offsets,
                        weights,
                        reach,
                        start,
                        predicted,
                        prior,
                        least_seen,
                        4,
                    )
                    if other > highest:
                        highest = other
                        best[:] = start
                if highest > value:
                    state[:] = best
                    value = register(
                        image,
                        templates[k],
                        rows[k],
                        normals[k],
                        sums[k],
                        offsets,
                        weights,
                        reach,
                        state,
                        predicted,
                        prior,
                        least_seen,
                        4,
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
                for b in range(max(y - 1, 0), min(y + 2, height)):
                    for a in range(max(x - 1, 0), min(x + 2, width)):
                        if tried[b, a] or correlations[b, a] > 0:
                            continue
                        rank[b, a] += value
                        heapq.heappush(front, (-rank[b, a], b * width + a))
            else:
                correlations[y, x] = 0
        rank[:] = 0
