"""Compiled Radon transform, and the search for the worst line of each direction."""

from __future__ import annotations

import numpy as np

from nrbench.jit import Float32View2, Float32x1, Float32x2, Float64x1, Float64x2, inlined_kernel, kernel


@inlined_kernel
def _join(line: Float32x1, upper: Float32x1, lower: Float32x1) -> None:
    """Add the lower halves of lines, as far as they lie inside, to the upper ones."""
    inside = min(len(line), len(lower))
    for x in range(inside):
        line[x] = upper[x] + lower[x]
    for x in range(inside, len(line)):
        line[x] = upper[x]


@kernel
def steep_line_sums(image: Float32View2) -> Float32x2:
    """Return the sums along the lines that lean right by up to 45 degrees from upright.

    This is the fast discrete Radon transform (Brady, SIAM Journal on Computing 27, 1998): lines through two strips are
    sums of lines through each strip, so that all lines take N^2 log N sums. Blocks of 256 rows are summed one after the
    other, so that they stay in the cache.

    Parameters
    ----------
    image
        ``float32 (H, W)``. N is the least power of two that is no smaller than H and W.

    Returns
    -------
    NDArray[np.float32]
        ``(min(N, 256), 2 N)``: with k = max(N / 256, 1), entry (t, x) is the line from column ``x - N`` of the first
        row to ``x - N + k t`` of row N - 1. In larger images lines of neighboring leans are nearly equal.

    Notes
    -----
    Let S_h(i, t, x) be the sum along the line in strip i of h rows that begins at column x and leans right by t, t < h.
    S_1 is the image, and two strips make one of twice the height (Brady 1998, section 2)::

        S_2h(i, t, x) = S_h(2 i, floor(t / 2), x) + S_h(2 i + 1, floor(t / 2), x + ceil(t / 2))

    Row ``i h + t`` of a block holds the lines of its strip i that lean by t. Above the height of a block, t is a
    multiple of 2 h / 256. Lines that begin left of column -h or right of the image are 0.
    """
    rows, columns = image.shape
    size = 1
    while size < max(rows, columns):
        size *= 2
    width, tall = 2 * size, min(size, 256)
    end, levels = size + columns, 1
    while tall << (levels - 1) < size:
        levels += 1
    waiting = np.zeros((levels, tall, width), np.float32)  # strips of tall, 2 tall, ... rows whose lower ones follow
    for block in range(size // tall):
        before, after = np.zeros((tall, width), np.float32), np.zeros((tall, width), np.float32)
        first = block * tall
        for y in range(min(tall, rows - first)):  # numba takes seconds to compile the assignment of a slice
            for x in range(columns):
                before[y, size + x] = image[first + y, x]
        height = 1
        while height < tall:  # join the strips of ``height`` rows in pairs
            low = size - 2 * height
            for top in range(0, min(tall, rows - first), 2 * height):
                for lean in range(2 * height):
                    shift, half = (lean + 1) // 2, top + lean // 2
                    _join(after[top + lean, low:end], before[half, low:end], before[half + height, low + shift :])
            before, after = after, before
            height *= 2
        level = 0
        while (block >> level) & 1:  # the strip above waits
            for lean in range(tall):
                _join(before[lean, :end], waiting[level, lean, :end], before[lean, lean << level :])
            level += 1
        for lean in range(tall):
            for x in range(width):
                waiting[level, lean, x] = before[lean, x]
    found: Float32x2 = waiting[levels - 1].copy()
    return found


@kernel
def worst_of_parallels(
    value: Float32x2, energy: Float32x2, length: Float32x2, least: float, floors: Float64x1
) -> Float64x2:
    """Return the line with the largest step, and the one with the largest gradient, relative to their parallels.

    Parameters
    ----------
    value, energy, length
        ``(min(N, 256), 2 N)``: sums of brightness, of squared gradient, and of ones along lines.
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
    (leans, width), side, far = value.shape, 3, 6
    one, three, seven = np.uint64(1), np.uint64(side), np.uint64(far + 1)  # no index is negative: loops of vectors
    worst, sums, departures, raw = (
        np.zeros((2, 4)),
        np.zeros((3, width + 1)),
        np.zeros((2, width)),
        np.zeros((2, width)),
    )
    known, (v, e, n) = np.zeros(width), sums
    for lean in range(leans):
        shown = np.flatnonzero(length[lean])  # beyond a margin, columns without pixels have no lines
        low, high = max(shown[0] - far - side, 0), min(shown[-1] + far + side + 2, width)
        # Sums from the left give the sum over any run of columns as a difference.
        brightness, gradient, pixels = 0.0, 0.0, 0.0
        sums[:, low] = 0
        for x in range(low, high):
            brightness += value[lean, x]
            gradient += energy[lean, x]
            pixels += length[lean, x]
            v[x + 1], e[x + 1], n[x + 1] = brightness, gradient, pixels
        # Step and excess of each line that is long enough, and the means of their scaled values.
        count = high - low - 2 * far - 1
        number, steps, excesses = 0.0, 0.0, 0.0
        for k in range(count):
            q = np.uint64(low + far + 1) + np.uint64(k)
            right, left = n[q + three] - n[q], n[q] - n[q - three]
            pixels, on, here = min(right, left) / side, n[q + one] - n[q - one], e[q + one] - e[q - one]
            around, room = e[q + seven] - e[q - seven], n[q + seven] - n[q - seven]
            # np.divide raises no error where a line is too short.
            step = np.divide(v[q + three] - v[q], right) - np.divide(v[q] - v[q - three], left)
            excess = np.divide(here, on) - np.divide(around - here, room - on)
            long = (pixels >= least) & (on >= 2 * least)
            weight = 1.0 if long else 0.0
            scaled = step * np.sqrt(pixels) if long else 0.0, excess * np.sqrt(on / 2) if long else 0.0
            raw[0, k], raw[1, k], known[k], (departures[0, k], departures[1, k]) = step, excess, weight, scaled
            number, steps, excesses = number + weight, steps + scaled[0], excesses + scaled[1]
        if number == 0:
            continue
        # The line that departs most from its parallels.
        for kind in range(2):
            own, mean, usual = departures[kind], (excesses if kind else steps) / number, 0.0
            for k in range(count):
                departure = abs(own[k] - mean) * known[k]
                own[k], usual = departure, usual + departure
            at = own[:count].argmax()
            strength = own[at] / (usual / number * 1.2533141373155001 + floors[kind])
            if strength > worst[kind, 0]:
                worst[kind, 0], worst[kind, 1], worst[kind, 2] = strength, lean, low + far + 1 + at
                worst[kind, 3] = abs(raw[kind, at])
    return worst
