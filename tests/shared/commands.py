"""The command line, called in this process or in another one."""

import json
import shlex
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from nrbench.cli.main import main

TILES = """
import sys
import numpy as np
import PIL.Image
sample, output, width, height, seed = sys.argv[1:]
pixels = np.asarray(PIL.Image.open(sample))
tiled = np.tile(pixels, (9, 9) + (1,) * (pixels.ndim - 2))[: int(height), : int(width)].copy()
tiled[0, 0] = int(seed) % 256
PIL.Image.fromarray(tiled).save(output)
"""
"""A program that repeats a sample, with the seed in the first pixel."""
FIELDS = "{sample} {output} {width} {height} {seed}"


def call(line: str, *more: str) -> int:
    """Run a command line, or words of which none is split, in this process, and return its exit code."""
    with pytest.raises(SystemExit) as left:
        main([line, *more] if more else shlex.split(line))
    return int(left.value.code or 0)


def answer_json(capsys: pytest.CaptureFixture[str], line: str, *more: str) -> Any:
    """Run a command that succeeds, and return the JSON that it prints."""
    assert call(line, *more) == 0
    return json.loads(capsys.readouterr().out)


def refusal(capsys: pytest.CaptureFixture[str], line: str, *more: str) -> str:
    """Run a command that is refused as bad input, and return what it prints to standard error."""
    assert call(line, *more) == 2
    return capsys.readouterr().err


def start(folder: Path, *words: str) -> subprocess.Popen[bytes]:
    """Run the words of a command line in another process, which works in a folder and prints nothing."""
    return subprocess.Popen(
        [sys.executable, "-c", "from nrbench.cli.main import main; main()", *words],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # where the tests run in the background
    )


def script(folder: Path, text: str) -> str:
    """Write a program, and return the command that runs it."""
    file = folder / "my tool.py"
    file.write_text(text)
    return f"'{sys.executable}' '{file}'"
