"""The command line, called in this process."""

import shlex

import pytest

from nrbench.cli.main import main


def call(line: str) -> int:
    """Run a command line in this process and return its exit code."""
    with pytest.raises(SystemExit) as left:
        main(shlex.split(line))
    return int(left.value.code or 0)
