"""Compiled loops of :mod:`nrbench.displacement.growth`.

A *state* is ``(6,)``: the place x, y of a knot in the image and the map M = (xx, xy, yx, yy) of the window around it.
The point of the template at ``offset`` is read at ``place + M @ offset``.
"""

from __future__ import annotations

import heapq

import numpy as np

from nrbench.jit import (
    Boolx2,
    Float32x2,
    Float32x3,
    Float32x4,
    Float64x1,
    Float64x2,
    Float64x3,
    Int64x2,
    allocating_step_kernel,
    inlined_kernel,
    kernel,
)

Template = tuple[Float32x2, Float32x3, Float64x2, Float64x2]
"""What a window is registered with, in four arrays.

``(C, n)``: values, of mean 0 in each channel and of variance 1 under the window. ``(6, C, n)``: rows, the derivatives
of the values by place and map. ``(6, 6)``: mean products of the rows under the window. ``(C + 1, 6)``: mean of the rows
in each channel, and mean of their products with the values.
"""
Templates = tuple[Float32x3, Float32x4, Float64x3, Float64x3]
"""The arrays of p templates, with p as their first axis."""
Window = tuple[Float64x2, Float64x1, Float64x1]
"""``(n, 2)`` px: the offsets of the points of a window from its middle. ``(n,)``: their weights, of sum 1. ``(2,)`` px:
the largest offset along x and y."""
Grid = tuple[Float64x3, Int64x2]
"""``(rows, columns, 2)``: the knots on the plane of the lattice, (x, y) px. ``(rows, columns)``: the phase of each knot
in the cell, the number of its template."""
Found = tuple[Float64x3, Float64x2]
"""``(rows, columns, 6)``: the states of the knots that are known. ``(rows, columns)``: their correlations, 0 of the
others."""
Rules = tuple[Float64x1, float, float]
"""``(2,)``: costs of a squared departure from the prediction: of the place, per px^2, and of the map. The largest
distance, px on the plane, of a known knot from its prediction. The share of a window that must lie in the image."""
Reading = tuple[Float64x2, Float64x1, Float64x1, Float64x1]
"""What an image shows under a window, in four arrays.

``(C, n)``: the values, 0 outside the image. ``(n,)``: the weights, 0 outside. ``(C,)`` twice: the means of the
image and of the template.
"""


@inlined_kernel
def shows_window(state: Float64x1, reach: Float64x1, height: int, width: int) -> bool:
    """Return whether the image shows the whole window: the box around the mapped window lies in it."""
    across = abs(state[2]) * reach[0] + abs(state[3]) * reach[1]
    down = abs(state[4]) * reach[0] + abs(state[5]) * reach[1]
    inside_x = state[0] - across >= 0 and state[0] + across <= width - 1
    return bool(inside_x and state[1] - down >= 0 and state[1] + down <= height - 1)


@inlined_kernel
def read_window(image: Float32x3, state: Float64x1, window: Window, whole: bool, reading: Reading) -> float:
    """Read the image at ``place + map @ offset``, bilinear; return the sum of the weights of the points seen."""
    (offsets, weights, _), (read, seen, _, _) = window, reading
    height, width, channels = image.shape
    x0, y0, xx, xy, yx, yy = state[0], state[1], state[2], state[3], state[4], state[5]
    total = 0.0
    for k in range(len(weights)):
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
    return total


@inlined_kernel
def measure_powers(template: Float32x2, total: float, whole: bool, reading: Reading) -> tuple[float, float, float]:
    """Return sum w (f - mean f)^2, sum w (t - mean t)^2 and sum w (f - mean f) (t - mean t), for image f, template t.

    The means of each channel are filled in. Under the whole window the template has mean 0 and power 1.
    """
    read, seen, mean, template_mean = reading
    power, template_power, product = 0.0, 0.0, 0.0
    for c in range(len(mean)):
        values, squares, products = 0.0, 0.0, 0.0
        for k in range(len(seen)):
            weighted = seen[k] * read[c, k]
            values += weighted
            squares += weighted * read[c, k]
            products += weighted * template[c, k]
        mean[c] = values / total
        power += squares - total * mean[c] * mean[c]
        product += products
        template_mean[c] = 0.0
        if not whole:
            template_values, template_squares = 0.0, 0.0
            for k in range(len(seen)):
                template_values += seen[k] * template[c, k]
                template_squares += seen[k] * template[c, k] * template[c, k]
            template_mean[c] = template_values / total
            template_power += template_squares - total * template_mean[c] * template_mean[c]
            product -= total * template_mean[c] * mean[c]
    if whole:
        template_power = 1.0
    return max(power, 1e-12), max(template_power, 1e-12), product


