"""The plugins that misbehave, registered for a while."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from nrbench import plugins

FAULTS = Path(__file__).parents[1] / "plugins" / "faulty_plugins.py"


@contextmanager
def registered_faults() -> Iterator[Path]:
    """Register the plugins that misbehave; undo what they change in numpy where they run in this process."""
    plugins.add_file(FAULTS)
    try:
        with np.printoptions(), np.errstate():
            yield FAULTS
    finally:
        plugins.registry._files.pop(FAULTS.resolve(), None)
