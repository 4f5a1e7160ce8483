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


def call(line: str, *more: str) -> int:
    """Run a command line, or words of which none is split, in this process, and return its exit code."""
    with pytest.raises(SystemExit) as left:
        main([line, *more] if more else shlex.split(line))
    return int(left.value.code or 0)


def answer_json(capsys: pytest.CaptureFixture[str], line: str, *more: str) -> Any:
    """Run a command that succeeds, and return the JSON that it prints."""
    assert call(line, *more) == 0
    return json.loads(capsys.readouterr().out)


def start(folder: Path, *words: str) -> subprocess.Popen[bytes]:
    """Run the words of a command line in another process, which works in a folder and prints nothing."""
    return subprocess.Popen(
        [sys.executable, "-c", "from nrbench.cli.main import main; main()", *words],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # where the tests run in the background
    )
