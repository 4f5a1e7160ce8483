"""Compiled loops that read the spline surface of an autocorrelation at lags."""

from __future__ import annotations

import numpy as np

from nrbench.detectors.autocorrelation.vector_pair_kernels import count_multiples, count_rows, half_row, row_ends
from nrbench.jit import Float64x1, Float64x2, Float64x3, Int64x2, allocating_step_kernel, kernel, step_kernel


@kernel
def jets(spline: Float64x2, at: Float64x2) -> Float64x2:
    """Return the value and the derivatives of a cubic spline surface at real-valued positions.

    Parameters
    ----------
    spline
        ``(H, W)``: B-spline coefficients, one for each sample.
    at
        ``(n, 2)``: (x, y) in samples, at least 1 from the first and 3 from the last along each axis.

    Returns
    -------
    NDArray
        ``(n, 6)``: value, and the derivatives by x, y, xx, yy and xy.

    Notes
    -----
    :func:`scipy.ndimage.map_coordinates` gives the value only; Newton's method needs the derivatives.
    """
    out = np.zeros((at.shape[0], 6))
    weight, slope, bend = np.zeros((2, 4)), np.zeros((2, 4)), np.zeros((2, 4))
    for i in range(at.shape[0]):
        column, row = int(np.floor(at[i, 0])), int(np.floor(at[i, 1]))
        for axis in range(2):
            t = at[i, 0] - column if axis == 0 else at[i, 1] - row
            u = 1 - t
            weight[axis, 0], weight[axis, 3] = u * u * u / 6, t * t * t / 6
            weight[axis, 1] = 2 / 3 - t * t * (2 - t) / 2
            weight[axis, 2] = 2 / 3 - u * u * (2 - u) / 2
            slope[axis, 0], slope[axis, 3] = -u * u / 2, t * t / 2
            slope[axis, 1], slope[axis, 2] = -2 * t + 1.5 * t * t, 2 * u - 1.5 * u * u
            bend[axis, 0], bend[axis, 1], bend[axis, 2], bend[axis, 3] = u, 3 * t - 2, 3 * u - 2, t
        for j in range(4):
            value, along, twice = 0.0, 0.0, 0.0
            for k in range(4):
                c = spline[row + j - 1, column + k - 1]
                value += c * weight[0, k]
                along += c * slope[0, k]
                twice += c * bend[0, k]
            out[i, 0] += value * weight[1, j]
            out[i, 1] += along * weight[1, j]
            out[i, 2] += value * slope[1, j]
            out[i, 3] += twice * weight[1, j]
            out[i, 4] += value * bend[1, j]
            out[i, 5] += along * slope[1, j]
    return out


@step_kernel
def height_at(spline: Float64x2, across: float, down: float) -> float:
    """Return the value of a cubic spline surface at a position as for :func:`jets`."""
    column, row = int(across), int(down)
    t, r = across - column, down - row
    u, s = 1 - t, 1 - r
    before, here = u * u * u / 6, 2 / 3 - t * t * (2 - t) / 2
    after, last = 2 / 3 - u * u * (1 + t) / 2, t * t * t / 6
    # Unsigned indices spare the test for indices from the end.
    x, top = np.uint64(column - 1), np.uint64(row - 1)
    x1, x2, x3 = np.uint64(column), np.uint64(column + 1), np.uint64(column + 2)
    value = 0.0
    for j in range(4):
        if j == 0:
            weight = s * s * s / 6
        elif j == 1:
            weight = 2 / 3 - r * r * (2 - r) / 2
        elif j == 2:
            weight = 2 / 3 - s * s * (1 + r) / 2
        else:
            weight = r * r * r / 6
        y = top + np.uint64(j)
        value += weight * (spline[y, x] * before + spline[y, x1] * here + spline[y, x2] * after + spline[y, x3] * last)
    return value


