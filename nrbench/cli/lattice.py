"""The command lattice, which detects, compares and draws the lattices of a picture or of a folder of pictures."""

from __future__ import annotations

import os
from pathlib import Path

import click
from click.core import ParameterSource

from nrbench.cli.options import check_output
from nrbench.errors import BadInput


@click.command("lattice")
@click.argument("image", type=click.Path(path_type=Path), metavar="IMAGE|FOLDER")
@click.option("-d", "--detector", metavar="DETECTOR[:param=value,...]", help="The detector.  [default: consensus]")
@click.option("--all", "every", is_flag=True, help="Compare all detectors.")
@click.option("--pick", is_flag=True, help="Pick a lattice in the browser by three clicks.")
@click.option("--lattice", metavar="x1,y1,x2,y2[,x,y]", help="Use this lattice; -o draws it.")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="OVERLAY.png|DIR",
    help="Draw the lattice over the image. For a folder: the directory of truth.csv.  [default: FOLDER]",
)
@click.option(
    "--diagnostics",
    type=click.Path(path_type=Path),
    metavar="OUT.png",
    help="Draw how the detector found the lattice.",
)
@click.option(
    "--least",
    type=click.FloatRange(0, 1),
    default=0.5,
    show_default=True,
    metavar="CONFIDENCE",
    help="For a folder: lattices of a lower confidence are listed as candidates only.",
)
@click.option("--keep", is_flag=True, help="For a folder: keep the lines of truth.csv, and add the missing pictures.")
@click.option("--force", is_flag=True, help="For a folder: replace truth.csv.")
@click.option(
    "--straighten",
    type=click.Path(path_type=Path),
    metavar="OUT.png",
    help="Follow the lattice through a bent image, and write the image with its deformation undone.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON on standard output.")
def lattice_command(
    image: Path,
    detector: str | None,
    every: bool,
    pick: bool,
    lattice: str | None,
    output: Path | None,
    diagnostics: Path | None,
    least: float,
    keep: bool,
    force: bool,
    straighten: Path | None,
    as_json: bool,
) -> int:
    """Detect the lattice of IMAGE, or those of all pictures in FOLDER.

    "No lattice" is a valid result: the exit code is 0. For a folder, the command writes truth.csv, which `nrbench run
    FOLDER` reads, and contact sheets by which you can check it.
    """
    from nrbench.cli import lattice_detection
    from nrbench.pictures.files import read_image

    context = click.get_current_context()
    sources = ((option.opts[0], context.get_parameter_source(str(option.name))) for option in context.command.params)
    given = [name for name, source in sources if source is ParameterSource.COMMANDLINE]
    chosen = [name for name in given if name in ("-d", "--all", "--pick", "--lattice")]
    if len(chosen) > 1:
        raise BadInput(f"{' and '.join(chosen)}: choose one of them")
    if image.is_dir():
        wrong = [name for name in given if name in ("--all", "--pick", "--lattice", "--diagnostics", "--straighten")]
        if wrong:
            raise BadInput(f"{wrong[0]}: needs one picture, and {image} is a folder; pass a picture in it")
        if keep and force:
            raise BadInput("--keep and --force: choose one of them")
        existing = "keep" if keep else "replace" if force else "refuse"
        return lattice_detection.survey_folder(image, detector or "consensus", output, least, existing, as_json)
    of_folders = [name for name in given if name in ("--least", "--keep", "--force")]
    if of_folders and image.is_file():
        raise BadInput(f"{of_folders[0]}: is for a folder of pictures, and {image} is none; leave it out")
    if diagnostics and chosen not in ([], ["-d"]):
        raise BadInput(f"--diagnostics: draws how one detector works; leave {chosen[0]} out")
    if straighten and (every or pick or diagnostics):
        raise BadInput("--straighten: follows one lattice; leave --all, --pick and --diagnostics out")
    written = {os.path.realpath(image): "is the picture itself, which would be lost; choose another name"}
    for path in filter(None, (output, diagnostics, straighten)):
        check_output(path)
        if os.path.realpath(path) in written:
            raise BadInput(f"{path}: {written[os.path.realpath(path)]}")
        written[os.path.realpath(path)] = "would be written twice; choose another name for one of the pictures"
    picture = read_image(image)
    if every:
        return lattice_detection.print_comparison(picture, output, as_json)
    if straighten:
        lattice_detection.straighten_picture(picture, detector or "consensus", lattice, output, straighten, as_json)
    elif pick or lattice is not None:
        lattice_detection.print_given(picture, lattice, output, as_json)
    else:
        lattice_detection.print_detection(picture, detector, output, diagnostics, as_json)
    return 0
