"""The option --straighten of the command lattice: the lattice of a bent image, and the image made straight."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from nrbench.cli.lattice_results import LatticeResult

if TYPE_CHECKING:
    from nrbench.imaging.convert import Image
    from nrbench.tracking.deformation import Deformation

LARGEST = 1024
"""px; a larger image is followed only if ``--straighten`` is given, because it takes long."""


def straighten_picture(
    image: Image, spec: str, lattice: str | None, overlay: Path | None, output: Path, as_json: bool
) -> None:
    """Print the mean lattice, the deformation and the short list, and write the image with its deformation undone.

    Parameters
    ----------
    image
        The image.
    spec
        The detector, with its parameters.
    lattice
        The lattice as text; None: it is detected.
    overlay
        Where to draw the lattice as it lies in the image; None: nowhere.
    output
        Where to write the straight image.
    as_json
        Whether to print JSON.
    """
    from nrbench.api import as_lattice, follow_lattice
    from nrbench.imaging.files import write_image
    from nrbench.plugins.forms import NoLatticeFound
    from nrbench.plugins.parameters import parse_spec

    name, parameters = parse_spec(spec)
    try:
        followed = follow_lattice(image, as_lattice(lattice), name, parameters)
    except NoLatticeFound as none:
        click.echo(f"{output}: not written, there is no lattice to straighten by", err=True)
        LatticeResult(name, None, reason=none.reason).print(as_json)
        return
    found = followed.deformation
    straight, straight_lattice = found.straighten()
    write_image(output, straight)
    if overlay is not None:
        write_image(overlay, draw_deformed_lattice(image, found))
    numbers = ",".join(f"{number:.4f}" for number in straight_lattice.numbers)
    click.echo(f"{output}: its lattice is {numbers}", err=True)
    result = LatticeResult.of_followed("" if lattice else name, followed, has_origin=True)
    replace(result, straightened=straight_lattice).print(as_json)


def find_bent_lattice(image: Image, detector: str) -> LatticeResult | None:
    """Return the mean lattice of a bent image in which a detector finds no lattice; None if there is none.

    Little time is spent on images without a lattice, and none on large ones (:data:`LARGEST`).
    """
    from nrbench.api import follow_lattice
    from nrbench.plugins.forms import NoLatticeFound

    if max(image.shape[:2]) > LARGEST:
        return None
    try:
        followed = follow_lattice(image, detector=detector, only_promising=True)
    except NoLatticeFound:
        return None
    return LatticeResult.of_followed(detector, followed, has_origin=False) if followed.deformation.bent else None


def draw_deformed_lattice(image: Image, found: Deformation) -> Image:
    """Return the image with the cells of its lattice drawn where they lie."""
    import numpy as np

    from nrbench.imaging.overlays import draw_lattice, draw_segments

    if not found.bent:
        return draw_lattice(image, found.lattice)
    steps = 4
    numbers = np.unique(np.floor(found.cells + 1e-6).astype(np.int64), axis=0)
    pieces = []
    for axis in (0, 1):
        start = np.repeat(numbers, steps, 0).astype(np.float64)
        start[:, axis] += np.tile(np.arange(steps) / steps, len(numbers))
        end = start.copy()
        end[:, axis] += 1 / steps
        pieces.append((start, end))
    starts, ends = (found.locate(found.lattice.from_cell(np.concatenate(part))) for part in zip(*pieces, strict=True))
    size = np.array(image.shape[1::-1])
    seen = ((starts >= -1) & (starts <= size) & (ends >= -1) & (ends <= size)).all(1)
    return draw_segments(image, starts[seen], ends[seen])
