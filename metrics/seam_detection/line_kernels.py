"""Compiled Radon transform, and the search for the worst line of each direction."""

from __future__ import annotations

import numpy as np

from nrbench.jit import Float32x2, Float64x1, Float64x2, kernel


@kernel
def steep_line_sums(image: Float32x2) -> Float32x2:
    """Return the sums along the lines that lean right by up to 45 degrees from upright.

    This is the fast discrete Radon transform (Brady, SIAM Journal on Computing 27, 1998): lines through two strips are
    sums of lines through each strip, so that all lines take N^2 log N sums.

    Parameters
    ----------
    image
        ``float32 (N, N)``, N a power of two.

    Returns
    -------
    NDArray[np.float32]
        ``(N, 2 N)``: entry (t, x) is the line from column ``x - N`` of the first row to ``x - N + t`` of the last.

    Notes
    -----
    Let S_h(i, t, x) be the sum along the line in strip i of h rows that begins at column x and leans right by t, t < h.
    S_1 is the image, and two strips make one of twice the height (Brady 1998, section 2)::

        S_2h(i, t, x) = S_h(2 i, floor(t / 2), x) + S_h(2 i + 1, floor(t / 2), x + ceil(t / 2))

    Row ``i h + t`` of an array holds the lines of strip i that lean by t, so each step fills an array of equal size.
    """
    size = image.shape[0]
    width = 2 * size
    before = np.zeros((size, width), np.float32)
    for y in range(size):  # numba takes seconds to compile the assignment of a slice
        for x in range(size):
            before[y, size + x] = image[y, x]
    height = 1
    while height < size:  # join the strips of ``height`` rows in pairs
        after = np.zeros((size, width), np.float32)
        for strip in range(size // (2 * height)):
            top, bottom, out = 2 * strip * height, (2 * strip + 1) * height, 2 * strip * height
            for lean in range(2 * height):
                shift = (lean + 1) // 2
                for x in range(width - shift):
                    after[out + lean, x] = before[top + lean // 2, x] + before[bottom + lean // 2, x + shift]
                for x in range(width - shift, width):  # the lower half of the line lies outside
                    after[out + lean, x] = before[top + lean // 2, x]
        before = after
        height *= 2
    return before


@kernel
def worst_of_parallels(
    value: Float32x2, energy: Float32x2, length: Float32x2, least: float, floors: Float64x1
) -> Float64x2:
    """Return the line with the largest step, and the one with the largest gradient, relative to their parallels.

    Parameters
    ----------
    value, energy, length
        ``(N, 2 N)``: sums of brightness, of squared gradient, and of ones along lines.
    least
        Least number of pixels of a line.
    floors
        Departures of step and gradient, times the root of the pixels, that are added to the parallels' departures.

    Returns
    -------
    NDArray[np.float64]
        ``(2, 4)``, for step and gradient: strength (departure from the parallels' mean over their standard deviation,
        which is estimated from their mean absolute departure), lean, N plus the column right of the line, and the step
        or the excess of squared gradient.

    Notes
    -----
    Let V(x), E(x) and L(x) be the sums of brightness, squared gradient and ones along the lines of one lean, and write
    V[a, b) for V(a) + ... + V(b - 1). A line left of column x, of n = min(L[x, x + 3), L[x - 3, x)) / 3 pixels, has ::

        step(x)   = V[x, x + 3) / L[x, x + 3) - V[x - 3, x) / L[x - 3, x)
        excess(x) = E[x - 1, x + 1) / L[x - 1, x + 1) - (the same ratio over the six columns on either side of these)

    A mean of n pixels scatters as n^(-1/2), so d(x) = step(x) n^(1/2), and the excess times the root of its pixels on
    the line, have one scale for all parallels. The strength of a line is::

        |d(x) - mean d| / ((pi / 2)^(1/2) mean |d - mean d| + floor)

    The factor is that of a normal distribution, whose mean absolute departure is (2 / pi)^(1/2) standard deviations.
    """
    leans, width = value.shape
    side, far = 3, 6
    worst = np.zeros((2, 4))
    sums = np.zeros((3, width + 1))
    departures = np.zeros((2, width))
    raw = np.zeros((2, width))
    known = np.zeros(width, np.bool_)
    # In large images lines of neighboring leans are nearly equal: 256 of them are compared.
    for lean in range(0, leans, max(leans // 256, 1)):
        # Sums from the left give the sum over any run of columns as a difference.
        for x in range(width):
            sums[0, x + 1] = sums[0, x] + value[lean, x]
            sums[1, x + 1] = sums[1, x] + energy[lean, x]
            sums[2, x + 1] = sums[2, x] + length[lean, x]
        # Step and excess of each line that is long enough, and the means of their scaled values.
        number = 0
        mean = np.zeros(2)
        for x in range(far + 1, width - far):
            right, left = sums[2, x + side] - sums[2, x], sums[2, x] - sums[2, x - side]
            pixels = min(right, left) / side
            on = sums[2, x + 1] - sums[2, x - 1]
            known[x] = pixels >= least and on >= 2 * least
            if not known[x]:
                continue
            step = (sums[0, x + side] - sums[0, x]) / right - (sums[0, x] - sums[0, x - side]) / left
            here = sums[1, x + 1] - sums[1, x - 1]
            around = sums[1, x + 1 + far] - sums[1, x - 1 - far]
            room = sums[2, x + 1 + far] - sums[2, x - 1 - far]
            raw[0, x] = step
            raw[1, x] = here / on - (around - here) / (room - on)
            departures[0, x] = step * np.sqrt(pixels)
            departures[1, x] = raw[1, x] * np.sqrt(on / 2)
            number += 1
            mean[0] += departures[0, x]
            mean[1] += departures[1, x]
        if number == 0:
            continue
        mean /= number
        # The line that departs most from its parallels.
        for kind in range(2):
            usual, most, at = 0.0, 0.0, 0
            for x in range(far + 1, width - far):
                if known[x]:
                    departure = abs(departures[kind, x] - mean[kind])
                    usual += departure
                    if departure > most:
                        most, at = departure, x
            strength = most / (usual / number * 1.2533141373155001 + floors[kind])
            if strength > worst[kind, 0]:
                worst[kind, 0], worst[kind, 1], worst[kind, 2] = strength, lean, at
                worst[kind, 3] = abs(raw[kind, at])
    return worst
