"""The commands synth, score and render, which write or score images."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

from nrbench.cli.options import check_output, split_names
from nrbench.cli.progress import live_progress, waiting
from nrbench.errors import BadInput

# The help of a command imports no more than this.
if TYPE_CHECKING:
    from nrbench.api.textures import Scores
    from nrbench.imaging.convert import Image
    from nrbench.lattice.geometry import Lattice

_PATH = click.Path(path_type=Path)


@click.command("synth")
@click.argument("image", type=_PATH)
@click.option("-m", "method", required=True, metavar="METHOD[:param=value,...]", help="The method.")
@click.option("--size", required=True, metavar="WxH", help="Size of the output.")
@click.option(
    "--lattice",
    metavar="x1,y1,x2,y2[,x,y]|DETECTOR",
    help="The lattice of IMAGE, or the detector that finds it.  [default: the method finds it]",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Equal seeds give equal outputs.")
@click.option("-o", "--output", required=True, type=_PATH, metavar="OUT.png", help="The output.")
@click.option("--tileable", is_flag=True, help="Make an output that repeats without a seam, if the method can.")
@click.option("--extras", is_flag=True, help="Also write the pictures that the method returns beside the output.")
def synth_command(
    image: Path,
    method: str,
    size: str,
    lattice: str | None,
    seed: int,
    output: Path,
    tileable: bool,
    extras: bool,
) -> None:
    """Synthesize a texture of any size from IMAGE.

    With --tileable, methods that can wrap synthesize around the edges of the output. The sample is strained, by at most
    2.5 %, so that the lattice closes; the strain is printed, and a size nearby if that needs less than half of it. If
    the strain would be larger, the command stops, and the message names the nearest size that closes.

    Some methods return pictures beside the output: a tile, a mask, the elements. --extras writes them as OUT-NAME.png;
    without it, their names are printed.
    """
    from nrbench import plugins
    from nrbench.api.textures import synthesize
    from nrbench.pictures.files import read_image, write_image
    from nrbench.plugins.parameters import parse_size, parse_spec
    from nrbench.running.output_checks import is_picture

    name, parameters = parse_spec(method)
    check_output(output)
    if os.path.realpath(output) == os.path.realpath(image):
        raise BadInput(f"-o {output}: is the picture itself, which would be lost; choose another name")
    finder = getattr(plugins.build("synthesizers", name, parameters), "finder", "")
    shape, sample = parse_size(size), read_image(image)
    given = _given_lattice(sample, lattice)
    with waiting(f"{name}, {size}") as progress:
        synthesis = synthesize(name, sample, shape, given, seed, progress, tileable, **parameters)
    write_image(output, synthesis.image)
    click.echo(f"{output}" + (f" ({synthesis.note})" if synthesis.note else ""), err=True)
    pictures = {title: array for title, array in synthesis.extras.items() if is_picture(array)}
    if pictures and not extras:
        click.echo(f"not written: {', '.join(pictures)}; --extras writes them", err=True)
    for title, array in pictures.items() if extras else ():
        click.echo(f"{write_image(output.with_name(f'{output.stem}-{title}.png'), array)} ({title})", err=True)
    if given is None and synthesis.lattice is not None and finder != "consensus":
        _warn_of_another_lattice(sample, name, synthesis.lattice)


def _given_lattice(sample: Image, text: str | None) -> Lattice | None:
    """Return the lattice of the option ``--lattice``: its numbers, or what a detector finds, which is printed.

    Raises
    ------
    BadInput
        If the text is neither, or the detector finds no lattice.
    """
    from nrbench.api.arguments import as_lattice, lattice_in
    from nrbench.plugins.forms import NoLatticeFound

    if text is None or "," in text.partition(":")[0]:
        return as_lattice(text)
    try:
        with waiting(f"{text} looks for the lattice"):
            found = lattice_in(sample, text)
    except NoLatticeFound as none:
        raise BadInput(f"--lattice {text}: no lattice found ({none.reason}); give one as x1,y1,x2,y2") from None
    assert found is not None
    click.echo(f"--lattice {','.join(f'{x:.6g}' for x in found.numbers)}  ({text.partition(':')[0]})", err=True)
    return found


def _warn_of_another_lattice(sample: Image, method: str, used: Lattice) -> None:
    """Warn if a method found another lattice by itself than the detector ``consensus`` finds."""
    from nrbench.api.textures import detect_lattice
    from nrbench.lattice.relation import relate
    from nrbench.plugins.forms import NoLatticeFound

    try:
        with waiting("consensus checks the lattice"):
            found = detect_lattice(sample).lattice
    except NoLatticeFound:
        return
    change = relate(used, found)
    if change is not None and change.divisor == 1:
        return  # the same lattice, or a supercell of it, which repeats the texture as well
    texts = [",".join(f"{x:.5g}" for x in (*each.t1, *each.t2)) for each in (used, found)]
    click.echo(
        f"nrbench: warning: {method} repeats the lattice {texts[0]}, the detector consensus finds {texts[1]}; if the "
        "output looks wrong, use --lattice consensus",
        err=True,
    )


_PARTS = ("score", "regularity", "integrity", "randomness", "appearance")
HEADLINES = ("regularity.preserved", *(f"quality.{part}" for part in _PARTS))
"""The scores that `score` prints by default, and by whose metrics the lattice is judged."""


@click.command("score")
@click.argument("sample", type=_PATH)
@click.argument("output", type=_PATH)
@click.option(
    "--lattice",
    metavar="x1,y1,x2,y2[,x,y]|DETECTOR",
    help="The lattice of SAMPLE, or the detector that finds it.  [default: scores that need one use the detector "
    "dominance]",
)
@click.option("--metrics", metavar="NAME,...", help="Compute these metrics, and print all their scores.")
@click.option("--all", "every", is_flag=True, help="Compute all metrics.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON on standard output; of all metrics by default.")
def score_command(
    sample: Path, output: Path, lattice: str | None, metrics: str | None, every: bool, as_json: bool
) -> None:
    """Score any tool's OUTPUT against its SAMPLE.

    Print whether the lattice is preserved, the quality, and its four parts: regularity, integrity, randomness and
    appearance. "≤" marks a quality that is an upper bound, because a part could not be measured. --all prints all
    scores.
    """
    from nrbench.api.textures import score
    from nrbench.pictures.files import read_image

    if metrics and every:
        raise BadInput("--metrics and --all: choose one of them")
    pictures = read_image(sample), read_image(output)
    given = _given_lattice(pictures[0], lattice)
    brief = not (metrics or every or as_json)
    names = list(dict.fromkeys(name.partition(".")[0] for name in HEADLINES)) if brief else split_names(metrics)
    with live_progress(patience=True) as progress:
        scores = score(*pictures, given, names, progress)
    if as_json:
        print(json.dumps({**scores.values, "reasons": dict(scores.reasons)}, indent=1))
        return
    first = [name for name in HEADLINES if name in scores.values]
    print(_verdict_line(scores))
    for name in first if brief else dict.fromkeys([*first, *scores.values]):
        print(_score_line(scores, name))
    for reason, missing in _group_reasons(scores, first if brief else list(scores.values)).items():
        print(f"{', '.join(missing)}: {reason}")
    if brief:
        print(f"{len(scores.values) - len(first)} more scores of these metrics, and the other metrics: --all")


def _verdict_line(scores: Scores) -> str:
    """Return the verdict on the lattice in one line; empty if it was not asked for."""
    name = HEADLINES[0]
    if name not in scores.values:
        return "the lattice was not judged; add regularity to --metrics"
    if scores.values[name] is None:
        return f"the lattice is not judged: {scores.reasons[name]}"
    return f"the lattice is {'preserved' if scores.values[name] else 'LOST'}"


def _score_line(scores: Scores, name: str) -> str:
    value = scores.values[name]
    text = "-" if value is None else str(value) if isinstance(value, bool) else f"{value:.4g}"
    bound = "≤ " if name == "quality.score" and scores.values.get("quality.complete") is False else ""
    return f"{name:<36} {bound}{text}"


def _group_reasons(scores: Scores, names: list[str]) -> dict[str, list[str]]:
    """Return the scores without a value by the reason."""
    grouped: dict[str, list[str]] = {}
    for name in names:
        if scores.values[name] is None:
            grouped.setdefault(scores.reasons[name], []).append(name)
    return grouped


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
    from nrbench.api.textures import render_textures

    for path in render_textures(what, output, textures, sample=sample, seed=seed, replicates=replicates):
        click.echo(path)
