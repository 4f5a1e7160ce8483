"""Where captions go in a plane of points, so that none covers another, a point or a bar."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Boxes = NDArray[np.float64]
"""``(n, 4)``: left, bottom, right, top."""

_ANGLES = np.deg2rad(np.arange(0, 360, 15))
_REACHES = (5.0, 10.0, 17.0, 26.0, 37.0, 50.0, 66.0, 85.0, 110.0)
_SWEEPS = 12
_OVER_CAPTION, _OVER_OBSTACLE, _TOUCHING, _OUTSIDE, _CROSSING = 400.0, 120.0, 30.0, 2000.0, 160.0


def placed(anchors: NDArray[np.float64], sizes: NDArray[np.float64], obstacles: Boxes, frame: Boxes) -> Boxes:
    """Return a box for each caption, near its anchor and clear of everything where there is room.

    Each caption in turn takes the cheapest of its candidates given where the others are, for a few sweeps; the cost is
    the share of it that is covered or outside, what it touches, what its leader crosses, and its distance.
    Deterministic; its time grows with the square of the number of captions.

    Parameters
    ----------
    anchors
        ``(n, 2)`` points, in the units of ``sizes`` (typographic points suit the built-in distances).
    sizes
        ``(n, 2)`` widths and heights.
    obstacles
        What must not be covered.
    frame
        ``(4,)``: where captions may be.
    """
    choices = [_candidates(anchor, size) for anchor, size in zip(anchors, sizes, strict=True)]
    fixed = [_fixed_cost(boxes, obstacles, frame) for boxes in choices]
    chosen = np.array([boxes[np.argmin(cost)] for boxes, cost in zip(choices, fixed, strict=True)]).reshape(-1, 4)
    for _ in range(_SWEEPS):
        before = chosen.copy()
        for i, boxes in enumerate(choices):
            others = np.delete(chosen, i, 0)
            crossed = _crossings(anchors[i], boxes, others) + _crossed(np.delete(anchors, i, 0), others, boxes)
            covered = overlap(boxes, others)
            cost = fixed[i] + _OVER_CAPTION * (covered.sum(1) + 0.5 * (covered > 0).sum(1)) + _CROSSING * crossed
            chosen[i] = boxes[np.argmin(cost)]
        if (before == chosen).all():
            break
    return chosen


def _candidates(anchor: NDArray[np.float64], size: NDArray[np.float64]) -> Boxes:
    reach, angle = (part.ravel() for part in np.meshgrid(_REACHES, _ANGLES, indexing="ij"))
    way = np.stack([np.cos(angle), np.sin(angle)], 1)
    middle = anchor + way * (size / 2 + reach[:, None])
    return np.concatenate([middle - size / 2, middle + size / 2], 1)


def _fixed_cost(boxes: Boxes, obstacles: Boxes, frame: Boxes) -> NDArray[np.float64]:
    outside = 1 - overlap(boxes, frame[None])[:, 0]
    distance = np.repeat(_REACHES, len(_ANGLES))
    covered = overlap(boxes, obstacles)
    over = _OVER_OBSTACLE * covered.sum(1) + _TOUCHING * (covered > 0).sum(1)
    return np.asarray(over + _OUTSIDE * outside + distance)


def overlap(boxes: Boxes, others: Boxes) -> NDArray[np.float64]:
    """Return the share of each of ``boxes`` that each of ``others`` covers, ``(n, m)`` in [0, 1]."""
    low = np.maximum(boxes[:, None, :2], others[None, :, :2])
    high = np.minimum(boxes[:, None, 2:], others[None, :, 2:])
    area = np.prod(boxes[:, 2:] - boxes[:, :2], axis=1)
    shared: NDArray[np.float64] = np.prod(np.clip(high - low, 0, None), axis=2) / area[:, None]
    return shared


def leader(anchor: NDArray[np.float64], box: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the point of ``box`` that is nearest to ``anchor``, where the caption's leader ends."""
    return np.asarray(np.clip(anchor, box[:2], box[2:]))


def _crossings(anchor: NDArray[np.float64], boxes: Boxes, others: Boxes) -> NDArray[np.float64]:
    """Return how many of ``others`` the leader of each candidate passes through."""
    ends = np.clip(anchor, boxes[:, :2], boxes[:, 2:])
    return np.asarray(_passes(np.broadcast_to(anchor, ends.shape), ends, others).sum(1))


def _crossed(anchors: NDArray[np.float64], others: Boxes, boxes: Boxes) -> NDArray[np.float64]:
    """Return how many leaders of ``others`` pass through each candidate."""
    ends = np.clip(anchors, others[:, :2], others[:, 2:])
    return np.asarray(_passes(anchors, ends, boxes).sum(0))


def _passes(starts: NDArray[np.float64], ends: NDArray[np.float64], boxes: Boxes) -> NDArray[np.float64]:
    """Return 1 where a line passes through a box, ``(lines, boxes)``, looked at in steps."""
    steps = np.linspace(0, 1, 13)[None, :, None]
    points = (starts[:, None] + steps * (ends - starts)[:, None])[:, :, None]
    inside = ((points > boxes[:, :2]) & (points < boxes[:, 2:])).all(axis=-1)
    return np.asarray(np.any(inside, axis=1), np.float64)
