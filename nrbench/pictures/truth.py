"""The truth beside the pictures of a folder: ``truth.csv`` and ``truth.json``, and files of vertices set by hand."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nrbench.errors import BadInput, require
from nrbench.lattice.geometry import Lattice, Vector
from nrbench.lattice.vertices import Vertex, find_grid_fault
from nrbench.storage import decimal_point, find_path, read_table

TRUTH_FILE = "truth.csv"
KNOWN_FILE = "truth.json"
"""The complete truth of the pictures of a render."""
SHEET = "contact-sheet.png"
"""The contact sheet of a render."""
VECTORS = ("t1x", "t1y", "t2x", "t2y")
ORIGIN = ("originx", "originy")
TRUTH_FIELDS = ("file", *VECTORS, *ORIGIN, "family", "kind", "regular_share")
"""The columns that ``nrbench render`` writes. Every table must have ``file`` and the vectors."""
_HEADER = ",".join(("file", *VECTORS))
_VERTEX_HEADER = ",".join(Vertex._fields)


@dataclass(frozen=True)
class TruthRow:
    """The row of one picture.

    Parameters
    ----------
    where
        File and line, for error messages.
    values
        The texts of the fields, by column.
    vectors
        ``t1``, ``t2`` and, if it is given, ``origin``, as (x, y) px; empty if no lattice is known.
    """

    where: str
    values: Mapping[str, str]
    vectors: Mapping[str, Vector]


@dataclass(frozen=True)
class TruthTable:
    """The content of a ``truth.csv``: its columns, and its rows by the pictures' file names."""

    fields: Sequence[str]
    rows: Mapping[str, TruthRow]

    @classmethod
    def read(cls, folder: Path) -> TruthTable:
        """Read the table of a folder; without a ``truth.csv`` there are no rows.

        Raises
        ------
        BadInput
            When a column is missing or occurs twice, or when a line has too many fields, has no file name or a path,
            repeats a file name, or has numbers that are no lattice. The message names the line.
        """
        path = folder / TRUTH_FILE
        if not path.is_file():
            return cls(TRUTH_FIELDS, {})
        rows: dict[str, TruthRow] = {}
        fields, lines = read_table(path, _HEADER)
        _check_fields(fields, f"{path} line 1")
        for line, values in lines:
            row = _row(values, f"{path} line {line}", len(fields), folder)
            name = row.values["file"]
            require(name not in rows, f"{row.where}: {name!r} occurs a second time; keep one")
            rows[name] = row
        return cls(fields, rows)


def read_truth(folder: Path) -> dict[str, dict[str, Vector]]:
    """Read ``truth.csv``: ``{"t1": (x, y), "t2": (x, y), "origin": (x, y)}`` in px by file name.

    A file whose numbers are empty gets ``{}``. A file without an origin gets none.

    Parameters
    ----------
    folder
        A directory. Without a ``truth.csv`` in it the result is empty.

    Raises
    ------
    BadInput
        When the table is malformed (see :class:`TruthTable`), or a line names a missing file.
    """
    rows = TruthTable.read(folder).rows
    for name, row in rows.items():
        if not (folder / name).is_file():
            raise BadInput(f"{row.where}: there is no file {name!r} beside it; correct the name, or drop the line")
    return {name: dict(row.vectors) for name, row in rows.items()}


def vertices_file(picture: Path) -> Path:
    """Return the file of a picture's vertices: ``wall.jpg.vertices.csv`` beside ``wall.jpg``."""
    return find_path(picture.with_name(f"{picture.name}.vertices.csv"))


def read_vertices(path: Path, shape: tuple[int, int]) -> tuple[Vertex, ...]:
    """Read the vertices of a picture of ``shape`` (height, width): CSV with the columns ``row,column,x,y``.

    Raises
    ------
    BadInput
        When the file or a line is malformed, a vertex lies outside the picture, two have the same number or place, or
        they are no grid: fewer than four, none of them with a neighbor in its row and one in its column, or cells that
        are flat or turned over. The message names the line.
    """
    fields, lines = read_table(path, _VERTEX_HEADER)
    if tuple(fields) != Vertex._fields:
        raise BadInput(f"{path} line 1: has the columns {','.join(fields) or '(none)'}; give {_VERTEX_HEADER}")
    vertices = [_read_vertex(values, f"{path} line {line}", shape) for line, values in lines]
    seen: dict[tuple[str, float, float], int] = {}
    for (line, _), one in zip(lines, vertices, strict=True):
        for part in (("row and column", one.row, one.column), ("place", one.x, one.y)):
            if (first := seen.setdefault(part, line)) != line:
                raise BadInput(f"{path} line {line}: has the {part[0]} of line {first}; keep one")
    fault = find_grid_fault(vertices)
    require(not fault, f"{path}: {fault}; number vertices by row and column, neighbors by neighboring numbers")
    return tuple(vertices)


