"""Textures as files: PNG, with ``truth.csv``, ``truth.json`` and a contact sheet beside them.

``truth.csv`` is for people and other programs: names, vectors, kinds. ``truth.json`` also holds how each picture was
drawn, so that a run on the directory knows as much as a run of the suite that it was rendered from.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from nrbench.errors import BadInput
from nrbench.imaging.door import Image
from nrbench.imaging.files import write_image
from nrbench.imaging.sheet import contact_sheet
from nrbench.parameters import parse_spec
from nrbench.plan import Sample
from nrbench.store import write_aside, write_json
from nrbench.suite import Suite, size_text, validated_suite
from nrbench.texture import Texture

TRUTH_FIELDS = ("file", "t1x", "t1y", "t2x", "t2y", "originx", "originy", "family", "kind", "regular_share")
SHEET = "contact-sheet.png"


def model_suite(spec: str) -> Suite:
    """Return a suite of a single model: ``name:param=value,...``."""
    name, parameters = parse_spec(spec)
    return validated_suite({"name": name, "texture": [{"name": name, "dataset": name, "parameters": parameters}]}, spec)


def write_textures(samples: Iterable[Sample], directory: Path) -> list[Path]:
    """Write each texture as ``NAME.png`` (``NAME-REPLICATE.png`` from the second on), its truth, and a contact sheet.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    BadInput
        When a texture cannot be drawn, two would have one name, or ``directory`` is a file.
    """
    if directory.exists() and not directory.is_dir():
        raise BadInput(f"{directory}: is a file; pass a directory as -o")
    named: dict[str, tuple[Sample, Texture]] = {}
    for sample in samples:
        if sample.texture is None:
            raise BadInput(f"{sample.row.name}: cannot be drawn: {sample.fault}")
        name = _file_name(sample)
        if name in named or name == SHEET:
            raise BadInput(f"{name}: the name of two pictures; rename the texture {sample.row.name!r}")
        named[name] = sample, sample.texture
        directory.mkdir(parents=True, exist_ok=True)
        write_image(directory / name, sample.texture.image)
    write_image(directory / SHEET, _sheet(named))
    write_aside(directory / "truth.csv", lambda aside: _write_csv(aside, named))
    textures = {name: _known(sample, texture) for name, (sample, texture) in named.items()}
    write_json(directory / "truth.json", {"sheet": SHEET, "textures": textures})
    return [directory / name for name in (*named, SHEET, "truth.csv", "truth.json")]


def _file_name(sample: Sample) -> str:
    return f"{sample.row.name}{f'-{sample.recipe.replicate}' if sample.recipe.replicate else ''}.png"


def _sheet(named: dict[str, tuple[Sample, Texture]]) -> Image:
    captions = [f"{name.removesuffix('.png')}\n{_caption(*pair)}" for name, pair in named.items()]
    return contact_sheet([texture.image for _, texture in named.values()], captions)


def _caption(sample: Sample, texture: Texture) -> str:
    kind = f", type {texture.kind}" if texture.kind else ""
    share = "" if texture.regular_share is None else f", regular share {texture.regular_share:.2f}"
    return f"{sample.recipe.dataset}{kind}{share}".replace("type stochastic", "stochastic")


def _known(sample: Sample, texture: Texture) -> dict[str, Any]:
    """Return all that is known of a picture, JSON-ready; :class:`~nrbench.suite.TextureRow` reads some of it back."""
    row, shape = sample.row, sample.recipe.shape
    recipe = {
        "dataset": sample.recipe.dataset,
        "parameters": dict(sample.recipe.parameters),
        "seed": sample.recipe.seed,
        "texture": sample.recipe.texture,
        "replicate": sample.recipe.replicate,
        "shape": size_text(shape),
    }
    return {
        "family": row.family or texture.family,
        "description": row.description,
        "figure": row.figure,
        "kind": texture.kind,
        "regular_share": texture.regular_share,
        "lattice": texture.lattice.as_dict() if texture.lattice else None,
        "lattices": [lattice.as_dict() for lattice in texture.lattices],
        "size": size_text(sample.shape),
        "recipe": recipe if sample.recipe.procedural else None,
    }


def _write_csv(path: Path, named: dict[str, tuple[Sample, Texture]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, TRUTH_FIELDS, restval="")
        writer.writeheader()
        writer.writerows(_csv_row(name, sample, texture) for name, (sample, texture) in named.items())


def _csv_row(name: str, sample: Sample, texture: Texture) -> dict[str, object]:
    row: dict[str, object] = {"file": name, "family": sample.row.family or texture.family, "kind": texture.kind or ""}
    row["regular_share"] = "" if texture.regular_share is None else texture.regular_share
    if texture.lattice is not None:
        for part in ("t1", "t2", "origin"):
            row[f"{part}x"], row[f"{part}y"] = map(repr, getattr(texture.lattice, part))
    return row
