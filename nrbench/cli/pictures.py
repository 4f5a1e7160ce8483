"""Verbs for one picture: synth, lattice, score."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click


@click.command("synth")
@click.argument("image", type=click.Path(path_type=Path))
@click.option("-m", "method", required=True, metavar="METHOD[:param=value,...]", help="The method.")
@click.option("--size", required=True, metavar="WxH", help="Size of the output.")
@click.option("--lattice", metavar="x1,y1,x2,y2", help="The lattice of IMAGE.  [default: the method finds it]")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), metavar="OUT.png")
def synth_command(image: Path, method: str, size: str, lattice: str | None, seed: int, output: Path) -> None:
    """Synthesize a texture of any size from IMAGE."""
    from nrbench import plugins
    from nrbench.api import synthesize
    from nrbench.imaging.files import read_image, write_image
    from nrbench.parameters import parse_spec
    from nrbench.suite import parse_size

    name, parameters = parse_spec(method)
    _check_output(output)
    plugins.build("synthesizers", name, parameters)
    made = synthesize(name, read_image(image), parse_size(size), lattice, seed, **parameters)
    write_image(output, made.image)
    for title, array in made.extras.items():
        if array.ndim == 3 and array.shape[2] in (1, 3):
            write_image(output.with_name(f"{output.stem}-{title}.png"), array)
    click.echo(f"{output}" + (f" ({made.note})" if made.note else ""), err=True)


def _check_output(path: Path) -> None:
    from nrbench.errors import BadInput

    if path.suffix.lower() != ".png":
        raise BadInput(f"{path}: outputs are PNG; end the name in .png")
    if not path.absolute().parent.is_dir():
        raise BadInput(f"{path}: its directory does not exist; make it first")


@click.command("lattice")
@click.argument("image", type=click.Path(path_type=Path))
@click.option("-d", "--detector", default="gncc", show_default=True, metavar="DETECTOR[:param=value,...]")
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="OVERLAY.png", help="Draw it over the image.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON on standard output.")
def lattice_command(image: Path, detector: str, output: Path | None, as_json: bool) -> None:
    """Find the lattice of IMAGE; that there is none is an answer too."""
    from nrbench.api import detect_lattice
    from nrbench.imaging.files import read_image
    from nrbench.lattice.detection import NoLatticeFound
    from nrbench.parameters import parse_spec

    if output is not None:
        _check_output(output)
    name, parameters = parse_spec(detector)
    picture = read_image(image)
    try:
        found = detect_lattice(picture, name, **parameters)
    except NoLatticeFound as none:
        print(json.dumps({"lattice": None, "reason": none.reason}) if as_json else f"no lattice: {none.reason}")
        return
    t1, t2 = found.lattice.t1, found.lattice.t2
    answer: dict[str, Any] = {"t1": list(t1), "t2": list(t2), "detector": name, "confidence": found.confidence}
    if output is not None:
        from nrbench.imaging.files import write_image
        from nrbench.lattice.overlay import overlay

        write_image(output, overlay(picture, found.lattice))
    text = f"t1 = ({t1[0]:.3f}, {t1[1]:.3f}) px, t2 = ({t2[0]:.3f}, {t2[1]:.3f}) px"
    print(json.dumps(answer) if as_json else f"{text}, {name}, confidence {found.confidence:.3f}")


@click.command("score")
@click.argument("sample", type=click.Path(path_type=Path))
@click.argument("output", type=click.Path(path_type=Path))
@click.option("--lattice", metavar="x1,y1,x2,y2", help="The lattice of SAMPLE.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON on standard output.")
def score_command(sample: Path, output: Path, lattice: str | None, as_json: bool) -> None:
    """Score any tool's OUTPUT against its SAMPLE."""
    from nrbench.api import score
    from nrbench.imaging.files import read_image

    sheet = score(read_image(sample), read_image(output), lattice)
    if as_json:
        print(json.dumps({**sheet.values, "reasons": dict(sheet.reasons)}, indent=1))
        return
    for name, value in sheet.values.items():
        shown = (
            f"- ({sheet.reasons[name]})" if value is None else f"{value:.4g}" if not isinstance(value, bool) else value
        )
        print(f"{name:<36} {shown}")
