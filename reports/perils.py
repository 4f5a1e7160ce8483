"""The perils plane as a picture: the one that a paper prints."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from nrbench.errors import BadInput
from nrbench.runs.records import Run
from nrbench.storage import write_aside

from .plots.captions import leader, placed
from .statistics.baselines import LEGEND, SHARES, SIGN
from .statistics.comparison import comparison
from .statistics.perils import Place, caption, partly, places, wrapped
from .statistics.randomness_kept import COPIER
from .statistics.statistics import Estimate

_INK, _GRAY, _FAINT = "black", "0.45", "0.8"
_RADIUS = 3.2
_ROW = 13.0
_NARROW = 4.6
_STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 8,
    "svg.hashsalt": "nrbench",
    "svg.fonttype": "path",
    "pdf.fonttype": 42,
    "axes.linewidth": 0.7,
}


@dataclass(frozen=True)
class PerilsPlane:
    """The perils plane, ``perils.svg`` and ``perils.pdf``: regularity against randomness kept, one point a method.

    To the right the lattice is kept (``regularity.score``), upwards the randomness: the worst of variation v,
    repetition r and distance d, ``min(v, 1/v, 1/(1 + max(r, 0)), 1 - max(d, 0)/0.41)``, taken output by output. A fresh
    draw lies at (1, 1), wallpaper at (1, 0). Means over textures with a verdict, bars are 95 % intervals over textures.
    Reference rows, the corners, have a sign of their own and no rank. Randomness is not scored where regularity is
    lost: a method that has none anywhere lies below the plane with an open sign; a number in brackets behind a name
    says on how many textures its height rests, a double dagger that a reference is no cheat there.

    Parameters
    ----------
    width
        Inches, from 3 to 12; text keeps its size.
    """

    width: float = 5.5

    version: ClassVar[str] = "1"
    folder: ClassVar[str] = "report"

    def __post_init__(self) -> None:
        if not 3 <= self.width <= 12:
            raise BadInput(f"report perils: width is {self.width:g}; give 3 to 12 inches")

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write both files and return their paths; none where no method has a score of regularity."""
        found = places(comparison(run).summaries)
        if not found:
            return []
        paths = [directory / f"perils.{kind}" for kind in ("svg", "pdf")]
        for path in paths:
            write_aside(path, partial(_put, content=drawn(found, path.suffix[1:], self.width)))
        return paths


def _put(path: Path, content: bytes) -> None:
    path.write_bytes(content)


def drawn(found: Sequence[Place], kind: str, width: float = 5.5) -> bytes:
    """Return the plane as a file of a kind (``svg``, ``pdf``, ``png``); the same places give the same bytes."""
    with matplotlib.rc_context(_STYLE):
        figure = perils_figure(found, width)
        file = io.BytesIO()
        dates = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
        figure.savefig(file, format=kind, metadata=dates.get(kind), dpi=160 if kind == "png" else 72)
    return file.getvalue()


def perils_figure(found: Sequence[Place], width: float = 5.5) -> Figure:
    """Return the plane, and under it a line for each method whose randomness is nowhere scored."""
    above = [place for place in found if place.known]
    below = [place for place in found if not place.known]
    heights = {
        "plane": 72 * width * 0.66,
        "strip": _ROW * sum(_strip_caption(place).count("\n") + 1 for place in below) + 4,
        "top": 16.0,
        "foot": 60.0,
    }
    if not below:
        heights["strip"] = 0.0
    heights["foot"] += 10.0 * (width < _NARROW) - 8.0 * (not _footnotes(found)) + 9.0 * (len(_footnotes(found)) > 1)
    total = sum(heights.values())
    figure = Figure(figsize=(width, total / 72), dpi=72)
    FigureCanvasAgg(figure)
    left, across = 46 / (72 * width), 1 - (46 + 58) / (72 * width)
    bottom = (heights["foot"] + heights["strip"]) / total
    plane = figure.add_axes((left, bottom, across, heights["plane"] / total))
    _draw_plane(plane, above)
    if below:
        strip = figure.add_axes((left, heights["foot"] / total, across, heights["strip"] / total))
        _draw_strip(strip, below)
        plane.tick_params(labelbottom=False)
    _draw_key(figure, found, heights["foot"], total)
    return figure


