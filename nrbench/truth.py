"""``truth.csv``: the table of what is known of a directory of pictures, read strictly."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nrbench.errors import BadInput
from nrbench.lattice.geometry import Lattice, Vector

TRUTH_FILE = "truth.csv"
VECTORS = ("t1x", "t1y", "t2x", "t2y")
ORIGIN = ("originx", "originy")
TRUTH_FIELDS = ("file", *VECTORS, *ORIGIN, "family", "kind", "regular_share")
"""The columns that ``nrbench render`` writes; ``file`` and the vectors must stand in every table."""
_HEADER = ",".join(("file", *VECTORS))


@dataclass(frozen=True)
class TruthRow:
    """What the table says of one picture.

    Parameters
    ----------
    where
        File and line, for errors.
    values
        The fields as they stand, by column.
    vectors
        ``t1``, ``t2`` and, where it is given, ``origin``, as (x, y) px; {} where no lattice is known.
    """

    where: str
    values: Mapping[str, str]
    vectors: Mapping[str, Vector]


@dataclass(frozen=True)
class TruthTable:
    """A ``truth.csv``: its columns, and a row for each picture that is named, by file name."""

    fields: Sequence[str]
    rows: Mapping[str, TruthRow]

    @classmethod
    def read(cls, folder: Path) -> TruthTable:
        """Read the table of a folder; without a ``truth.csv`` in it nothing is known.

        Raises
        ------
        BadInput
            When a column is missing or stands twice, or a line has more fields than there are columns, names no file
            of the folder itself, names one a second time, or has numbers that are no lattice (naming the line).
        """
        path = folder / TRUTH_FILE
        if not path.is_file():
            return cls(TRUTH_FIELDS, {})
        rows: dict[str, TruthRow] = {}
        fields, lines = _lines(path)
        _check_fields(fields, f"{path} line 1")
        for line, values in lines:
            row = _row(values, f"{path} line {line}", len(fields))
            name = row.values["file"]
            if name in rows:
                raise BadInput(f"{row.where}: {name!r} stands a second time; leave one")
            rows[name] = row
        return cls(fields, rows)


def write_table(path: Path, fields: Sequence[str], rows: Sequence[Mapping[str, object]]) -> None:
    """Write a table; fields that a row lacks are empty."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fields, restval="")
        writer.writeheader()
        writer.writerows(rows)


def _lines(path: Path) -> tuple[Sequence[str], list[tuple[int, dict[str, Any]]]]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as lines:
            reader = csv.DictReader(lines, restval="")
            fields = [name.strip() for name in reader.fieldnames or ()]
            reader.fieldnames = fields
            return fields, [(reader.line_num, row) for row in reader]
    except (UnicodeDecodeError, csv.Error) as error:
        raise BadInput(f"{path}: is no CSV text ({error}); save it as UTF-8 with the columns {_HEADER}") from None


def _check_fields(fields: Sequence[str], where: str) -> None:
    missing = [name for name in ("file", *VECTORS) if name not in fields]
    if missing:
        raise BadInput(f"{where}: lacks column {missing[0]!r}; the first line must have {_HEADER}")
    twice = [name for i, name in enumerate(fields) if name and name in fields[:i]]
    if twice:
        raise BadInput(f"{where}: column {twice[0]!r} stands a second time; leave one")
    half = [name for name in ORIGIN if name in fields]
    if len(half) == 1:
        raise BadInput(f"{where}: has {half[0]!r} alone; give both columns {','.join(ORIGIN)}, or neither")


def _row(values: Mapping[str, Any], where: str, columns: int) -> TruthRow:
    if None in values:  # where csv.DictReader puts what is left of a line
        surplus = len(values[None])  # type: ignore[index]
        raise BadInput(
            f"{where}: has {columns + surplus} fields for {columns} columns; quote a field with a comma in it"
        )
    plain = {name: str(text).strip() for name, text in values.items()}
    name = plain["file"]
    if not name:
        raise BadInput(f"{where}: names no file; give its name, or drop the line")
    if "/" in name or "\\" in name or name in (".", ".."):
        raise BadInput(f"{where}: {name!r} is a path; only pictures beside the table count: give the file's name alone")
    return TruthRow(where, plain, _vectors(plain, where))


def _vectors(values: Mapping[str, str], where: str) -> dict[str, Vector]:
    """Return the vectors of a line; four numbers or none, and two of an origin, or none, where there are vectors."""
    start = _numbers(values, ORIGIN, where)
    vectors = _numbers(values, VECTORS, where)
    if not vectors:
        if start:
            raise BadInput(f"{where}: has an origin and no vectors; give {','.join(VECTORS)}, or no origin either")
        return {}
    try:
        t1, t2 = (vectors[0], vectors[1]), (vectors[2], vectors[3])
        lattice = Lattice(t1, t2, (start[0], start[1]) if start else (0.0, 0.0))
    except BadInput as error:
        raise BadInput(f"{where}: {error}") from None
    return {"t1": lattice.t1, "t2": lattice.t2} | ({"origin": lattice.origin} if start else {})


def _numbers(values: Mapping[str, str], names: Sequence[str], where: str) -> list[float]:
    """Return the numbers of some columns; none where all are empty, or there are no such columns."""
    texts = [values.get(name, "") for name in names]
    try:
        return [float(text) for text in texts] if any(texts) else []
    except ValueError:
        number = "two" if len(names) == 2 else "four"
        told = f"{','.join(texts)!r} are not {number} numbers"
        raise BadInput(f"{where}: {told}; give all of {','.join(names)}, or none") from None
