"""Compiled: the trees of a flood, in which regions that meet are joined."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nrbench.jit import kernel


@kernel("int64(int64[::1], int64)")
def root(parent: NDArray[np.int64], node: int) -> int:
    """Return the root of a node's tree, and shorten the way there by half.

    ``parent`` holds each node's parent, a root's its own; amortized O(log n).
    """
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node