def _draw_plane(axes: Axes, above: Sequence[Place]) -> None:
    axes.set(xlim=(-0.05, 1.05), ylim=(-0.05, 1.05), xticks=np.linspace(0, 1, 6), yticks=np.linspace(0, 1, 6))
    axes.set_ylabel("randomness kept\nworst of variation, repetition, distance")
    axes.axhline(COPIER, color=_GRAY, lw=0.6, dashes=(1, 2), zorder=0)
    aside: dict[str, Any] = {"transform": axes.get_yaxis_transform(), "color": _GRAY, "fontsize": 7, "va": "center"}
    for height, words in ((1.0, "as a\nfresh draw"), (COPIER, "best possible\ncopier"), (0.0, "wallpaper")):
        axes.text(1.015, height, words, **aside)
    corner: dict[str, Any] = {"transform": axes.transAxes, "color": _GRAY, "fontsize": 7, "style": "italic"}
    axes.text(0, 1.02, "lattice lost", **corner)
    axes.text(1, 1.02, "both perils avoided", ha="right", **corner)
    axes.tick_params(length=3, width=0.7)
    for place in above:
        _draw_point(axes, place, _height(place), place.known)
    _draw_captions(axes, above)


def _height(place: Place) -> float:
    return float(place.randomness.value or 0.0)


def _draw_point(axes: Axes, place: Place, height: float, known: bool) -> None:
    color = _GRAY if place.head.reference else _INK
    x = float(place.regularity.value or 0.0)
    bars: dict[str, Any] = {"color": color, "lw": 0.9, "solid_capstyle": "butt", "zorder": 2}
    if (ends := _ends(place.regularity)) is not None:
        axes.plot(ends, (height, height), **bars)
    if known and (ends := _ends(place.randomness)) is not None:
        axes.plot((x, x), ends, **bars)
    axes.plot(
        *(x, height),
        marker="D" if place.head.reference else "o",
        ms=2 * _RADIUS - (1.4 if place.head.reference else 0),
        mfc=(_FAINT if place.head.reference else _INK) if known else "white",
        mec=_INK,
        mew=0.8,
        zorder=3,
        clip_on=False,
    )


def _ends(estimate: Estimate) -> tuple[float, float] | None:
    return None if estimate.low is None or estimate.high is None else (estimate.low, estimate.high)


def _draw_captions(axes: Axes, above: Sequence[Place]) -> None:
    groups = _together(axes, above)
    if not groups:
        return
    style: dict[str, Any] = {"ha": "center", "va": "center", "zorder": 4, "linespacing": 1.05}
    texts = [axes.text(0, 0, wrapped(caption(group)), style=_slant(group[0]), **style) for group in groups]
    sizes = np.array([text.get_window_extent().size for text in texts]) + 2
    anchors = axes.transData.transform([_point(group[0]) for group in groups])
    frame = np.array(axes.get_window_extent().extents)
    boxes = placed(anchors, sizes, _obstacles(axes, above), frame)
    back = axes.transData.inverted()
    for text, anchor, box in zip(texts, anchors, boxes, strict=True):
        text.set_position(tuple(back.transform((box[:2] + box[2:]) / 2)))
        end = leader(anchor, box)
        if np.linalg.norm(end - anchor) > 2.5 * _RADIUS:
            line = back.transform(np.array([anchor, end]))
            axes.plot(line[:, 0], line[:, 1], color=_GRAY, lw=0.5, zorder=1)


def _point(place: Place) -> tuple[float, float]:
    return float(place.regularity.value or 0.0), _height(place)


def _slant(place: Place) -> str:
    return "italic" if place.head.reference else "normal"


def _together(axes: Axes, above: Sequence[Place]) -> list[list[Place]]:
    """Return the places in groups that share a caption: one method whose points, by lattice source, coincide."""
    groups: list[list[Place]] = []
    for place in above:
        at = axes.transData.transform(_point(place))
        for group in groups:
            apart = np.linalg.norm(at - axes.transData.transform(_point(group[0])))
            if _says(group[0]) == _says(place) and apart < _RADIUS:
                group.append(place)
                break
        else:
            groups.append([place])
    return groups


