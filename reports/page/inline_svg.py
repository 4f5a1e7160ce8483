"""Put plots into the page as inline SVG, which follows the colors of the page."""

from __future__ import annotations

import re

from markupsafe import Markup

from ..plots.figure_file import FAINT, GRAY, INK

_COLORS = {INK: "ink", GRAY: "gray", FAINT: "faint", "white": "paper"}
_HEX = {"black": "#000000", "0.45": "#737373", "0.8": "#cccccc", "white": "#ffffff"}


def inline_svg(svg: bytes, name: str) -> Markup:
    """Return a plot as an element of the page, hidden from screen readers: its figure has a text of its own.

    The content policy of the page forbids style attributes, so they become attributes of their own. The gray levels of
    plots become classes, so that the style of the page can change them in dark mode. Every id gets a prefix.

    Parameters
    ----------
    svg
        A plot of :func:`~nrbench.reports.plots.figure_file.returns_file`.
    name
        The prefix of its ids, unique on the page.
    """
    text = svg.decode("utf-8")
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->|<defs>\s*</defs>", "", text, flags=re.S)
    text = re.sub(r' style="([^"]*)"', _as_attributes, text)
    text = re.sub(r'(\bid="|xlink:href="#|url\(#)', rf"\g<1>{name}-", text).replace("xlink:href", "href")
    text = re.sub(r"\s*\n\s*", "\n", text)
    view = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', text)
    width = f' width="{float(view[1]) * 4 / 3:.0f}" height="{float(view[2]) * 4 / 3:.0f}"' if view else ""
    inner = text[text.index(">") + 1 :]
    box = f' viewBox="0 0 {view[1]} {view[2]}"' if view else ""
    return Markup(  # the plot is our own; names in it are paths of glyphs, not text
        f'<svg class="plot" aria-hidden="true" focusable="false"{width}{box} stroke-linejoin="round">{inner}'
    )


def _as_attributes(match: re.Match[str]) -> str:
    """Return the declarations of a style attribute as attributes; gray levels as classes."""
    parts, classes = [], []
    for declaration in match[1].split(";"):
        key, _, value = (part.strip() for part in declaration.partition(":"))
        known = next((_COLORS[name] for name, code in _HEX.items() if code == value), None)
        if known and key in ("fill", "stroke"):
            classes.append(f"{key}-{known}")
        elif key:
            parts.append(f'{key}="{value}"')
    return "".join(f" {part}" for part in parts) + (f' class="{" ".join(classes)}"' if classes else "")
