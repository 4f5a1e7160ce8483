"""Plot the perils plane: elements in place and whole against randomness, one point for each method."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from ..statistics.comparison import PerilsPoint
from ..statistics.verdicts import BASELINE_LEGEND, BASELINE_SIGN, SHARES_LEGEND, method_label
from .captions import choose_named, describe_unnamed, draw_captions
from .figure_file import FAINT, GRAY, INK, SMALL, make_figure, render_figure

_RADIUS = 3.2
_ROW = 13.0
_LIST_ROW = 9.5
_NARROW = 4.6
_CONTOURS = (0.2, 0.4, 0.6, 0.8)

Boxes = NDArray[np.float64]
"""``(n, 4)``: left, bottom, right, top."""
_ANGLES = np.deg2rad(np.arange(0, 360, 15))
_REACHES = (5.0, 10.0, 17.0, 26.0, 37.0, 50.0, 66.0, 85.0, 110.0)
_SWEEPS = 12
_OVER_CAPTION, _OVER_OBSTACLE, _TOUCHING, _OUTSIDE, _CROSSING = 400.0, 120.0, 30.0, 2000.0, 160.0


def plot_perils_plane(points: Sequence[PerilsPoint], kind: str, width: float = 5.5) -> bytes:
    """Return the plane as a file of a kind (``svg``, ``pdf``, ``png``); the same points give the same bytes."""
    return render_figure(partial(_perils_figure, points, width), kind)


def caption_text(group: Sequence[PerilsPoint]) -> str:
    """Return the caption of the points of one method: name, lattice sources, what the height rests on, validity."""
    sources = ", ".join(point.method.lattice_source for point in group)
    return method_label(group[0].method.name, sources) + group[0].rests_on + group[0].validity.sign


def wrap_caption(text: str, most: int = 24) -> str:
    """Return a caption in lines of ``most`` characters, broken only between parameters, sources and counts."""
    lines = [""]
    for part in re.split(r"(?<=[:,])(?! )|(?<= )(?=[(\[n])", text):
        if lines[-1] and len(lines[-1]) + len(part.rstrip()) > most:
            lines.append("")
        lines[-1] += part
    return "\n".join(line.rstrip() for line in lines)


def _perils_figure(points: Sequence[PerilsPoint], width: float) -> Figure:
    """Return the plane, and below it a row for each method whose randomness is not scored on any texture."""
    named = _named(points)
    above = [point for point in named if point.has_height]
    below = [point for point in named if not point.has_height]
    heights = {
        "plane": 72 * width * 0.66,
        "strip": _ROW * sum(_strip_caption(point).count("\n") + 1 for point in below) + 4 if below else 0.0,
        "top": 16.0,
        "key": 60.0,
        "list": _LIST_ROW * len(above) + 6.0 if width < _NARROW else 0.0,
    }
    notes = len(_footnotes(points))
    heights["key"] += (26.0 + 9.0 * notes) * (width < _NARROW) - 8.0 * (not notes) + 9.0 * max(0, notes - 1)
    total = sum(heights.values())
    figure = make_figure(width, total)
    beside = 12 if width < _NARROW else 182 if above else 58
    left, across = 46 / (72 * width), 1 - (46 + beside) / (72 * width)
    bottom = (heights["key"] + heights["strip"] + heights["list"]) / total
    plane = figure.add_axes((left, bottom, across, heights["plane"] / total))
    _draw_plane(plane, above, width < _NARROW)
    others = [_position(point) for point in points if point.has_height and point not in named]
    plane.plot(*np.reshape(others, (-1, 2)).T, ls="none", marker="o", ms=3, mfc=INK, mec="none", zorder=3)
    if below:
        strip = figure.add_axes((left, (heights["key"] + heights["list"]) / total, across, heights["strip"] / total))
        _draw_strip(strip, below)
        plane.tick_params(labelbottom=False)
    if width < _NARROW:
        _list_names(figure, above, heights["list"], total)
    _draw_key(figure, points, heights["key"], heights["list"], total)
    return figure


def _named(points: Sequence[PerilsPoint]) -> list[PerilsPoint]:
    """Return the points that have names and intervals: names of more would be too small to read."""
    return [point for point, named in zip(points, choose_named(_references(points)), strict=True) if named]


def _references(points: Sequence[PerilsPoint]) -> list[bool]:
    return [point.method.reference for point in points]


def _draw_plane(axes: Axes, above: Sequence[PerilsPoint], narrow: bool) -> None:
    axes.set(xlim=(-0.05, 1.05), ylim=(-0.05, 1.05), xticks=np.linspace(0, 1, 6), yticks=np.linspace(0, 1, 6))
    axes.set_ylabel("randomness")
    for quality in _CONTOURS:
        axes.plot((quality, quality, 1.05), (1.05, quality, quality), color=FAINT, lw=0.6, zorder=0)
    for height, words, side in () if narrow else ((1.0, "as a fresh draw", "top"), (0.0, "wallpaper", "bottom")):
        away = -0.035 if side == "top" else 0.035
        axes.text(1.04, height + away, words, ha="right", va=side, **SMALL)
    axes.text(0, 1.02, "lattice lost or broken", transform=axes.transAxes, style="italic", **SMALL)
    axes.text(1, 1.02, "all perils avoided", ha="right", transform=axes.transAxes, style="italic", **SMALL)
    axes.tick_params(length=3, width=0.7)
    for point in above:
        _draw_point(axes, point, *_position(point))
    _draw_captions(axes, above, narrow)


def _position(point: PerilsPoint) -> tuple[float, float]:
    return float(point.structure.value or 0.0), float(point.randomness.value or 0.0)


def _draw_point(axes: Axes, point: PerilsPoint, x: float, y: float) -> None:
    reference = point.method.reference
    bars: dict[str, Any] = {"color": GRAY if reference else INK, "lw": 0.9, "solid_capstyle": "butt", "zorder": 2}
    if (ends := point.structure.ends) is not None:
        axes.plot(ends, (y, y), **bars)
    if point.has_height and (ends := point.randomness.ends) is not None:
        axes.plot((x, x), ends, **bars)
    axes.plot(
        *(x, y),
        marker="D" if reference else "o",
        ms=2 * _RADIUS - (1.4 if reference else 0),
        mfc=(FAINT if reference else INK) if point.has_height else "white",
        mec=INK,
        mew=0.8,
        zorder=3,
        clip_on=False,
    )


def _draw_captions(axes: Axes, above: Sequence[PerilsPoint], narrow: bool) -> None:
    """Label the points, in the order of their heights: in a column beside the plane, or by numbers if it is narrow."""
    groups = _shared_captions(axes, above)
    if not groups:
        return
    anchors = axes.transData.transform([_position(group[0]) for group in groups])
    if not narrow:
        texts = [wrap_caption(caption_text(group)) for group in groups]
        draw_captions(axes, anchors, texts, [group[0].method.reference for group in groups])
        return
    order = np.lexsort((anchors[:, 0], -anchors[:, 1]))
    anchors, groups = anchors[order], [groups[i] for i in order]
    numbers = [str(i) for i in range(1, len(groups) + 1)]
    sizes = np.array([[4.6 * len(number) + 2, 8.0] for number in numbers])
    boxes = place_captions(anchors, sizes, _obstacles(axes, above), np.array(axes.get_window_extent().extents))
    back = axes.transData.inverted()
    for number, group, anchor, box in zip(numbers, groups, anchors, boxes, strict=True):
        x, y = back.transform((box[:2] + box[2:]) / 2)
        axes.text(
            float(x),
            float(y),
            number,
            ha="center",
            va="center",
            fontsize=7,
            style=_slant(group[0]),
        )
        end = np.clip(anchor, box[:2], box[2:])
        if np.linalg.norm(end - anchor) > 2.5 * _RADIUS:
            axes.plot(*back.transform(np.array([anchor, end])).T, color=GRAY, lw=0.6, zorder=1)


def _list_names(figure: Figure, above: Sequence[PerilsPoint], top: float, total: float) -> None:
    """List the names of numbered points below a narrow plane, the highest first; ``top`` in points from below."""
    for row, (number, name, slant) in enumerate(_numbered_names(figure.axes[0], above)):
        y = (top - 4 - _LIST_ROW * row) / total
        figure.text(30 / (72 * figure.get_figwidth()), y, number, ha="right", va="top", fontsize=7, color=INK)
        figure.text(36 / (72 * figure.get_figwidth()), y, name, va="top", fontsize=7, style=slant, color=INK)


def _numbered_names(axes: Axes, above: Sequence[PerilsPoint]) -> list[tuple[str, str, str]]:
    groups = _shared_captions(axes, above)
    anchors = np.array([_position(group[0]) for group in groups]).reshape(-1, 2)
    order = np.lexsort((anchors[:, 0], -anchors[:, 1]))
    return [(str(n), caption_text(groups[i]), _slant(groups[i][0])) for n, i in enumerate(order, 1)]


def _slant(point: PerilsPoint) -> str:
    return "italic" if point.method.reference else "normal"


def _shared_captions(axes: Axes, above: Sequence[PerilsPoint]) -> list[list[PerilsPoint]]:
    """Return groups that share a caption: points of one method that coincide and differ only in the lattice source."""
    groups: list[list[PerilsPoint]] = []
    for point in above:
        words = point.method.name, point.rests_on, point.validity.sign
        at = axes.transData.transform(_position(point))
        for group in groups:
            apart = np.linalg.norm(at - axes.transData.transform(_position(group[0])))
            if (group[0].method.name, group[0].rests_on, group[0].validity.sign) == words and apart < _RADIUS:
                group.append(point)
                break
        else:
            groups.append([point])
    return groups


def _obstacles(axes: Axes, above: Sequence[PerilsPoint]) -> Boxes:
    """Return the boxes, in pixels, of the points and their bars."""
    boxes = []
    for point in above:
        x, y = _position(point)
        boxes.append([x, y, x, y])
        if (ends := point.structure.ends) is not None:
            boxes.append([ends[0], y, ends[1], y])
        if (ends := point.randomness.ends) is not None:
            boxes.append([x, ends[0], x, ends[1]])
    corners = axes.transData.transform(np.array(boxes, float).reshape(-1, 2)).reshape(-1, 4)
    grown: Boxes = corners + np.array([-1, -1, 1, 1]) * (_RADIUS - 1)
    return grown


def _draw_strip(axes: Axes, below: Sequence[PerilsPoint]) -> None:
    """Draw the methods whose randomness is not scored on any texture, one in each row."""
    lines = [_strip_caption(point).count("\n") + 1 for point in below]
    rows = np.cumsum(lines) - np.array(lines) / 2
    axes.set(xlim=(-0.05, 1.05), ylim=(sum(lines) + 0.15, -0.15), yticks=[], xticks=np.linspace(0, 1, 6))
    axes.tick_params(length=3, width=0.7)
    beside: dict[str, Any] = {"transform": axes.transAxes, "color": GRAY, "fontsize": 6, "va": "center"}
    axes.text(-0.03, 0.5, "randomness\nnot scored", ha="right", **beside)
    for row, point in zip(rows.tolist(), below, strict=True):
        x = point.structure.value or 0.0
        _draw_point(axes, point, float(x), row)
        low, high = point.structure.ends or (x, x)
        right = 1 - high > low
        axes.annotate(
            _strip_caption(point),
            (high if right else low, row),
            (8 if right else -8, 0),
            textcoords="offset points",
            ha="left" if right else "right",
            va="center",
            style=_slant(point),
        )


def _strip_caption(point: PerilsPoint) -> str:
    return wrap_caption(f"{caption_text([point])} n = {point.structure.n}", 26)


def _draw_key(figure: Figure, points: Sequence[PerilsPoint], height: float, below: float, total: float) -> None:
    narrow = figure.get_figwidth() < _NARROW
    middle = 0.5 - 2 / (72 * figure.get_figwidth())
    title = "elements in place and whole: the smaller of regularity and integrity"
    title = title.replace(": ", ":\n") if narrow else title
    figure.text(middle, (below + height - 26) / total, title, ha="center", va="center")
    most = max(point.structure.n for point in points)
    signs = [("o", INK, "method"), ("D", FAINT, "reference, not ranked")]
    if not all(point.has_height for point in points):
        signs.append(("o", "white", "not scored"))
    style: dict[str, Any] = {"ls": "", "ms": 2 * _RADIUS - 1, "mec": INK, "mew": 0.8}
    handles = [Line2D([], [], marker=sign, mfc=fill, label=words, **style) for sign, fill, words in signs]
    handles.append(Line2D([], [], color=INK, lw=0.9, label=f"95 %, at most {most} textures"))
    handles.append(Line2D([], [], color=FAINT, lw=0.8, label="equal quality"))
    figure.legend(
        handles=handles,
        ncols=2 if narrow else 5,
        loc="center",
        bbox_to_anchor=(middle, (below + height - (58 if narrow else 41)) / total),
        frameon=False,
        fontsize=7,
        handlelength=1.1,
        handletextpad=0.5,
        columnspacing=1.1,
    )
    notes = [line for note in _footnotes(points) for line in (textwrap.wrap(note, 56) if narrow else [note])]
    for row, words in enumerate(reversed(notes)):
        figure.text(middle, (below + 4 + 9 * row) / total, words, ha="center", **SMALL)


def _footnotes(points: Sequence[PerilsPoint]) -> list[str]:
    """Return the explanation of the brackets and signs that occur in the captions."""
    brackets = ["[k of n]: the height rests on the k textures on which randomness is scored"]
    valid = [f"{BASELINE_SIGN} {BASELINE_LEGEND} ({SHARES_LEGEND})"]
    unnamed = describe_unnamed(choose_named(_references(points)))
    return [
        *brackets * any(point.rests_on for point in points),
        *valid * any(point.validity.n for point in points),
        *([unnamed] if unnamed else []),
    ]


def place_captions(anchors: NDArray[np.float64], sizes: NDArray[np.float64], obstacles: Boxes, frame: Boxes) -> Boxes:
    """Place captions near their anchors so that they cover neither each other nor an obstacle, if there is space.

    Matplotlib has no such function. Each caption in turn takes the cheapest of its candidate boxes while the others
    stay, for at most 12 sweeps. The cost of a box adds the shares of it that are covered or outside the frame, what it
    touches, what its leader crosses, and its distance. The result is deterministic; the time grows with the square of
    the number of captions.

    Parameters
    ----------
    anchors
        ``(n, 2)`` points, in the unit of ``sizes``. The built-in distances suit typographic points.
    sizes
        ``(n, 2)`` widths and heights.
    obstacles
        Boxes that captions must not cover.
    frame
        ``(4,)``: the box in which captions must lie.

    Returns
    -------
    numpy.ndarray
        The box of each caption.
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
    direction = np.stack([np.cos(angle), np.sin(angle)], 1)
    middle = anchor + direction * (size / 2 + reach[:, None])
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


def _crossings(anchor: NDArray[np.float64], boxes: Boxes, others: Boxes) -> NDArray[np.float64]:
    """Count the boxes of ``others`` that the leader of each candidate crosses."""
    ends = np.clip(anchor, boxes[:, :2], boxes[:, 2:])
    return np.asarray(_passes(np.broadcast_to(anchor, ends.shape), ends, others).sum(1))


def _crossed(anchors: NDArray[np.float64], others: Boxes, boxes: Boxes) -> NDArray[np.float64]:
    """Count the leaders of ``others`` that cross each candidate."""
    ends = np.clip(anchors, others[:, :2], others[:, 2:])
    return np.asarray(_passes(anchors, ends, boxes).sum(0))


def _passes(starts: NDArray[np.float64], ends: NDArray[np.float64], boxes: Boxes) -> NDArray[np.float64]:
    """Return 1 if a line passes through a box at one of 13 points, else 0, ``(lines, boxes)``."""
    steps = np.linspace(0, 1, 13)[None, :, None]
    points = (starts[:, None] + steps * (ends - starts)[:, None])[:, :, None]
    inside = ((points > boxes[:, :2]) & (points < boxes[:, 2:])).all(axis=-1)
    return np.asarray(np.any(inside, axis=1), np.float64)
