"""The plugins that misbehave, registered for a while."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from nrbench import plugins

FAULTS = Path(__file__).parents[1] / "plugins" / "faulty_plugins.py"


@contextmanager
def registered_faults() -> Iterator[Path]:
    """Register the plugins that misbehave."""
    plugins.add_file(FAULTS)
    try:
        yield FAULTS
    finally:
        plugins.registry._files.pop(FAULTS.resolve(), None)
