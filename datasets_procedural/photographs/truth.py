"""``truth.csv`` and ``truth.json``: what is known of a directory of pictures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from nrbench.errors import BadInput
from nrbench.lattice.geometry import Vector
from nrbench.suites.truth import TruthTable

ENDINGS = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp"})
"""Endings of the files that count as pictures."""
_ROW = ("family", "description", "figure", "departure", "level", "size", "recipe")
"""What a suite's row takes from ``truth.json``."""


def read_truth(folder: Path) -> dict[str, dict[str, Vector]]:
    """Return ``{"t1": (x, y), "t2": (x, y), "origin": (x, y)}`` in px by file name; {} where the numbers are empty.

    The columns ``originx, originy`` may be missing: the origin is then the picture's corner, and not returned.

    Parameters
    ----------
    folder
        A directory; without a ``truth.csv`` in it nothing is known.

    Raises
    ------
    BadInput
        When the table is malformed (see :class:`~nrbench.suites.truth.TruthTable`), or a line names no file in the folder.
    """
    rows = TruthTable.read(folder).rows
    for name, row in rows.items():
        if not (folder / name).is_file():
            raise BadInput(f"{row.where}: there is no file {name!r} beside it; correct the name, or drop the line")
    return {name: dict(row.vectors) for name, row in rows.items()}


def read_rendered(folder: Path) -> tuple[str, dict[str, dict[str, Any]]]:
    """Return the name of the contact sheet, and of each picture what ``nrbench render`` wrote for a suite's row.

    Parameters
    ----------
    folder
        A directory; without a ``truth.json`` of ours in it nothing is known.

    Raises
    ------
    BadInput
        When ``truth.json`` is no JSON, or what it says of a picture is no table.
    """
    path = folder / "truth.json"
    try:
        content = json.loads(path.read_text("utf-8")) if path.is_file() else {}
    except ValueError as error:
        raise BadInput(f"{path}: is no JSON ({error}); render the textures again, or delete it") from None
    textures = content.get("textures") if isinstance(content, dict) else None
    if not isinstance(textures, dict):
        return "", {}
    for name, known in textures.items():
        if not isinstance(known, dict):
            raise BadInput(f"{path}: picture {name!r}: {known!r} is no table; render the textures again, or delete it")
    kept = {
        name: {key: known[key] for key in _ROW if known.get(key) not in (None, "")} for name, known in textures.items()
    }
    return str(content.get("sheet", "")), {name: row | _whole(row) for name, row in kept.items()}


def _whole(row: dict[str, Any]) -> dict[str, Any]:
    """Return the shape of a rendered picture: all of it is the sample."""
    shape = row["recipe"].get("shape") if isinstance(row.get("recipe"), dict) else None
    return {"sample": shape} if shape else {}
