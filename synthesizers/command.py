"""Any program as a synthesis method."""

from __future__ import annotations

import hashlib
import shlex
import shutil
import string
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from nrbench.errors import BadInput
from nrbench.imaging.convert import Image, match_channels
from nrbench.lattice.geometry import Lattice
from nrbench.pictures.files import read_image, write_image
from nrbench.plugins.forms import Synthesis, Task, require_lattice
from nrbench.plugins.parameters import user_path
from nrbench.plugins.registry import NamedDetector

LATTICE_FIELDS = ("lattice", "t1x", "t1y", "t2x", "t2y", "originx", "originy")
FIELDS = ("sample", "output", "width", "height", "seed", *LATTICE_FIELDS)
TAIL = 2000
"""Number of characters at the end of the program's messages that an error quotes."""


@dataclass(frozen=True)
class Command:
    """A program in any language that reads the sample from a PNG file and writes its output to another.

    The program runs without a shell, in an empty folder that is removed afterwards. The first word of the command is
    searched in PATH as a shell does; words that name files of the folder in which nrbench was started become
    absolute paths.

    Parameters
    ----------
    run
        The command line, e.g. ``"tool {sample} {output} --size {width}x{height} --seed {seed}"``. ``{sample}`` and
        ``{output}`` become paths of PNG files, with 16 bits a channel if the sample has them, ``{seed}`` a number below
        2^31 that is drawn from the task's random stream. A command that takes the lattice of the sample has
        ``{lattice}``, which becomes ``x1,y1,x2,y2`` px, or ``{t1x} {t1y} {t2x} {t2y}``; ``{originx} {originy}`` are the
        origin. With the lattice source ``own``, ``consensus`` detects the lattice, and a sample without one is refused.
    """

    run: str

    isolation: ClassVar[str] = "cell"
    """Each cell has a process of its own, because it starts programs of others."""
    version: ClassVar[str] = "1"

    @property
    def uses_lattice(self) -> bool:
        """Whether the command has a field of the lattice."""
        return bool(_fields(self.run) & set(LATTICE_FIELDS))

    @property
    def finder(self) -> str:
        """The detector that finds the lattice if none is given; empty if the command takes no lattice."""
        return "consensus" if self.uses_lattice else ""

    def __post_init__(self) -> None:
        unknown = _fields(self.run) - set(FIELDS)
        if unknown:
            raise BadInput(f"run has {{{min(unknown)}}}; known are {', '.join(f'{{{name}}}' for name in FIELDS)}")
        missing = {"sample", "output"} - _fields(self.run)
        if missing:
            raise BadInput(f"run {self.run!r} lacks {{{max(missing)}}}; put it where the program takes the file")

    def synthesize(self, task: Task) -> Synthesis:
        """Return the picture that the program wrote.

        Raises
        ------
        Refused
            When the command takes the lattice, none is given, and none is found.
        BadInput
            When there is no such program.
        RuntimeError
            When the program fails (with the end of its messages) or writes no picture.
        """
        lattice, seconds = None, 0.0
        if self.uses_lattice:
            lattice, seconds = require_lattice(task, NamedDetector(self.finder), "the command takes one")
        with tempfile.TemporaryDirectory(prefix="nrbench-") as folder:
            sample, output = Path(folder, "sample.png"), Path(folder, "output.png")
            write_image(sample, task.sample)
            words = self._words(task, sample, output, lattice)
            _execute(words, Path(folder, "work"))
            return Synthesis(_read(output, words[0], task.sample), lattice, detection_seconds=seconds)

    def fingerprint(self) -> str:
        """Return a hash of the program and of the files that the command names: a changed file makes another method."""
        digest = hashlib.blake2b(digest_size=8)
        for word in shlex.split(self.run):
            file = shutil.which(word) or word
            if Path(file).is_file():
                with open(file, "rb") as content:  # noqa: PTH123
                    digest.update(hashlib.file_digest(content, "blake2b").digest())
        return digest.hexdigest()

    def _words(self, task: Task, sample: Path, output: Path, lattice: Lattice | None) -> list[str]:
        height, width = task.shape
        values: dict[str, object] = {"sample": sample, "output": output, "width": width, "height": height}
        values["seed"] = int(task.rng.integers(2**31))
        if lattice is not None:
            numbers = [np.format_float_positional(x, trim="-") for x in (*lattice.t1, *lattice.t2, *lattice.origin)]
            values |= dict(zip(LATTICE_FIELDS, (",".join(numbers[:4]), *numbers), strict=True))
        return [_absolute(word).format(**values) for word in shlex.split(self.run)]


def _fields(template: str) -> set[str]:
    try:
        shlex.split(template)
        return {name for _, name, _, _ in string.Formatter().parse(template) if name is not None}
    except ValueError as error:
        raise BadInput(f"run {template!r}: {error}; write {{{{ and }}}} for braces, and close quotations") from None


def _absolute(word: str) -> str:
    return str(user_path(word).absolute()) if user_path(word).is_file() else word


def _execute(words: list[str], folder: Path) -> None:
    folder.mkdir()
    try:
        process = subprocess.run(words, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, check=False)
    except (FileNotFoundError, PermissionError) as error:
        raise BadInput(f"command: cannot run {words[0]!r}: {error.strerror}; install it or give its path") from None
    if process.returncode:
        messages = (process.stderr.strip() or process.stdout.strip()).decode(errors="replace")
        raise RuntimeError(
            f"{words[0]} ended with exit code {process.returncode}: {messages[-TAIL:] or 'it said nothing'}"
        )


def _read(output: Path, program: str, sample: Image) -> Image:
    if not output.exists():
        raise RuntimeError(f"{program} ended with exit code 0 but wrote no {{output}}")
    try:
        image = read_image(output, smallest=1)
    except BadInput as error:
        raise RuntimeError(f"{program} wrote an unusable {{output}}: {error}") from error
    return match_channels(image, sample)