@inlined_kernel
def project_difference(
    template: Template, whole: bool, reading: Reading, gain: float, template_gain: float, b: Float64x1
) -> None:
    """Fill b with sum w r (t' - f'): the projections of the difference of template t' and image f' on the rows r.

    Both are normalized, ``t' = template_gain (t - mean t)`` and ``f' = gain (f - mean f)``; the rows have the factor
    ``template_gain``.
    """
    values, rows, _, sums = template
    read, seen, mean, template_mean = reading
    channels = len(mean)
    for m in range(6):
        of_template = sums[channels, m] if whole else 0.0
        of_image = 0.0
        for c in range(channels):
            with_image, with_template, alone = 0.0, 0.0, 0.0
            for k in range(len(seen)):
                with_image += seen[k] * rows[m, c, k] * read[c, k]
            if whole:
                alone = sums[c, m]
            else:
                for k in range(len(seen)):
                    weighted = seen[k] * rows[m, c, k]
                    alone += weighted
                    with_template += weighted * values[c, k]
            of_template += with_template - alone * template_mean[c]
            of_image += with_image - alone * mean[c]
        b[m] = template_gain * (template_gain * of_template - gain * of_image)


@inlined_kernel
def sum_products_of_rows(seen: Float64x1, rows: Float32x3, products: Float64x2) -> None:
    """Fill the matrix sum w r r^T of the rows r over the points that are seen, ``(6, 6)``."""
    for m in range(6):
        for n in range(m + 1):
            total = 0.0
            for c in range(rows.shape[1]):
                for k in range(len(seen)):
                    total += seen[k] * rows[m, c, k] * rows[n, c, k]
            products[m, n] = total
            products[n, m] = total


@inlined_kernel
def add_prior(
    a: Float64x2, b: Float64x1, state: Float64x1, predicted: Float64x1, prior: Float64x1, determinant: float
) -> None:
    """Add the cost of departing from the prediction: prior I to a, and -prior M^-1 (state - predicted) to b.

    M is the map of the state, so departures count on the plane of the template.
    """
    xx, xy, yx, yy = state[2], state[3], state[4], state[5]
    ixx, ixy, iyx, iyy = yy / determinant, -xy / determinant, -yx / determinant, xx / determinant
    off_x, off_y = state[0] - predicted[0], state[1] - predicted[1]
    b[0] -= prior[0] * (ixx * off_x + ixy * off_y)
    b[1] -= prior[0] * (iyx * off_x + iyy * off_y)
    p, q, r, s = xx - predicted[2], xy - predicted[3], yx - predicted[4], yy - predicted[5]
    b[2] -= prior[1] * (ixx * p + ixy * r)
    b[3] -= prior[1] * (ixx * q + ixy * s)
    b[4] -= prior[1] * (iyx * p + iyy * r)
    b[5] -= prior[1] * (iyx * q + iyy * s)
    for m in range(6):
        a[m, m] += prior[0] if m < 2 else prior[1]


@inlined_kernel
def solve_normal_equations(a: Float64x2, b: Float64x1) -> None:
    """Replace b by the solution m of a m = b, for a symmetric positive definite; a by its factors L D L^T.

    For six unknowns this takes a fraction of a call of LAPACK, which numba reaches by importing scipy.linalg.
    """
    for m in range(6):
        for n in range(m):
            for k in range(n):
                a[m, n] -= a[m, k] * a[n, k] * a[k, k]
            a[m, n] /= a[n, n]
            a[m, m] -= a[m, n] * a[m, n] * a[n, n]
            b[m] -= a[m, n] * b[n]
    for m in range(5, -1, -1):
        b[m] /= a[m, m]
        for n in range(m + 1, 6):
            b[m] -= a[n, m] * b[n]


@inlined_kernel
def move_state(state: Float64x1, move: Float64x1) -> None:
    """Add a step on the plane of the template to the state: M @ move, for the place and for both columns of the map."""
    xx, xy, yx, yy = state[2], state[3], state[4], state[5]
    state[0] += xx * move[0] + xy * move[1]
    state[1] += yx * move[0] + yy * move[1]
    state[2] += xx * move[2] + xy * move[4]
    state[3] += xx * move[3] + xy * move[5]
    state[4] += yx * move[2] + yy * move[4]
    state[5] += yx * move[3] + yy * move[5]