@step_kernel
def draw_step(state: int, mean: int) -> tuple[int, int]:
    """Return the next state of a random generator, and a random step from 1 to 2 ``mean`` - 1.

    The generator is Lehmer's, state = 48271 state mod (2^31 - 1). As 2^31 is 1 by this modulus, the bits above the 31st
    are added to those below. A division would take longer than all else in the loop.
    """
    state *= 48271
    state = (state & 2147483647) + (state >> 31)
    if state >= 2147483647:
        state -= 2147483647
    return state, 1 + ((state * (2 * mean - 1)) >> 31)


@step_kernel
def is_multiple(inverse: Float64x2, x: float, y: float) -> bool:
    """Return whether a lag is a point of a lattice, given the inverse of its basis, up to 0.02 of each vector."""
    u, v = x * inverse[0, 0] + y * inverse[1, 0], x * inverse[0, 1] + y * inverse[1, 1]
    return bool(max(abs(u - np.rint(u)), abs(v - np.rint(v))) < 0.02)


@kernel
def rate_added_points(
    spline: Float64x2, bases: Float64x3, coarser: Float64x2, end: Float64x1, pad: int, most: int
) -> Float64x2:
    """Return mean and variance of an autocorrelation at those points of each lattice that a coarser lattice lacks.

    Parameters
    ----------
    spline
        ``(2H-1, pad + W)``: B-spline coefficients of the right half, with ``pad`` mirrored columns on the left.
    bases
        ``(n, 2, 2)``, rows (x, y) px: the bases of the lattices.
    coarser
        ``(2, 2)``: the inverse of the coarser lattice's basis. If all entries are zero, only lag 0 is left out.
    end
        Largest lag (x, y), px. Each lag is weighted by the area in which the image overlaps its shifted copy.
    pad
        Number of mirrored columns.
    most
        About the largest number of lags that are read: of more lags, a random sample. 0: all are read.

    Returns
    -------
    NDArray
        ``(n, 3)``: mean, variance and number of the lags that were read; -1, 0, 0 if there is no lag.

    Notes
    -----
    With w the overlap at a lag and g the correlation there, over the points that are read::

        mean = sum(w g) / sum(w),  variance = sum(w g g) / sum(w) - mean^2

    The points are visited row by row. The sample of a lattice is the same in each call. The steps from point to point
    are random, because equal steps would visit some cosets of the coarser lattice more often than others. A step beyond
    the end of a row continues in the next one.
    """
    height, width = (spline.shape[0] + 1) // 2, spline.shape[1] - pad
    has_coarser = abs(coarser[0, 0]) + abs(coarser[0, 1]) + abs(coarser[1, 0]) + abs(coarser[1, 1]) > 0
    out = np.zeros((bases.shape[0], 3))
    for i in range(bases.shape[0]):
        x1, y1, x2, y2 = pair = bases[i, 0, 0], bases[i, 0, 1], bases[i, 1, 0], bases[i, 1, 1]
        # The mean step that reads about `most` of the points of the box's upper half.
        points = 2 * end[0] * end[1] / abs(x1 * y2 - x2 * y1)
        step = 1 if most == 0 else max(1, int(np.rint(points / most)))
        total, squares, weights, count = 0.0, 0.0, 0.0, 0
        state, beyond = 1, 0
        for b in range(count_rows(pair, end[0], end[1]) + 1):
            first, last = row_ends(pair, b, end[0], end[1])
            if last < first:
                continue
            # The walk enters the row as far in as its last step led beyond the previous row.
            following = first + beyond
            while following <= last:
                a = following
                if step == 1:
                    following += 1
                else:
                    state, random_step = draw_step(state, step)
                    following += random_step
                x, y = a * x1 + b * x2, a * y1 + b * y2
                # Of opposite points one is read, and none on the wrong side of rounding.
                if (b == 0 and a <= 0) or abs(x) > end[0] or abs(y) > end[1]:
                    continue
                # The points that the coarser lattice has too are left out.
                if has_coarser and is_multiple(coarser, x, y):
                    continue
                # The surface has its right half only; the opposite lag has the same correlation.
                if x < 0:
                    x, y = -x, -y
                value = height_at(spline, x + pad, y + height - 1)
                overlap = (height - abs(y)) * (width - x)
                total += overlap * value
                squares += overlap * value * value
                weights += overlap
                count += 1
            beyond = following - last - 1
        # Mean, variance and number; -1 is the mean of no lag.
        out[i, 0], out[i, 2] = -1.0, count
        if count:
            out[i, 0] = total / weights
            out[i, 1] = max(squares / weights - out[i, 0] * out[i, 0], 0.0)
    return out


