"""The plugins that misbehave, registered for a while."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import psutil

from nrbench import plugins

FAULTS = Path(__file__).parents[1] / "plugins" / "faulty_plugins.py"


def no_orphans(folder: Path) -> bool:
    """Return whether every process that a plugin left, as the logs in a folder say, has ended, or does so soon."""
    logs = [log.read_text(errors="replace") for log in folder.rglob("log.txt")]
    pids = [int(pid) for log in logs for pid in re.findall(r"^child (\d+)$", log, re.M)]
    processes = [psutil.Process(pid) for pid in pids if psutil.pid_exists(pid)]
    return bool(pids) and not psutil.wait_procs(processes, timeout=5)[1]


@contextmanager
def registered_faults() -> Iterator[Path]:
    """Register the plugins that misbehave; undo what they change in numpy where they run in this process."""
    plugins.add_file(FAULTS)
    try:
        with np.printoptions(), np.errstate():
            yield FAULTS
    finally:
        plugins.registry._files.pop(FAULTS.resolve(), None)
