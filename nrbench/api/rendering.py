"""Write textures as PNG files, with ``truth.csv``, ``truth.json`` and a contact sheet beside them.

``truth.csv`` holds names, vectors and kinds for people and other programs. ``truth.json`` also holds the recipe of each
picture, so that a run on the directory has the same truth as a run of the suite from which it was rendered.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.imaging.convert import Image
from nrbench.pictures.files import read_image, write_image
from nrbench.pictures.overlays import contact_sheet
from nrbench.pictures.truth import KNOWN_FILE, SHEET, TRUTH_FIELDS, TRUTH_FILE, TruthTable, read_known, table_text
from nrbench.plugins.forms import Texture
from nrbench.plugins.parameters import parse_spec, size_text
from nrbench.storage import write_json, write_text
from nrbench.streams import pixels_hash
from nrbench.suites.plan import Sample
from nrbench.suites.suite import Suite, validated_suite

_ELSEWHERE = "pass another -o, or move it away"
_ByName = dict[str, tuple[Sample, Texture]]
"""Textures to be written, by file name."""


def model_suite(spec: str) -> Suite:
    """Return a suite of a single model, ``name:param=value,...``; raise BadInput if it is not valid."""
    name, parameters = parse_spec(spec)
    plugins.build("datasets", name, parameters)
    return validated_suite({"name": name, "texture": [{"name": name, "dataset": name, "parameters": parameters}]}, spec)


def write_textures(samples: Iterable[Sample], directory: Path) -> list[Path]:
    """Write each texture as ``NAME.png`` (``NAME-REPLICATE.png`` from the second on), its truth, and a contact sheet.

    Other pictures of an earlier render in ``directory`` are kept with their truth, and are also on the contact sheet. A
    picture of the same name is replaced if a model can draw it again. All checks precede the first write.

    Returns
    -------
    list of Path
        The files written.

    Raises
    ------
    BadInput
        When a texture cannot be drawn, two textures have the same name, ``directory`` is a file, or a file would be
        lost (a truth file of another origin, or another picture of the same name).
    """
    existing = _Rendered.read(directory)
    by_name = _by_name(samples)
    for name, (_, texture) in by_name.items():
        existing.check_replaceable(directory / name, texture.image)
    existing.check_sheet(directory)
    rendered = dataclasses.replace(
        existing,
        rows={**existing.rows, **{name: _row(name, *pair) for name, pair in by_name.items()}},
        textures={**existing.textures, **{name: _known(*pair) for name, pair in by_name.items()}},
    )
    sheet = _sheet(directory, by_name, rendered)
    directory.mkdir(parents=True, exist_ok=True)
    for name, (_, texture) in by_name.items():
        write_image(directory / name, texture.image)
    rendered.write(directory)
    write_image(directory / SHEET, sheet)
    return [directory / name for name in (*by_name, SHEET, TRUTH_FILE, KNOWN_FILE)]


def _by_name(samples: Iterable[Sample]) -> _ByName:
    """Return textures by file name. Names that differ only in case are refused, as they are equal on some systems."""
    by_name: _ByName = {}
    taken = {SHEET}
    for sample in samples:
        if sample.texture is None:
            raise BadInput(f"{sample.row.name}: cannot be drawn: {sample.fault}")
        name = f"{sample.row.name}{f'-{sample.recipe.replicate}' if sample.recipe.replicate else ''}.png"
        if name.casefold() in taken:
            raise BadInput(f"{name}: the name of two pictures; rename the texture {sample.row.name!r}")
        taken.add(name.casefold())
        by_name[name] = sample, sample.texture
    return by_name


@dataclass(frozen=True)
class _Rendered:
    """The truth files of a rendered directory.

    Parameters
    ----------
    fields
        Columns of ``truth.csv``.
    rows
        Its lines, by file name.
    textures
        The entries of ``truth.json``, by file name.
    """

    fields: Sequence[str]
    rows: Mapping[str, Mapping[str, object]]
    textures: Mapping[str, Mapping[str, Any]]

    @classmethod
    def read(cls, folder: Path) -> _Rendered:
        """Read the truth of the pictures that exist in a directory; a new directory has none.

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
            raise BadInput(f"{error}. Fix {TRUTH_FILE} first, or pass another -o") from None
        missing = [name for name in TRUTH_FIELDS if name not in table.fields]
        if missing:
            why = f"was not written by `nrbench render` (it lacks column {missing[0]!r})"
            raise BadInput(f"{folder / TRUTH_FILE}: {why}; {_ELSEWHERE}")
        rows = {name: row.values for name, row in table.rows.items() if (folder / name).is_file()}
        textures = {name: known for name, known in _read_textures(folder).items() if (folder / name).is_file()}
        return cls(table.fields, rows, textures)

    def check_replaceable(self, path: Path, image: Image) -> None:
        """Raise BadInput if ``image`` would replace another picture that no model can draw again."""
        recipe = self.textures.get(path.name, {}).get("recipe")
        if path.exists() and not recipe and not (path.is_file() and _holds(path, image)):
            raise BadInput(f"{path}: exists, and no model drew it; {_ELSEWHERE}, or rename the texture")

    def check_sheet(self, folder: Path) -> None:
        """Raise BadInput if the contact sheet would replace a file of another origin."""
        if (folder / SHEET).exists() and not (folder / KNOWN_FILE).is_file():
            raise BadInput(f"{folder / SHEET}: exists, and was not written by `nrbench render`; {_ELSEWHERE}")

    def write(self, folder: Path) -> None:
        """Write both truth files, each atomically."""
        write_text(folder / TRUTH_FILE, table_text(self.fields, list(self.rows.values())))
        write_json(folder / KNOWN_FILE, {"sheet": SHEET, "textures": self.textures})


