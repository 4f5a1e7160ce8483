"""What is known of the pictures in a rendered directory, and what of it a further render keeps."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from nrbench.errors import BadInput
from nrbench.imaging.convert import Image
from nrbench.imaging.files import read_image
from nrbench.runs.store import write_aside, write_json
from nrbench.streams import pixels_hash
from nrbench.suites.truth import TRUTH_FIELDS, TRUTH_FILE, TruthTable, write_table

SHEET = "contact-sheet.png"
KNOWN_FILE = "truth.json"
_ELSEWHERE = "pass another -o, or move it away"


@dataclass(frozen=True)
class Rendered:
    """The truth beside the pictures of a directory.

    Parameters
    ----------
    fields
        Columns of ``truth.csv``.
    rows
        Its lines, by file name.
    textures
        What ``truth.json`` holds, by file name.
    """

    fields: Sequence[str]
    rows: Mapping[str, Mapping[str, object]]
    textures: Mapping[str, Mapping[str, Any]]

    @classmethod
    def read(cls, folder: Path) -> Rendered:
        """Read what is known of the pictures that are still there; nothing where the directory is new.

        Raises
        ------
        BadInput
            When ``folder`` is a file, or a truth file in it is malformed or was not written by a render.
        """
        if folder.exists() and not folder.is_dir():
            raise BadInput(f"{folder}: is a file; pass a directory as -o")
        try:
            table = TruthTable.read(folder)
        except BadInput as error:
            raise BadInput(f"{error}; to render here, mend the table first, or pass another -o") from None
        missing = [name for name in TRUTH_FIELDS if name not in table.fields]
        if missing:
            told = f"was not written by `nrbench render` (it lacks column {missing[0]!r})"
            raise BadInput(f"{folder / TRUTH_FILE}: {told}; {_ELSEWHERE}")
        rows = {name: row.values for name, row in table.rows.items() if (folder / name).is_file()}
        textures = {name: known for name, known in _textures(folder).items() if (folder / name).is_file()}
        return cls(table.fields, rows, textures)

    def check_replaceable(self, path: Path, image: Image) -> None:
        """Refuse to write ``image`` over another picture that no render could draw again."""
        again = self.textures.get(path.name, {}).get("recipe")
        if path.exists() and not again and not (path.is_file() and _holds(path, image)):
            raise BadInput(f"{path}: is there, and no model drew it; {_ELSEWHERE}, or rename the texture")

    def check_sheet(self, folder: Path) -> None:
        """Refuse to write over a picture that is called like the contact sheet and is none."""
        if (folder / SHEET).exists() and not (folder / KNOWN_FILE).is_file():
            raise BadInput(f"{folder / SHEET}: is there, and was not written by `nrbench render`; {_ELSEWHERE}")

    def merged(self, rows: Mapping[str, Mapping[str, object]], textures: Mapping[str, Mapping[str, Any]]) -> Rendered:
        """Return this with what is known of further pictures; of those rendered again, the new."""
        return replace(self, rows={**self.rows, **rows}, textures={**self.textures, **textures})

    def write(self, folder: Path) -> None:
        """Write both truth files; a reader sees the old or the whole new one."""
        write_aside(folder / TRUTH_FILE, lambda aside: write_table(aside, self.fields, list(self.rows.values())))
        write_json(folder / KNOWN_FILE, {"sheet": SHEET, "textures": self.textures})


def _textures(folder: Path) -> dict[str, dict[str, Any]]:
    path = folder / KNOWN_FILE
    if not path.is_file():
        return {}
    try:
        content = json.loads(path.read_text("utf-8"))
    except ValueError as error:
        raise BadInput(f"{path}: is no JSON ({error}); {_ELSEWHERE}") from None
    textures = content.get("textures") if isinstance(content, dict) else None
    if not (isinstance(textures, dict) and content.get("sheet") == SHEET and all(map(_is_known, textures.values()))):
        raise BadInput(f"{path}: was not written by `nrbench render`; {_ELSEWHERE}")
    return textures


def _is_known(known: Any) -> bool:
    due = {"recipe": dict | None, "kind": str | None, "regular_share": float | int | None, "family": str | None}
    return isinstance(known, dict) and all(isinstance(known.get(name), form) for name, form in due.items())


def _holds(path: Path, image: Image) -> bool:
    """Return whether a file holds this picture: a render that was interrupted may go on."""
    try:
        return pixels_hash(read_image(path)) == pixels_hash(image)
    except BadInput:
        return False
