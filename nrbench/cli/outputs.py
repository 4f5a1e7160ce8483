"""Where pictures go, checked before any work is done."""

from __future__ import annotations

from pathlib import Path

from nrbench.errors import BadInput


def check_output(path: Path) -> None:
    """Raise :class:`BadInput` unless a picture can be written to ``path``."""
    if path.suffix.lower() != ".png":
        raise BadInput(f"{path}: outputs are PNG; end the name in .png")
    if not path.absolute().parent.is_dir():
        raise BadInput(f"{path}: its directory does not exist; make it first")