@allocating_step_kernel
def register(
    image: Float32x3,
    template: Template,
    window: Window,
    state: Float64x1,
    predicted: Float64x1,
    rules: Rules,
    steps: int,
) -> float:
    """Fit a state to a template by Gauss-Newton steps; return the correlation, -1 if too little is seen.

    Means and deviations under the window are taken out of both, so that brightness and contrast do not matter.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    template, window, rules
        See :data:`Template`, :data:`Window` and :data:`Rules`.
    state
        ``(6,)``: where to start; replaced by the result.
    predicted
        ``(6,)``: the state from which departures cost.
    steps
        Number of steps; 0 only measures the correlation.

    Notes
    -----
    With the normalized template t', the normalized image f' read at the state, the weights w of the window, and the
    rows r = dt'/d(place, map), the cost of a move m of the state is

        sum w (f' - t' + r m)^2 + prior |M^-1 (state - predicted) + m|^2,

    which is least where (sum w r r^T + prior I) m = sum w r (t' - f') - prior M^-1 (state - predicted). The move is
    made on the plane of the template: the place and the map become M-fold of it (inverse compositional registration;
    Baker and Matthews 2004, International Journal of Computer Vision 56). Only the image is read again in each step;
    where it shows the whole window, all sums over the template alone are given. Cost of a step: points of the window
    times channels.
    """
    values, rows, normal, _ = template
    _, weights, reach = window
    prior, _, least_seen = rules
    height, width, channels = image.shape
    seen = np.zeros(len(weights))
    reading = (np.zeros((channels, len(weights))), seen, np.zeros(channels), np.zeros(channels))
    a, b, partial = np.zeros((6, 6)), np.zeros(6), np.zeros((6, 6))
    correlation, has_partial = -1.0, False
    for step in range(steps + 1):
        # Read the image at the state, and correlate it with the template.
        whole = shows_window(state, reach, height, width)
        total = read_window(image, state, window, whole, reading)
        if total < least_seen:
            return -1.0
        power, template_power, product = measure_powers(values, total, whole, reading)
        correlation = product / np.sqrt(power * template_power)
        if step == steps:
            break
        # Set up the normal equations a m = b; the part of a window that is seen changes little from step to step.
        gain, template_gain = 1 / np.sqrt(power / total), 1 / np.sqrt(template_power / total)
        project_difference(template, whole, reading, gain, template_gain, b)
        if not whole and not has_partial:
            has_partial = True
            sum_products_of_rows(seen, rows, partial)
        for m in range(6):
            for n in range(6):
                a[m, n] = template_gain * template_gain * (normal[m, n] if whole else partial[m, n])
        determinant = state[2] * state[5] - state[3] * state[4]
        if abs(determinant) < 1e-3:
            return -1.0
        add_prior(a, b, state, predicted, prior, determinant)
        # Move the state. After a short move one last reading measures the correlation.
        solve_normal_equations(a, b)
        move_state(state, b)
        if np.sqrt(b[0] ** 2 + b[1] ** 2) < 0.01 and step < steps - 1:
            steps = step + 1
    return correlation


@inlined_kernel
def list_front(correlations: Float64x2, rank: Float64x2, listed: Boolx2, front: list[tuple[float, int]]) -> None:
    """Fill the front with the known knots and their eight neighbors.

    The rank of a knot is the sum of the correlations of the known knots around it. Its own counts a trace more, so that
    a knot which alone is known comes before its neighbors.
    """
    height, width = correlations.shape
    rank[:] = 0
    listed[:] = False
    for y in range(height):
        for x in range(width):
            if correlations[y, x] > 0:
                rank[y, x] += 1e-6 * correlations[y, x]
                for b in range(max(y - 1, 0), min(y + 2, height)):
                    for a in range(max(x - 1, 0), min(x + 2, width)):
                        rank[b, a] += correlations[y, x]
                        listed[b, a] = True
    front.clear()
    for y in range(height):
        for x in range(width):
            if listed[y, x]:
                heapq.heappush(front, (-rank[y, x], y * width + x))


@inlined_kernel
def predict_state(
    points: Float64x3, states: Float64x3, correlations: Float64x2, y: int, x: int, predicted: Float64x1
) -> bool:
    """Predict the state of a knot by the affine maps of the known knots at most two rows and columns away.

    Their weights are correlation^2 / distance^2. Return whether there are any.
    """
    height, width = correlations.shape
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
    if total > 0:
        predicted /= total
    return total > 0


@inlined_kernel
def is_near(state: Float64x1, predicted: Float64x1, farthest: float) -> bool:
    """Return whether a place lies at most ``farthest`` px, on the plane, from the predicted one, and not turned over.

    The distance is that of M^-1 (place - predicted place) for the predicted map M.
    """
    determinant = predicted[2] * predicted[5] - predicted[3] * predicted[4]
    if determinant <= 0 or state[2] * state[5] - state[3] * state[4] <= 0.1 * determinant:
        return False
    off_x, off_y = state[0] - predicted[0], state[1] - predicted[1]
    across = (predicted[5] * off_x - predicted[3] * off_y) / determinant
    down = (predicted[2] * off_y - predicted[4] * off_x) / determinant
    return bool(across * across + down * down <= farthest * farthest)