def _read_textures(folder: Path) -> dict[str, dict[str, Any]]:
    content = read_known(folder, _ELSEWHERE)
    if content == {} and not (folder / KNOWN_FILE).is_file():
        return {}
    textures = content.get("textures") if isinstance(content, dict) else None
    if not (isinstance(textures, dict) and content.get("sheet") == SHEET and all(map(_is_known, textures.values()))):
        raise BadInput(f"{folder / KNOWN_FILE}: was not written by `nrbench render`; {_ELSEWHERE}")
    return textures


def _is_known(known: Any) -> bool:
    types = {"recipe": dict | None, "kind": str | None, "regular_share": float | int | None, "family": str | None}
    return isinstance(known, dict) and all(isinstance(known.get(name), each) for name, each in types.items())


def _holds(path: Path, image: Image) -> bool:
    """Return whether a file holds the given picture; this is so after an interrupted render."""
    try:
        return pixels_hash(read_image(path)) == pixels_hash(image)
    except BadInput:
        return False


def _sheet(directory: Path, by_name: _ByName, rendered: _Rendered) -> Image:
    """Return all pictures of the directory as it will be, each under its caption."""
    images = [by_name[name][1].image if name in by_name else read_image(directory / name) for name in rendered.textures]
    captions = [f"{name.removesuffix('.png')}\n{_caption(known)}" for name, known in rendered.textures.items()]
    return contact_sheet(images, captions)


def _caption(known: Mapping[str, Any]) -> str:
    kind, share, recipe = (known.get(name) for name in ("kind", "regular_share", "recipe"))
    words = [str((recipe or {}).get("dataset") or known.get("family", ""))]
    if kind:
        words.append(kind if kind == "stochastic" else f"type {kind}")
    if share is not None:
        words.append(f"regular share {share:.2f}")
    return ", ".join(words)


def _known(sample: Sample, texture: Texture) -> dict[str, Any]:
    """Return a picture's entry of ``truth.json``; :class:`~nrbench.suites.suite.TextureRow` reads some of it."""
    recipe = sample.recipe
    return {
        "family": sample.row.family or texture.family,
        "description": sample.row.description,
        "figure": sample.row.figure,
        "departure": sample.row.departure,
        "level": sample.row.level,
        "kind": texture.kind,
        "regular_share": texture.regular_share,
        "lattice": texture.lattice.as_dict() if texture.lattice else None,
        "lattices": [lattice.as_dict() for lattice in texture.lattices],
        "size": size_text(sample.shape),
        "recipe": {**recipe.as_dict(), "shape": size_text(recipe.shape)} if recipe.procedural else None,
    }


def _row(name: str, sample: Sample, texture: Texture) -> dict[str, object]:
    """Return a picture's line of ``truth.csv``; its numbers keep every digit."""
    row: dict[str, object] = {"file": name, "family": sample.row.family or texture.family, "kind": texture.kind or ""}
    row["regular_share"] = "" if texture.regular_share is None else texture.regular_share
    if texture.lattice is not None:
        for part in ("t1", "t2", "origin"):
            row[f"{part}x"], row[f"{part}y"] = map(repr, getattr(texture.lattice, part))
    return row
