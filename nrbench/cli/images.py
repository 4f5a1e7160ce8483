"""The commands synth, score and render, which write or score images."""

from __future__ import annotations

import json
from pathlib import Path

import click

_PATH = click.Path(path_type=Path)


def check_output(path: Path) -> None:
    """Raise :class:`~nrbench.errors.BadInput` unless a picture can be written to ``path``."""
    from nrbench.errors import BadInput

    if path.suffix.lower() != ".png":
        raise BadInput(f"{path}: outputs are PNG; end the name in .png")
    if not path.absolute().parent.is_dir():
        raise BadInput(f"{path}: its directory does not exist; make it first")


@click.command("synth")
@click.argument("image", type=_PATH)
@click.option("-m", "method", required=True, metavar="METHOD[:param=value,...]", help="The method.")
@click.option("--size", required=True, metavar="WxH", help="Size of the output.")
@click.option("--lattice", metavar="x1,y1,x2,y2[,x,y]", help="The lattice of IMAGE.  [default: the method finds it]")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Equal seeds give equal outputs.")
@click.option("-o", "--output", required=True, type=_PATH, metavar="OUT.png", help="The output.")
def synth_command(image: Path, method: str, size: str, lattice: str | None, seed: int, output: Path) -> None:
    """Synthesize a texture of any size from IMAGE."""
    from nrbench import plugins
    from nrbench.api import synthesize
    from nrbench.imaging.files import read_image, write_image
    from nrbench.plugins.parameters import parse_size, parse_spec
    from nrbench.running.outputs import is_picture

    name, parameters = parse_spec(method)
    check_output(output)
    plugins.build("synthesizers", name, parameters)
    synthesis = synthesize(name, read_image(image), parse_size(size), lattice, seed, **parameters)
    write_image(output, synthesis.image)
    for title, array in synthesis.extras.items():
        if is_picture(array):
            write_image(output.with_name(f"{output.stem}-{title}.png"), array)
    click.echo(f"{output}" + (f" ({synthesis.note})" if synthesis.note else ""), err=True)


@click.command("score")
@click.argument("sample", type=_PATH)
@click.argument("output", type=_PATH)
@click.option(
    "--lattice",
    metavar="x1,y1,x2,y2[,x,y]",
    help="The lattice of SAMPLE.  [default: scores that need one use the detector dominance]",
)
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
        number = value if value is None or isinstance(value, bool) else f"{value:.4g}"
        print(f"{name:<36} {f'- ({sheet.reasons[name]})' if value is None else number}")


@click.command("render")
@click.argument("what", metavar="MODEL[:param=value,...]|SUITE")
@click.option("-o", "--output", required=True, type=_PATH, metavar="DIR", help="Directory of the pictures.")
@click.option("-t", "textures", multiple=True, metavar="GLOB", help="Draw only these textures of a suite; repeatable.")
@click.option("--sample", "--size", "sample", metavar="WxH", help="Size of the pictures.")
@click.option("--seed", type=click.IntRange(0), help="Seed.")
@click.option("--replicates", type=click.IntRange(1), help="Number of draws of each texture.")
def render_command(
    what: str, output: Path, textures: tuple[str, ...], sample: str | None, seed: int | None, replicates: int | None
) -> None:
    """Draw the textures of a model or a suite as PNG files.

    The command also writes truth.csv, truth.json and a contact sheet to DIR. It keeps pictures of an earlier render,
    and draws a picture of the same name again.
    """
    from nrbench.api import changed
    from nrbench.suites.plan import draw_samples
    from nrbench.suites.rendering import model_suite, write_textures
    from nrbench.suites.suite import builtin, load_suite

    suite = load_suite(what) if what in builtin() or Path(what).exists() else model_suite(what)
    suite = changed(suite, sample=sample, seed=seed, replicates=replicates)
    for path in write_textures(draw_samples(suite, textures), output):
        click.echo(path)