def _says(place: Place) -> tuple[str, str, str]:
    return place.head.method, partly(place), place.no_cheat.sign


def _obstacles(axes: Axes, above: Sequence[Place]) -> NDArray[np.float64]:
    """Return the boxes, in pixels, of the points, their bars and the line of the best copier."""
    boxes = []
    for place in above:
        x, y = float(place.regularity.value or 0.0), _height(place)
        boxes.append([x, y, x, y])
        if (ends := _ends(place.regularity)) is not None:
            boxes.append([ends[0], y, ends[1], y])
        if (ends := _ends(place.randomness)) is not None:
            boxes.append([x, ends[0], x, ends[1]])
    corners = axes.transData.transform(np.array(boxes).reshape(-1, 2)).reshape(-1, 4)
    line = axes.transData.transform([(-0.05, COPIER), (1.05, COPIER)]).reshape(1, 4)
    corners = np.concatenate([corners, line])
    grown: NDArray[np.float64] = corners + np.array([-1, -1, 1, 1]) * (_RADIUS - 1)
    return grown


def _draw_strip(axes: Axes, below: Sequence[Place]) -> None:
    """Draw the methods whose randomness is nowhere scored, one a line."""
    lines = [_strip_caption(place).count("\n") + 1 for place in below]
    rows = np.cumsum(lines) - np.array(lines) / 2
    axes.set(xlim=(-0.05, 1.05), ylim=(sum(lines) + 0.15, -0.15), yticks=[], xticks=np.linspace(0, 1, 6))
    axes.tick_params(length=3, width=0.7)
    aside: dict[str, Any] = {"transform": axes.transAxes, "color": _GRAY, "fontsize": 6, "va": "center"}
    axes.text(-0.03, 0.5, "randomness\nnot scored", ha="right", **aside)
    for row, place in zip(rows.tolist(), below, strict=True):
        _draw_point(axes, place, row, False)
        x = place.regularity.value or 0.0
        low, high = _ends(place.regularity) or (x, x)
        right = 1 - high > low
        axes.annotate(
            _strip_caption(place),
            (high if right else low, row),
            (8 if right else -8, 0),
            textcoords="offset points",
            ha="left" if right else "right",
            va="center",
            style=_slant(place),
        )


def _strip_caption(place: Place) -> str:
    return wrapped(f"{caption([place])} n = {place.regularity.n}", 26)


def _draw_key(figure: Figure, found: Sequence[Place], foot: float, total: float) -> None:
    middle = 0.5 - 2 / (72 * figure.get_figwidth())
    figure.text(
        middle, (foot - 26) / total, "regularity.score: share of tiles in place and intact", ha="center", va="center"
    )
    most = max(place.regularity.of for place in found)
    key = [("o", _INK, "method"), ("D", _FAINT, "reference, not ranked")]
    if any(not place.known for place in found):
        key.append(("o", "white", "not scored"))
    style: dict[str, Any] = {"ls": "", "ms": 2 * _RADIUS - 1, "mec": _INK, "mew": 0.8}
    handles = [Line2D([], [], marker=sign, mfc=fill, label=words, **style) for sign, fill, words in key]
    handles.append(Line2D([], [], color=_INK, lw=0.9, label=f"95 % over {most} textures"))
    place: dict[str, Any] = {
        "loc": "center",
        "bbox_to_anchor": (middle, (foot - (46 if figure.get_figwidth() < _NARROW else 41)) / total),
    }
    figure.legend(
        handles=handles,
        ncols=2 if figure.get_figwidth() < _NARROW else 4,
        frameon=False,
        fontsize=7,
        handlelength=1.1,
        handletextpad=0.5,
        columnspacing=1.1,
        **place,
    )
    for row, words in enumerate(reversed(_footnotes(found))):
        figure.text(middle, (4 + 9 * row) / total, words, ha="center", fontsize=7, color=_GRAY)


def _footnotes(found: Sequence[Place]) -> list[str]:
    """Return what the brackets and signs in the captions say, as far as they occur."""
    rests = ["[k of n]: the height rests on the k textures whose lattice is not lost"]
    right = [f"{SIGN} {LEGEND} ({SHARES})"]
    return rests * any(map(partly, found)) + right * any(place.no_cheat.n for place in found)