@kernel
def list_multiples(basis: Float64x2, end: Float64x1) -> Int64x2:
    """Return the integers (a, b), ``(n, 2)``, of a lattice's points within a box of half sides ``end``, px.

    Lag 0 is left out; of each pair of opposite points one is returned.
    """
    pair = basis[0, 0], basis[0, 1], basis[1, 0], basis[1, 1]
    out = np.empty((count_multiples(pair, end[0], end[1]), 2), np.int64)
    count = 0
    for b in range(count_rows(pair, end[0], end[1]) + 1):
        first, last = half_row(pair, b, end[0], end[1])
        for a in range(first, last + 1):
            out[count, 0], out[count, 1] = a, b
            count += 1
    return out


@allocating_step_kernel
def newton_sums(
    spline: Float64x2, numbers: Int64x2, basis: Float64x2, radius: float, end: Float64x1, pad: int
) -> Float64x1:
    """Return the sums that Newton's method needs to fit a basis to the peaks at its multiples.

    Parameters
    ----------
    spline, end, pad
        As for :func:`rate_added_points`.
    numbers
        ``(n, 2)``: the integers (a, b) of the multiples.
    basis
        ``(2, 2)``, rows (x, y) px.
    radius
        px; multiples that lie further from lag 0 are left out.

    Returns
    -------
    NDArray
        ``(16,)``: the number of multiples in use; the largest abs(a) and abs(b) among them; the slope by x1, x2, y1,
        y2; and the second derivatives by x1 x1, x1 x2, x2 x2, by x1 y1, x1 y2, x2 y2, and by y1 y1, y1 y2, y2 y2. Each
        multiple is weighted by the area in which the image overlaps its shifted copy.

    Notes
    -----
    The multiple (a, b) lies at x = a x1 + b x2, y = a y1 + b y2. With the surface g and the overlap w there, by the
    chain rule::

        slope by x1     = sum of w a g_x,    by x2      = sum of w b g_x,  likewise y
        second by x1 x1 = sum of w a a g_xx, by x1 x2   = sum of w a b g_xx, ... likewise g_xy and g_yy
    """
    height, width = (spline.shape[0] + 1) // 2, spline.shape[1] - pad
    at, out = np.zeros((numbers.shape[0], 2)), np.zeros(16)
    weights, signs = np.zeros(numbers.shape[0]), np.zeros(numbers.shape[0])
    chosen = np.zeros((numbers.shape[0], 2))
    # The multiples in use, on the right half of the surface: there a slope has the opposite sign.
    count = 0
    for i in range(numbers.shape[0]):
        a, b = float(numbers[i, 0]), float(numbers[i, 1])
        x, y = a * basis[0, 0] + b * basis[1, 0], a * basis[0, 1] + b * basis[1, 1]
        if x * x + y * y > radius * radius or abs(x) > end[0] or abs(y) > end[1]:
            continue
        sign = -1.0 if x < 0 else 1.0
        at[count, 0], at[count, 1] = sign * x + pad, sign * y + height - 1
        weights[count], signs[count] = (height - abs(y)) * (width - abs(x)), sign
        chosen[count, 0], chosen[count, 1] = a, b
        count += 1
    # The surface's value, slopes and second derivatives at these multiples, then the sums by the chain rule.
    surface = jets(spline, at[:count])
    for i in range(count):
        a, b, weight = chosen[i, 0], chosen[i, 1], weights[i]
        out[1], out[2] = max(out[1], abs(a)), max(out[2], abs(b))
        # Slopes: two columns for x, two for y.
        for axis in range(2):
            slope = weight * signs[i] * surface[i, 1 + axis]
            out[3 + 2 * axis] += a * slope
            out[4 + 2 * axis] += b * slope
        # Second derivatives: three columns each for xx, xy and yy.
        for kind, column in enumerate((3, 5, 4)):
            bend = weight * surface[i, column]
            out[7 + 3 * kind] += a * a * bend
            out[8 + 3 * kind] += a * b * bend
            out[9 + 3 * kind] += b * b * bend
    out[0] = count
    return out


