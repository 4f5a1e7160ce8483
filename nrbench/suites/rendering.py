"""Textures as files: PNG, with ``truth.csv``, ``truth.json`` and a contact sheet beside them.

``truth.csv`` is for people and other programs: names, vectors, kinds. ``truth.json`` also holds how each picture was
drawn, so that a run on the directory knows as much as a run of the suite that it was rendered from.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.imaging.contact_sheet import contact_sheet
from nrbench.imaging.convert import Image
from nrbench.imaging.files import read_image, write_image
from nrbench.plugins.forms import Texture
from nrbench.plugins.parameters import parse_spec
from nrbench.suites.cell import Recipe
from nrbench.suites.plan import Sample
from nrbench.suites.rendered import KNOWN_FILE, SHEET, Rendered
from nrbench.suites.suite import Suite, size_text, validated_suite
from nrbench.suites.truth import TRUTH_FILE

_Named = dict[str, tuple[Sample, Texture]]
"""What is to be written, by file name."""


def model_suite(spec: str) -> Suite:
    """Return a suite of a single model: ``name:param=value,...``; raises BadInput where it is not valid."""
    name, parameters = parse_spec(spec)
    plugins.build("datasets", name, parameters)
    return validated_suite({"name": name, "texture": [{"name": name, "dataset": name, "parameters": parameters}]}, spec)


def write_textures(samples: Iterable[Sample], directory: Path) -> list[Path]:
    """Write each texture as ``NAME.png`` (``NAME-REPLICATE.png`` from the second on), its truth, and a contact sheet.

    What is known of the other pictures that an earlier render left in ``directory`` is kept, and they stay on the
    contact sheet; a picture of the same name is replaced if its model can draw it again. All is checked before
    anything is written.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    BadInput
        When a texture cannot be drawn, two would have one name, ``directory`` is a file, or what is in it would be
        lost: truth files of another origin, or other pictures of the same names.
    """
    there = Rendered.read(directory)
    named = _named(samples)
    for name, (_, texture) in named.items():
        there.check_replaceable(directory / name, texture.image)
    there.check_sheet(directory)
    rows = {name: _row(name, *pair) for name, pair in named.items()}
    after = there.merged(rows, {name: _known(*pair) for name, pair in named.items()})
    sheet = _sheet(directory, named, after)
    directory.mkdir(parents=True, exist_ok=True)
    for name, (_, texture) in named.items():
        write_image(directory / name, texture.image)
    after.write(directory)
    write_image(directory / SHEET, sheet)
    return [directory / name for name in (*named, SHEET, TRUTH_FILE, KNOWN_FILE)]


def _named(samples: Iterable[Sample]) -> _Named:
    """Return drawn textures by file name; names that differ in case alone are one on some systems."""
    named: _Named = {}
    taken = {SHEET}
    for sample in samples:
        if sample.texture is None:
            raise BadInput(f"{sample.row.name}: cannot be drawn: {sample.fault}")
        name = f"{sample.row.name}{f'-{sample.recipe.replicate}' if sample.recipe.replicate else ''}.png"
        if name.casefold() in taken:
            raise BadInput(f"{name}: the name of two pictures; rename the texture {sample.row.name!r}")
        taken.add(name.casefold())
        named[name] = sample, sample.texture
    return named


def _sheet(directory: Path, named: _Named, after: Rendered) -> Image:
    """Return all pictures of the directory as it will be, each under its caption."""
    images = [named[name][1].image if name in named else read_image(directory / name) for name in after.textures]
    captions = [f"{name.removesuffix('.png')}\n{_caption(known)}" for name, known in after.textures.items()]
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
    """Return all that is known of a picture, JSON-ready; :class:`~nrbench.suites.suite.TextureRow` reads some of it back."""
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
        "recipe": _drawing(sample.recipe) if sample.recipe.procedural else None,
    }


def _drawing(recipe: Recipe) -> dict[str, Any]:
    """Return a recipe as :class:`~nrbench.suites.suite.Drawing` reads it."""
    return {**dataclasses.asdict(recipe), "shape": size_text(recipe.shape)}


def _row(name: str, sample: Sample, texture: Texture) -> dict[str, object]:
    """Return a picture's line of ``truth.csv``; its numbers keep every digit."""
    row: dict[str, object] = {"file": name, "family": sample.row.family or texture.family, "kind": texture.kind or ""}
    row["regular_share"] = "" if texture.regular_share is None else texture.regular_share
    if texture.lattice is not None:
        for part in ("t1", "t2", "origin"):
            row[f"{part}x"], row[f"{part}y"] = map(repr, getattr(texture.lattice, part))
    return row