@inlined_kernel
def promote_neighbors(
    correlations: Float64x2, tried: Boolx2, y: int, x: int, rank: Float64x2, front: list[tuple[float, int]]
) -> None:
    """Raise the ranks of the unknown neighbors of a knot by its correlation, and add them to the front."""
    height, width = correlations.shape
    for b in range(max(y - 1, 0), min(y + 2, height)):
        for a in range(max(x - 1, 0), min(x + 2, width)):
            if tried[b, a] or correlations[b, a] > 0:
                continue
            rank[b, a] += correlations[y, x]
            heapq.heappush(front, (-rank[b, a], b * width + a))


@inlined_kernel
def copy_values(source: Float64x1, target: Float64x1) -> None:
    """Copy all values of an array to another one. The check of an assignment for equal shapes compiles for a second."""
    for i in range(source.size):
        target[i] = source[i]


@inlined_kernel
def search_nearby(
    image: Float32x3,
    template: Template,
    window: Window,
    state: Float64x1,
    predicted: Float64x1,
    rules: Rules,
    value: float,
) -> float:
    """Register a window from four places around the predicted one; return the correlation, and keep the better state.

    The four places lie half of the largest distance from the predicted one along x and y of the plane. ``value`` is the
    correlation of ``state``.
    """
    best, start, highest = state.copy(), np.zeros(6), value
    for corner in range(4):
        copy_values(predicted, start)
        dx = (rules[1] if corner % 2 else -rules[1]) / 2
        dy = (rules[1] if corner // 2 else -rules[1]) / 2
        start[0] += predicted[2] * dx + predicted[3] * dy
        start[1] += predicted[4] * dx + predicted[5] * dy
        other = register(image, template, window, start, predicted, rules, 4)
        if other > highest:
            highest = other
            copy_values(start, best)
    if highest > value:
        copy_values(best, state)
        value = register(image, template, window, state, predicted, rules, 4)
    return value


@kernel
def grow_knots(
    image: Float32x3, templates: Templates, window: Window, grid: Grid, found: Found, levels: Float64x1, rules: Rules
) -> None:
    """Find the places of all knots that are connected with known ones, the most surrounded knot first.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    templates, window, grid, rules
        See :data:`Templates`, :data:`Window`, :data:`Grid` and :data:`Rules`.
    found
        The known knots, see :data:`Found`; replaced by those that are found. At a start, one knot has the state from
        which to start and a small correlation.
    levels
        ``(r,)``: correlation from which a knot is known, in each round.

    Notes
    -----
    Reliability-guided digital image correlation (B. Pan, Applied Optics 48, 2009)::

        for each level:
            front = known knots and their neighbors
            while the front is not empty:
                knot = the one in the front whose known neighbors correlate most; once in each round
                predicted = mean of what the affine maps of the known neighbors say, else its own state
                state = register(knot, from its own state if it is known, else from the predicted one)
                if it correlates less than the level: register it from four places nearby, too
                if it reaches the level, near the prediction: it is known, and its neighbors join the front
                else: it is not known

    The time is linear in knots times points of a window.
    """
    values, rows, normals, sums = templates
    points, phases = grid
    states, correlations = found
    height, width = correlations.shape
    rank = np.zeros((height, width))
    tried, listed = np.zeros((height, width), np.bool_), np.zeros((height, width), np.bool_)
    state, predicted = np.zeros(6), np.zeros(6)
    front = [(0.0, 0)]
    for level in levels:
        tried[:] = False
        list_front(correlations, rank, listed, front)
        while len(front) > 0:
            # The front holds a knot again whenever its rank has grown; what is popped later is old.
            _, chosen = heapq.heappop(front)
            y, x = chosen // width, chosen % width
            if tried[y, x]:
                continue
            tried[y, x] = True
            # Predict the knot.
            is_known = correlations[y, x] > 0
            if not predict_state(points, states, correlations, y, x, predicted):
                if not is_known:
                    continue
                copy_values(states[y, x], predicted)
            # Register it.
            k = phases[y, x]
            template = (values[k], rows[k], normals[k], sums[k])
            copy_values(states[y, x] if is_known else predicted, state)
            value = register(image, template, window, state, predicted, rules, 8)
            if -1 < value < level:
                # The registration may have stopped beside its maximum.
                value = search_nearby(image, template, window, state, predicted, rules, value)
            # Keep it, or not.
            correlations[y, x] = 0
            if value >= level and is_near(state, predicted, rules[1]):
                copy_values(state, states[y, x])
                correlations[y, x] = value
                promote_neighbors(correlations, tried, y, x, rank, front)
