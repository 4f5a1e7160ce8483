"""The page to label: one file, offline, blind."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from nrbench.labelling.labels import ANSWERS, Sheet
from nrbench.policy import allowed
from nrbench.runs.store import RunDirectory

_TEMPLATES = Path(__file__).parent / "templates"
_NEEDED = (b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND")


def label_page(root: Path, sheet: Sheet) -> str:
    """Return the page: every picture is in it, and nothing that names a cell, a method or a texture.

    Parameters
    ----------
    root
        The run directory.
    sheet
        What is shown, in which order.
    """
    env = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES), autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True
    )
    style, script = (Markup(env.get_template(f"label.{kind}").render()) for kind in ("css", "js"))
    content = Markup(json.dumps(_content(root, sheet), separators=(",", ":")))
    policy = {"style_hash": allowed(style), "script_hash": allowed(script)}
    return env.get_template("label.html").render(style=style, script=script, content=content, answers=ANSWERS, **policy)


def _content(root: Path, sheet: Sheet) -> dict[str, Any]:
    """Return what the script works on; pictures stand once each, in the order in which they are first shown."""
    places: dict[str, int] = {}
    items = [[item.id, *(_place(picture, places) for picture in _pictures(root, item.cell))] for item in sheet.items]
    return {"sheet": sheet.name, "answers": ANSWERS, "items": items, "pictures": list(places)}


def _pictures(root: Path, cell: str) -> tuple[str, str]:
    folder = RunDirectory(root).cell(cell)
    sample, output = (base64.b64encode(bare(path.read_bytes())).decode() for path in (folder.sample, folder.output))
    return sample, output


def _place(picture: str, places: dict[str, int]) -> int:
    return places.setdefault(picture, len(places))


def bare(png: bytes) -> bytes:
    """Return a PNG with nothing but its pixels: texts, times and names of programs could tell who made it."""
    return png[:8] + b"".join(chunk for kind, chunk in _chunks(png) if kind in _NEEDED)


def _chunks(png: bytes) -> Iterator[tuple[bytes, bytes]]:
    start = 8
    while start + 12 <= len(png):
        (length,) = struct.unpack(">I", png[start : start + 4])
        stop = start + 12 + length
        yield png[start + 4 : start + 8], png[start:stop]
        start = stop
