"""The commands of single pictures: synth, lattice, score and render."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from nrbench.api import textures
from nrbench.api.arguments import METHOD, as_lattice, lattice_in, names_of
from nrbench.cli.lattice_question import All, LatticeQuestion
from nrbench.cli.progress import live_progress, waiting
from nrbench.cli.verbs import check_output, choose_one, verb
from nrbench.errors import BadInput, require
from nrbench.flags import Flag, Json, Switch
from nrbench.storage import make_writable, write_text

# The help of a command imports no more than this.
if TYPE_CHECKING:
    from nrbench.api.textures import Scores
    from nrbench.imaging.convert import Image
    from nrbench.imaging.masks import MaskedImage
    from nrbench.lattice.geometry import Lattice
    from nrbench.plugins.forms import Synthesis

OutputPicture = Annotated[Path, Flag("-o --output", "OUT.png|.tif|.webp|DIR", kind=Path)]
SeamPicture = Annotated[Path | None, Flag("-o", "SEAM.png", kind=Path)]
SomeMethod = Annotated[str | None, Flag("-m", METHOD)]
SomeSize = Annotated[str | None, Flag("--size", "WxH")]
Holes = Annotated[Path | None, Flag("--fill", "MASK", kind=Path)]


@verb(textures.synthesize)
def synth_command(
    call: Callable[..., Any],
    image: Path,
    lattice: str | None,
    seed: int,
    mask: Path | None,
    maps: tuple[Path, ...],
    keep_alpha: bool,
    tileable: str | None,
    flatten_light: bool,
    output: OutputPicture,
    method: SomeMethod = None,
    shape: SomeSize = None,
    fill: Holes = None,
    extras: Switch = False,
) -> None:
    """Synthesize a texture of any size from IMAGE.

    With --fill, only the holes of IMAGE are synthesized, on its own lattice. All other pixels stay as they are.

    With --tileable, methods that can wrap synthesize around the edges of the output. The sample is strained, by at most
    2.5 %, so that the lattice closes; the strain is printed, and a size nearby if that needs less than half of it. If
    the strain would be larger, the command stops, and the message names the nearest size that closes.

    Some methods return pictures beside the output: a tile, a mask, the elements. --extras writes them as OUT-NAME.png;
    without it, their names are printed. Files that describe them are written too, as OUT-NAME.

    A material has several maps: give the one of colors as IMAGE, and each other one with --with, which may be repeated.
    All get one layout, and are written into the folder of -o under their own names. Values of maps are not converted;
    16 bits, gray, floats and profiles stay. The vectors of a normal map get length 1 where they are interpolated.

    Parameters
    ----------
    output
        The output, with the 8 or 16 bits a channel of IMAGE; WebP has 8. With --with, a folder.
    method
        The method.  [required; with --fill: rsgf]
    shape
        Size of the output.  [required; with --fill: that of IMAGE]
    fill
        A picture of the size of IMAGE in which white is kept and black is filled; transparent pixels are filled as
        well. IMAGE itself, if it has holes that are transparent.
    extras
        Also write the pictures that the method returns beside the output.
    """
    from nrbench import plugins
    from nrbench.api.arguments import layers_in, masked_in, plugin_in
    from nrbench.calling.sample_maps import flatten_alpha
    from nrbench.imaging.convert import depth_of, to_integers
    from nrbench.imaging.masks import MaskedImage
    from nrbench.pictures.files import WRITTEN, read_map, write_map
    from nrbench.plugins.parameters import parse_size

    unused: dict[str, object] = {"--size": shape, "--mask": mask, "--tileable": tileable, "--with": maps}
    unused |= {"--keep-alpha": keep_alpha, "--flatten-light": flatten_light, "--extras": extras}
    for name, value in unused.items() if fill is not None else ():
        require(not value, f"{name}: has no effect with --fill, which returns a picture of the size of IMAGE")
    read = [read_map(path) for path in maps]
    if maps:
        output, *others = _name_outputs(output, [image, *maps], [False, *(each.dtype.kind == "f" for each, _ in read)])
    check_output(output, *WRITTEN)
    for path in filter(None, (image, mask, fill)):
        if os.path.realpath(output) == os.path.realpath(path):
            raise BadInput(f"-o {output}: is {path} itself, which would be lost; choose another name")
    if fill is not None:
        _fill(image, fill, method, lattice, seed, output)
        return
    if method is None or shape is None:
        raise click.UsageError(f"Missing option '{'-m' if method is None else '--size'}'.")
    finder = getattr(plugin_in("synthesizers", method, {}), "finder", "")
    size = parse_size(shape)
    require(max(size) < 1 << 14 or output.suffix.lower() != ".webp", f"-o {output}: WebP has at most 16383 px; use PNG")
    sample = MaskedImage(flatten_alpha(layers_in(image))[0]) if keep_alpha else masked_in(image, mask)
    _check_sizes(sample.image.shape, {path: values.shape for path, (values, _) in zip(maps, read, strict=True)})
    given = _given_lattice(sample, lattice)
    masked = {} if keep_alpha else {"image": sample, "mask": None}
    with waiting(f"{method.partition(':')[0]}, {shape}") as progress:
        synthesis = call(shape=size, lattice=given, maps=[each for each, _ in read], progress=progress, **masked)
    write_map(output, to_integers(synthesis.image, depth_of(synthesis.image)))
    click.echo(f"{output}" + (f" ({synthesis.note})" if synthesis.note else ""), err=True)
    for path, values, (_, profile) in zip(others if maps else (), synthesis.maps, read, strict=True):
        click.echo(f"{write_map(path, values, profile)}", err=True)
    _write_extras(synthesis, output, extras)
    if given is None and synthesis.lattice is not None and finder != plugins.in_role("detector"):
        _warn_of_another_lattice(sample, method.partition(":")[0], synthesis.lattice)


def _write_extras(synthesis: Synthesis, output: Path, extras: bool) -> None:
    """Write the pictures and texts that a method returned beside the output, or print their names."""
    from nrbench.calling.method_calls import is_picture
    from nrbench.imaging.convert import depth_of, quantize
    from nrbench.pictures.files import write_image

    pictures = {title: array for title, array in synthesis.extras.items() if is_picture(array)}
    if pictures and not extras:
        click.echo(f"not written: {', '.join([*pictures, *synthesis.files])}; --extras writes them", err=True)
    for title, array in pictures.items() if extras else ():
        picture = quantize(array, depth_of(synthesis.image))
        click.echo(f"{write_image(output.with_name(f'{output.stem}-{title}.png'), picture)} ({title})", err=True)
    for name, describe in synthesis.files.items() if extras else ():
        write_text(output.with_name(f"{output.stem}-{name}"), describe(f"{output.stem}-"))
        click.echo(f"{output.with_name(f'{output.stem}-{name}')} ({name})", err=True)


def _name_outputs(folder: Path, pictures: Sequence[Path], floats: Sequence[bool]) -> list[Path]:
    """Return the files in a folder, which is made, to which the maps are written, by the names of the pictures.

    Raises
    ------
    BadInput
        If two maps would have one name, or a picture would be replaced.
    """
    from nrbench.pictures.files import WRITTEN

    named = []
    for path, floating in zip(pictures, floats, strict=True):
        endings = WRITTEN[1:3] if floating else WRITTEN
        named.append(folder / (path.name if path.suffix.lower() in endings else f"{path.stem}{endings[0]}"))
    pairs = list(zip(pictures, named, strict=True))
    for picture, path in pairs:
        same = [str(other) for other, name in pairs if name.name.lower() == path.name.lower()]
        require(len(same) == 1, f"{' and '.join(same)}: would both be written to {path}; rename one of them")
        lost = os.path.realpath(path) in map(os.path.realpath, pictures)
        require(not lost, f"-o {folder}: {picture} would be replaced; choose another folder")
    require(folder.is_dir() or not folder.exists(), f"-o {folder}: is a file; with --with, give a folder")
    make_writable(folder.absolute(), "choose another directory")
    return named


def _check_sizes(shape: tuple[int, ...], maps: Mapping[Path, tuple[int, ...]]) -> None:
    """Raise :class:`~nrbench.errors.BadInput` for a map of another size than its picture."""
    for path, found in maps.items():
        sizes = ["x".join(map(str, each[1::-1])) for each in (found, shape)]
        require(sizes[0] == sizes[1], f"--with {path}: is {sizes[0]} px, IMAGE {sizes[1]}; all maps need one size")


def _fill(image: Path, mask: Path, method: str | None, lattice: str | None, seed: int, output: Path) -> None:
    """Write a picture with its holes filled."""
    from nrbench.api.arguments import masked_in
    from nrbench.pictures.files import write_image

    sample = masked_in(image, None if os.path.realpath(mask) == os.path.realpath(image) else mask)
    given = _given_lattice(sample, lattice)
    with waiting("holes are filled") as progress:
        filled = textures.fill(sample, None, method, given, seed, progress)
    write_image(output, filled.image)
    click.echo(f"{output} ({filled.note})", err=True)


def _given_lattice(sample: Image | MaskedImage, text: str | None) -> Lattice | None:
    """Return the lattice of the option ``--lattice``: its numbers, or what a detector finds, which is printed.

    Raises
    ------
    BadInput
        If the text is neither, or the detector finds no lattice.
    """
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


def _warn_of_another_lattice(sample: MaskedImage, method: str, used: Lattice) -> None:
    """Warn if a method found another lattice by itself than the detector ``consensus`` finds."""
    from nrbench import plugins
    from nrbench.lattice.relation import relate
    from nrbench.plugins.forms import NoLatticeFound

    try:
        with waiting("consensus checks the lattice"):
            found = textures.detect_lattice(sample, plugins.in_role("detector")).lattice
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


_PERILS = tuple(f"quality.{peril}" for peril in ("regularity", "integrity", "randomness", "appearance"))
HEADLINES = ("regularity.preserved", "quality.score", *_PERILS)
"""The scores that `score` prints by default, and by whose metrics the lattice is judged."""


@verb(textures.score)
def score_command(
    call: Callable[..., Scores],
    sample: Path,
    output: Path | None,
    lattice: str | None,
    mask: Path | None,
    metrics: str | None,
    tileable: bool,
    every: All = False,
    seam: SeamPicture = None,
    as_json: Json = False,
) -> None:
    """Score any tool's OUTPUT against its SAMPLE, or with --tileable whether one picture repeats.

    Print whether the lattice is preserved, the quality, and its four parts: regularity, integrity, randomness and
    appearance. "≤" marks a quality that is an upper bound, because a fault of one part may be there and "cannot tell"
    stands in its place. "no peril" means that a fault of this part could not be seen in this texture. --all prints all
    scores.

    Parameters
    ----------
    every
        Compute all metrics.
    seam
        Of --tileable: the picture rolled by half, with the seams drawn where they break.
    as_json
        Print JSON on standard output; of all metrics by default.
    """
    from nrbench.api.arguments import masked_in
    from nrbench.pictures.files import read_image

    if tileable:
        others = [output, metrics, every, mask]
        require(not any(others), "--tileable: judges one whole picture; pass no OUTPUT, --mask, --metrics or --all")
        return _show_edges(call, sample, lattice, seam, as_json)
    if output is None or seam:
        raise BadInput("score: pass SAMPLE and OUTPUT, without -o; or --tileable and one picture")
    choose_one({"--metrics": metrics, "--all": every})
    pictures = masked_in(sample, mask), read_image(output)
    given = _given_lattice(pictures[0], lattice)
    brief = not (metrics or every or as_json)
    names = list(dict.fromkeys(name.partition(".")[0] for name in HEADLINES)) if brief else names_of(metrics or "")
    with live_progress(patience=True) as progress:
        scores = call(
            sample=pictures[0], output=pictures[1], lattice=given, mask=None, metrics=names, progress=progress
        )
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


def _show_edges(
    call: Callable[..., Scores], picture: Path, lattice: str | None, seam: Path | None, as_json: bool
) -> None:
    """Print whether a picture repeats along each axis, and draw the seams."""
    from nrbench.imaging.wrapped_edges import FLOORS
    from nrbench.pictures.files import WRITTEN, read_image, write_image

    if seam is not None:
        check_output(seam, *WRITTEN)
        require(os.path.realpath(seam) != os.path.realpath(picture), f"-o {seam}: is the picture itself")
    image = read_image(picture)
    given = _given_lattice(image, lattice)
    with waiting("the edges are compared"):
        scores = call(sample=image, lattice=given)
    if seam is not None:
        write_image(seam, scores.pictures["tileable.seam"])
    if as_json:
        print(json.dumps({**scores.values, "reasons": dict(scores.reasons)}, indent=1))
        return
    for axis, along, edge in (("x", "y", "right"), ("y", "x", "lower")):
        own = {name: scores.values[f"tileable.{axis}.{name}"] for name in ("repeats", "score", "worst", *FLOORS)}
        if own["score"] is None:
            print(f"{axis}: {scores.reasons[f'tileable.{axis}.score']}")
            continue
        state = "repeats" if own["repeats"] else f"breaks at the {edge} edge, most at {along} = {own['worst']}"
        ratios = ", ".join(f"{name} {own[name]:.2f}" for name in FLOORS if own[name] is not None)
        print(f"{axis}: {state}, score {own['score']:.2f} (departures over what is allowed: {ratios})")
    silent = {scores.reasons[name] for name in scores.reasons if name.endswith("lattice")}
    alone = f"gradients and colors alone: {'; '.join(silent)}"
    print(f"judged by {alone if silent else 'lattice, gradients and colors'}")


def _verdict_line(scores: Scores) -> str:
    """Return the verdict on the lattice in one line; empty if it was not asked for."""
    name = HEADLINES[0]
    if name not in scores.values:
        return "the lattice was not judged; add regularity to --metrics"
    if scores.values[name] is None:
        return f"the lattice is not judged: {scores.reasons[name]}"
    return f"the lattice is {'preserved' if scores.values[name] else 'LOST'}"


def _score_line(scores: Scores, name: str) -> str:
    from nrbench.plugins.forms import describe_silence

    value = scores.values[name]
    if value is None:
        silent = name in _PERILS and scores.values.get("quality.score") is not None
        text = describe_silence(scores.reasons[name]) if silent else "-"
    else:
        text = str(value) if isinstance(value, bool) else f"{value:.4g}"
    bound = "≤ " if name == "quality.score" and scores.values.get("quality.complete") is False else ""
    return f"{name:<36} {bound}{text}"


def _group_reasons(scores: Scores, names: list[str]) -> dict[str, list[str]]:
    """Return the scores without a value by the reason."""
    grouped: dict[str, list[str]] = {}
    for name in names:
        if scores.values[name] is None:
            grouped.setdefault(scores.reasons[name], []).append(name)
    return grouped


@verb(textures.render_textures)
def render_command(call: Callable[..., list[Path]]) -> None:
    """Draw the textures of a model or a suite as PNG files.

    The command also writes truth.csv, truth.json and a contact sheet to DIR. It keeps pictures of an earlier render,
    and draws a picture of the same name again.
    """
    print(*call(), sep="\n")


@verb(LatticeQuestion)
def lattice_command(call: Callable[[], LatticeQuestion]) -> int:
    """Detect the lattice of IMAGE, or those of all pictures in FOLDER.

    "No lattice" is a valid result: the exit code is 0. For a folder, the command writes truth.csv, which `nrbench run
    FOLDER` reads, and contact sheets by which you can check it.
    """
    options = call()
    options.check()
    from nrbench.cli.lattice_detection import answer_question

    return answer_question(options)
