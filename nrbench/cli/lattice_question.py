"""Options of the command ``lattice``, and which of them exclude each other."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from nrbench import plugins
from nrbench.api.arguments import Masklike
from nrbench.cli.verbs import check_output, choose_one
from nrbench.errors import BadInput
from nrbench.flags import ARGUMENT, Flag, Json, Switch

PictureOrFolder = Annotated[Path, Flag(ARGUMENT, "IMAGE|FOLDER", kind=Path)]
DetectorText = Annotated[str | None, Flag("-d --detector", "DETECTOR[:param=value,...]")]
All = Annotated[bool, Flag("--all", kind=bool)]
LatticeText = Annotated[str | None, Flag(metavar="x1,y1,x2,y2[,x,y]")]
OverlayOrFolder = Annotated[Path | None, Flag("-o --output", "OVERLAY.png|DIR", kind=Path)]
OutputPicture = Annotated[Path | None, Flag(metavar="OUT.png", kind=Path)]
OutputTable = Annotated[Path | None, Flag(metavar="OUT.csv", kind=Path)]
Confidence = Annotated[float, Flag(metavar="CONFIDENCE", kind=float, least=0, most=1)]
LEAST = 0.5


@dataclass(frozen=True)
class LatticeQuestion:
    """What to find out about the lattice of a picture, or about those of a folder of pictures.

    Parameters
    ----------
    image
        The picture or the folder.
    detector
        The detector.  [default: consensus]
    every
        Compare all detectors.
    pick
        Pick a lattice in the browser by three clicks.
    lattice
        Use this lattice; -o draws it.
    mask
        For one picture: a picture of its size, in which white counts, and black is left out.
    output
        Draw the lattice over the image. For a folder: the directory of truth.csv.  [default: FOLDER]
    diagnostics
        Draw how the detector found the lattice.
    least
        For a folder: lattices of a lower confidence are listed as candidates only.
    keep
        For a folder: keep the lines of truth.csv, and add the missing pictures.
    force
        Replace truth.csv of a folder, or the file of --vertices.
    straighten
        Follow the lattice through a bent image, and write the image with its deformation undone.
    defects
        List where the picture leaves its own lattice and look, or "none", and draw these places.
    symmetry
        Print the wallpaper group and the symmetries; -o draws them.
    vertices
        Write where the points of the lattice lie: row,column,x,y.
    as_json
        Print JSON on standard output.
    """

    image: PictureOrFolder
    detector: DetectorText = None
    every: All = False
    pick: Switch = False
    lattice: LatticeText = None
    mask: Masklike = None
    output: OverlayOrFolder = None
    diagnostics: OutputPicture = None
    least: Confidence = LEAST
    keep: Switch = False
    force: Switch = False
    straighten: OutputPicture = None
    defects: OutputPicture = None
    symmetry: Switch = False
    vertices: OutputTable = None
    as_json: Json = False

    @property
    def spec(self) -> str:
        """The detector, with its parameters."""
        return self.detector or plugins.in_role("detector")

    def check(self) -> None:
        """Raise :class:`~nrbench.errors.BadInput` for options that exclude each other, or do not fit the image."""
        choose_one({"-d": self.detector, "--all": self.every, "--pick": self.pick, "--lattice": self.lattice})
        self._check_folder() if self.image.is_dir() else self._check_picture()

    def _check_folder(self) -> None:
        given: dict[str, object] = {"--all": self.every, "--pick": self.pick, "--lattice": self.lattice}
        given |= {"--diagnostics": self.diagnostics, "--straighten": self.straighten, "--vertices": self.vertices}
        given |= {"--symmetry": self.symmetry, "--defects": self.defects, "--mask": self.mask}
        for name in filter(given.get, given):
            raise BadInput(f"{name}: needs one picture, and {self.image} is a folder; pass a picture in it")
        choose_one({"--keep": self.keep, "--force": self.force})
        if self.output is not None and (self.output.suffix.lower() == ".png" or self.output.is_file()):
            raise BadInput(f"-o {self.output}: {self.image} is a folder of pictures; give a directory for truth.csv")

    def _check_picture(self) -> None:
        of_folders = {"--least": self.least != LEAST, "--keep": self.keep, "--force": self.force and not self.vertices}
        for name in filter(of_folders.get, of_folders) if self.image.is_file() else ():
            raise BadInput(f"{name}: is for a folder of pictures, and {self.image} is none; leave it out")
        others: dict[str, object] = {"--all": self.every, "--pick": self.pick, "--lattice": self.lattice}
        for name in filter(others.get, others) if self.diagnostics else ():
            raise BadInput(f"--diagnostics: draws how one detector works; leave {name} out")
        if self.symmetry and (self.every or self.straighten):
            raise BadInput("--symmetry: needs one lattice of the picture as it is; leave --all and --straighten out")
        if self.vertices and self.every:
            raise BadInput("--vertices: writes those of one lattice; leave --all out")
        if self.straighten and (self.every or self.pick or self.diagnostics):
            raise BadInput("--straighten: follows one lattice; leave --all, --pick and --diagnostics out")
        alone = self.every or self.pick or self.diagnostics or self.straighten or self.symmetry or self.output
        if self.defects and (alone or self.vertices):
            raise BadInput("--defects: is an answer of its own; only -d, --lattice and --json go with it")
        from nrbench.pictures.files import WRITTEN

        written = {os.path.realpath(self.image): "is the picture itself, which would be lost; choose another name"}
        for path in filter(None, (self.output, self.diagnostics, self.straighten, self.vertices, self.defects)):
            check_output(path, *((".csv",) if path is self.vertices else WRITTEN))
            if os.path.realpath(path) in written:
                raise BadInput(f"{path}: {written[os.path.realpath(path)]}")
            if path is self.vertices and path.exists() and not self.force:
                raise BadInput(f"{path}: exists, and may hold your corrections; pass --force to replace it")
            written[os.path.realpath(path)] = "would be written twice; choose another name for one of the files"