def _read_vertex(values: Mapping[str, Any], where: str, shape: tuple[int, int]) -> Vertex:
    try:
        x, y = (float(decimal_point(values[name])) for name in ("x", "y"))
        vertex = Vertex(int(values["row"]), int(values["column"]), x, y)
        if None in values or max(map(abs, vertex[:2])) >= 1e6:
            raise ValueError(values)
    except ValueError:
        raise BadInput(f"{where}: is no vertex; give {_VERTEX_HEADER}: integers under 1e6, and x, y in px") from None
    if not (-0.5 <= x < shape[1] - 0.5 and -0.5 <= y < shape[0] - 0.5):
        raise BadInput(f"{where}: ({x:g}, {y:g}) lies outside the picture of {shape[1]}x{shape[0]} px; leave it out")
    return vertex


def vertices_text(vertices: Sequence[Vertex]) -> str:
    """Return vertices as CSV, to a thousandth px."""
    rows = [vertex._replace(x=round(vertex.x, 3), y=round(vertex.y, 3))._asdict() for vertex in sorted(vertices)]
    return table_text(Vertex._fields, rows)


def read_known(folder: Path, remedy: str) -> Any:
    """Return the content of the ``truth.json`` of a folder; an empty mapping without one.

    Raises
    ------
    BadInput
        When it is no JSON; ``remedy`` says what to do then.
    """
    path = folder / KNOWN_FILE
    try:
        return json.loads(path.read_bytes()) if path.is_file() else {}
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{path}: is no JSON ({error}); {remedy}") from None


def table_text(fields: Sequence[str], rows: Sequence[Mapping[str, object]]) -> str:
    """Return a table as CSV. Fields that are missing in a row are empty."""
    file = io.StringIO()
    writer = csv.DictWriter(file, fields, restval="")
    writer.writeheader()
    writer.writerows(rows)
    return file.getvalue()


def _check_fields(fields: Sequence[str], where: str) -> None:
    missing = [name for name in ("file", *VECTORS) if name not in fields]
    if missing:
        found = ", ".join(map(repr, fields)) or "nothing"
        wanted = f"the first line must have {_HEADER}, and has {found:.200}"
        raise BadInput(f"{where}: column {missing[0]!r} is missing; {wanted}")
    twice = [name for i, name in enumerate(fields) if name and name in fields[:i]]
    if twice:
        raise BadInput(f"{where}: column {twice[0]!r} occurs a second time; keep one")
    half = [name for name in ORIGIN if name in fields]
    if len(half) == 1:
        raise BadInput(f"{where}: has only {half[0]!r}; give both columns {','.join(ORIGIN)}, or neither")


def _row(values: Mapping[str, Any], where: str, columns: int, folder: Path) -> TruthRow:
    if None in values:  # the key under which csv.DictReader stores surplus fields
        surplus = len(values[None])  # type: ignore[index]
        raise BadInput(
            f"{where}: has {columns + surplus} fields for {columns} columns; quote fields that contain a comma"
        )
    plain = {name: str(text).strip() for name, text in values.items()}
    plain |= {name: decimal_point(plain[name]) for name in (*VECTORS, *ORIGIN) if name in plain}
    exact = str(values["file"])
    if Path(exact).name == exact and (folder / exact).is_file():
        plain["file"] = exact  # the name of a file may begin with a space, or contain a backslash
    elif not plain["file"]:
        raise BadInput(f"{where}: has no file name; give it, or delete the line")
    elif "/" in plain["file"] or "\\" in plain["file"] or plain["file"] in (".", ".."):
        raise BadInput(f"{where}: {plain['file']!r} is a path; give the name of a picture in the folder of the table")
    else:
        plain["file"] = find_path(folder / plain["file"]).name
    return TruthRow(where, plain, _vectors(plain, where))


def _vectors(values: Mapping[str, str], where: str) -> dict[str, Vector]:
    """Return the vectors of a line, which has four numbers, six with an origin, or none."""
    numbers = [values.get(name, "") for name in (*VECTORS, *ORIGIN)]
    if not any(numbers):
        return {}
    has_origin = any(numbers[4:])
    try:
        lattice = Lattice.parse(",".join(numbers if has_origin else numbers[:4]))
    except BadInput as error:
        raise BadInput(f"{where}: {error}") from None
    return {"t1": lattice.t1, "t2": lattice.t2} | ({"origin": lattice.origin} if has_origin else {})
