"""The option --straighten of the command lattice: the lattice of a bent image, and the image made straight."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from nrbench.imaging.convert import Image
    from nrbench.tracking.deformation import Deformation


def straighten_picture(
    image: Image, spec: str, lattice: str | None, overlay: Path | None, output: Path, as_json: bool
) -> None:
    """Print the mean lattice and the deformation of an image, and write the image with its deformation undone.

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
    from nrbench.api import track_lattice
    from nrbench.imaging.files import write_image
    from nrbench.plugins.forms import NoLatticeFound
    from nrbench.plugins.parameters import parse_spec

    name, parameters = parse_spec(spec)
    try:
        found = track_lattice(image, lattice, name, **parameters)
    except NoLatticeFound as none:
        click.echo(f"{output}: not written, there is no lattice to straighten by", err=True)
        print(json.dumps({"lattice": None, "reason": none.reason}) if as_json else f"no lattice: {none.reason}")
        return
    straight, straight_lattice = found.straighten()
    write_image(output, straight)
    if overlay is not None:
        write_image(overlay, draw_deformed_lattice(image, found))
    if as_json:
        start = {} if found.confidence is None else {"detector": name, "confidence": found.confidence}
        deformation = {**found.as_dict(), "straightened": straight_lattice.as_dict()}
        print(json.dumps({**found.lattice.as_dict(), **start, "deformation": deformation}))
        return
    print(describe_deformation(found))
    numbers = ",".join(f"{number:.4f}" for number in straight_lattice.numbers)
    click.echo(f"{output}: its lattice is {numbers}", err=True)


def describe_deformation(found: Deformation) -> str:
    """Return the mean lattice and the deformation in one line of text."""
    t1, t2 = (f"({x:.3f}, {y:.3f})" for x, y in (found.lattice.t1, found.lattice.t2))
    vectors = f"t1 = {t1} px, t2 = {t2} px"
    if not found.covered:
        return f"{vectors}, could not be followed: whether the image is bent is not known"
    if not found.bent:
        return f"{vectors}, not bent"
    kind = "smooth displacements" if found.homography is None else "a homography (perspective)"
    return f"mean lattice {vectors}, bent by {kind} of amplitude {found.amplitude:.2f} s"


def draw_deformed_lattice(image: Image, found: Deformation) -> Image:
    """Return the image with the cells of its lattice drawn where they lie."""
    import numpy as np

    from nrbench.imaging.drawing import draw_lattice, draw_segments

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
