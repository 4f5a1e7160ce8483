"""The command line, called in this process."""

import shlex

import pytest

from nrbench.cli.main import main


def call(line: str, *more: str) -> int:
    """Run a command line, or words of which none is split, in this process, and return its exit code."""
    with pytest.raises(SystemExit) as left:
        main([line, *more] if more else shlex.split(line))
    return int(left.value.code or 0)
