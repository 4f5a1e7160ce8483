"""Textures as files: PNG, with ``truth.csv`` beside them."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path

from nrbench.errors import BadInput
from nrbench.imaging.files import write_image
from nrbench.parameters import parse_spec
from nrbench.plan import Sample
from nrbench.store import write_aside
from nrbench.suite import Suite, validated_suite

TRUTH_FIELDS = ("file", "t1x", "t1y", "t2x", "t2y", "originx", "originy", "family", "kind", "regular_share")


def model_suite(spec: str) -> Suite:
    """Return a suite of a single model: ``name:param=value,...``."""
    name, parameters = parse_spec(spec)
    return validated_suite({"name": name, "texture": [{"name": name, "dataset": name, "parameters": parameters}]}, spec)


def write_textures(samples: Iterable[Sample], directory: Path) -> list[Path]:
    """Write each texture as ``NAME.png`` (``NAME-REPLICATE.png`` from the second on), and ``truth.csv``.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    BadInput
        When a texture cannot be drawn, or ``directory`` is a file.
    """
    if directory.exists() and not directory.is_dir():
        raise BadInput(f"{directory}: is a file; pass a directory as -o")
    rows: list[dict[str, object]] = []
    written: list[Path] = []
    for sample in samples:
        if sample.texture is None:
            raise BadInput(f"{sample.row.name}: cannot be drawn: {sample.fault}")
        number = f"-{sample.recipe.replicate}" if sample.recipe.replicate else ""
        written.append(directory / f"{sample.row.name}{number}.png")
        directory.mkdir(parents=True, exist_ok=True)
        write_image(written[-1], sample.texture.image)
        rows.append(_truth(written[-1].name, sample))
    write_aside(directory / "truth.csv", lambda aside: _write_csv(aside, rows))
    return [*written, directory / "truth.csv"]


def _truth(file: str, sample: Sample) -> dict[str, object]:
    assert sample.texture is not None
    texture = sample.texture
    row: dict[str, object] = {"file": file, "family": texture.family, "kind": texture.kind or ""}
    row["regular_share"] = "" if texture.regular_share is None else texture.regular_share
    if texture.lattice is not None:
        for name in ("t1", "t2", "origin"):
            row[f"{name}x"], row[f"{name}y"] = map(repr, getattr(texture.lattice, name))
    return row


def _write_csv(path: Path, rows: list[dict[str, object]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, TRUTH_FIELDS, restval="")
        writer.writeheader()
        writer.writerows(rows)
