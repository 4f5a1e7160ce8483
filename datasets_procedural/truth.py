"""``truth.csv`` and ``truth.json``: what is known of a directory of pictures."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

from nrbench.errors import BadInput
from nrbench.lattice.geometry import Lattice, Vector

ENDINGS = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp"})
"""Endings of the files that count as pictures."""
_NUMBERS = ("t1x", "t1y", "t2x", "t2y")
_ORIGIN = ("originx", "originy")
_HEADER = ",".join(("file", *_NUMBERS))
_ROW = ("family", "description", "figure", "size", "recipe")
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
        When a column is missing, a line has no four numbers or parallel vectors, names no file in the folder, or
        names one a second time.
    """
    path = folder / "truth.csv"
    if not path.is_file():
        return {}
    known: dict[str, dict[str, Vector]] = {}
    for line, row in _rows(path):
        name = row["file"].strip()
        if name in known:
            raise BadInput(f"{path} line {line}: {name!r} stands a second time; leave one")
        if not (folder / name).is_file():
            raise BadInput(
                f"{path} line {line}: there is no file {name!r} beside it; correct the name, or drop the line"
            )
        known[name] = _vectors(row, f"{path} line {line}")
    return known


def _rows(path: Path) -> list[tuple[int, dict[str, str]]]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as lines:
            reader = csv.DictReader(lines, restval="")
            missing = {"file", *_NUMBERS}.difference(reader.fieldnames or ())
            if missing:
                raise BadInput(
                    f"{path} line 1: lacks column {sorted(missing)[0]!r}; the first line must have {_HEADER}"
                )
            return [(reader.line_num, row) for row in reader]
    except (UnicodeDecodeError, csv.Error) as error:
        raise BadInput(f"{path}: is no CSV text ({error}); save it as UTF-8 with the columns {_HEADER}") from None


def _vectors(row: dict[str, str], where: str) -> dict[str, Vector]:
    texts = [row[name].strip() for name in _NUMBERS]
    if not any(texts):
        return {}
    origin = [row.get(name, "").strip() for name in _ORIGIN]
    try:
        x1, y1, x2, y2, *start = map(float, texts + origin * all(origin))
        lattice = Lattice((x1, y1), (x2, y2), (start[0], start[1]) if start else (0.0, 0.0))
    except BadInput as error:
        raise BadInput(f"{where}: {error}") from None
    except ValueError:
        raise BadInput(
            f"{where}: {','.join(texts)!r} are not four numbers; give {','.join(_NUMBERS)}, or none"
        ) from None
    return {"t1": lattice.t1, "t2": lattice.t2} | ({"origin": lattice.origin} if start else {})


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