@allocating_step_kernel
def solve_newton(sums: Float64x1) -> Float64x1:
    """Return a step of Newton's method by x1, x2, y1, y2 px, ``(4,)``; zeros if the surface bends upward everywhere.

    Parameters
    ----------
    sums
        From :func:`newton_sums`.

    Notes
    -----
    With the slopes s and the negative second derivatives H = A diag(h) A^T::

        step = A diag(1 / max(h, 0.001 max h)) A^T s

    The step is shortened so that no multiple moves by more than a pixel along x or y. Along an axis on which the
    surface does not bend downward, the step would lead to no maximum; it follows the slope.
    """
    hessian, step, turned = np.zeros((4, 4)), np.zeros(4), np.zeros(4)
    for i in range(4):
        for j in range(4):
            hessian[i, j] = -sums[7 + 3 * (i // 2 + j // 2) + i % 2 + j % 2]
    bends, axes = np.linalg.eigh(hessian)
    if bends[3] <= 0:
        return step
    for i in range(4):
        for j in range(4):
            turned[i] += axes[j, i] * sums[3 + j]
        turned[i] /= max(bends[i], 1e-3 * bends[3])
    for i in range(4):
        for j in range(4):
            step[i] += axes[i, j] * turned[j]
    # The farthest multiple moves by these sums along x and y.
    along = sums[1] * abs(step[0]) + sums[2] * abs(step[1])
    down = sums[1] * abs(step[2]) + sums[2] * abs(step[3])
    step /= max(1.0, along, down)
    return step


@kernel
def climb_multiples(
    spline: Float64x2,
    numbers: Int64x2,
    basis: Float64x2,
    end: Float64x1,
    far: float,
    pad: int,
    growth: float,
    steps: int,
) -> Float64x2:
    """Return the basis near a given one at whose multiples the mean correlation is highest, ``(2, 2)``.

    Parameters
    ----------
    spline, numbers, basis, end, pad
        As for :func:`newton_sums`.
    far
        px; the largest radius.
    growth
        Factor by which the radius grows at each step.
    steps
        Largest number of steps.

    Notes
    -----
    Newton's method on all multiples at once, from the nearest outward (:func:`solve_newton`)::

        radius = length of the longer vector
        repeat: radius = min(growth radius, far); basis += step for the multiples within the radius
        until the radius is `far` and the step is small, or `steps` are done
    """
    radius = max(np.hypot(basis[0, 0], basis[0, 1]), np.hypot(basis[1, 0], basis[1, 1]))
    fitted = basis.copy()
    for _ in range(steps):
        radius = min(radius * growth, far)
        sums = newton_sums(spline, numbers, fitted, radius, end, pad)
        largest = 0.0
        if sums[0] >= 2:
            step = solve_newton(sums)
            for i in range(4):
                fitted[i % 2, i // 2] += step[i]
                largest = max(largest, abs(step[i]))
        if radius >= far and largest * np.sqrt(numbers.shape[0]) < 1e-3:
            break
    return fitted
