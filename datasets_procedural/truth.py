"""``truth.csv``: the known lattices of a directory of pictures."""

from __future__ import annotations

import csv
from pathlib import Path

from nrbench.errors import BadInput
from nrbench.lattice.geometry import Lattice, Vector

ENDINGS = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp"})
"""Endings of the files that count as pictures."""
_NUMBERS = ("t1x", "t1y", "t2x", "t2y")
_HEADER = ",".join(("file", *_NUMBERS))


def read_truth(folder: Path) -> dict[str, dict[str, Vector]]:
    """Return the generating vectors ``{"t1": (x, y), "t2": (x, y)}`` in px by file name; {} for empty ones.

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
    try:
        x1, y1, x2, y2 = map(float, texts)
        lattice = Lattice((x1, y1), (x2, y2))
    except BadInput as error:
        raise BadInput(f"{where}: {error}") from None
    except ValueError:
        raise BadInput(
            f"{where}: {','.join(texts)!r} are not four numbers; give {','.join(_NUMBERS)}, or none"
        ) from None
    return {"t1": lattice.t1, "t2": lattice.t2}
