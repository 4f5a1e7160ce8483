"""Verbs that make and judge one picture: synth, score."""

from __future__ import annotations

import json
from pathlib import Path

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
    from nrbench.cli.outputs import check_output
    from nrbench.imaging.files import read_image, write_image
    from nrbench.plugins.parameters import parse_spec
    from nrbench.running.outputs import is_picture
    from nrbench.suites.suite import parse_size

    name, parameters = parse_spec(method)
    check_output(output)
    plugins.build("synthesizers", name, parameters)
    made = synthesize(name, read_image(image), parse_size(size), lattice, seed, **parameters)
    write_image(output, made.image)
    for title, array in made.extras.items():
        if is_picture(array):
            write_image(output.with_name(f"{output.stem}-{title}.png"), array)
    click.echo(f"{output}" + (f" ({made.note})" if made.note else ""), err=True)


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
