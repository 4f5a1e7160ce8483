"""Write the package of a new plugin: a module that works, its test, a README, and what pip needs (``nrbench new``)."""

from __future__ import annotations

import keyword
import os
import re
import string
import sys
from collections.abc import Mapping
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.flags import ARGUMENT, Flag
from nrbench.plugins.parameters import nearest

KINDS: Mapping[str, str] = {
    "synthesizer": "synthesizers",
    "detector": "detectors",
    "metric": "metrics",
    "dataset": "datasets",
    "report": "reports",
}
"""The words for one plugin of each kind, and the keys of :data:`nrbench.plugins.FORMS`."""
Kind = Annotated[str, Flag(ARGUMENT, choices=tuple(KINDS))]
PluginName = Annotated[str, Flag(ARGUMENT)]
NewFolder = Annotated["str | os.PathLike[str] | None", Flag("-o", "DIR", kind=Path)]
TRIALS: Mapping[str, str] = {
    "synthesizer": "nrbench run default -m $name",
    "detector": "nrbench lattice picture.png -d $name",
    "metric": "nrbench run default",
    "dataset": "nrbench render $name -o textures",
    "report": "nrbench report runs/default --format $name",
}
"""A command that uses a new plugin of each kind."""
LONGEST = 40
"""Most characters of a name."""
_RESERVED = {"con", "prn", "aux", "nul", *(f"{port}{number}" for port in ("com", "lpt") for number in range(10))}
"""Names that no file has on Windows."""


def new_plugin(kind: Kind, name: PluginName, folder: NewFolder = None) -> list[Path]:
    """Write a package with one plugin, which works and passes ``nrbench check``.

    Parameters
    ----------
    kind
        ``synthesizer``, ``detector``, ``metric``, ``dataset`` or ``report``.
    name
        The name of the plugin: lower-case letters, digits, ``-`` and ``_``.
    folder
        The new folder.  [default: NAME]

    Returns
    -------
    list of Path
        Its files.

    Raises
    ------
    BadInput
        If the name is not valid or taken, or if the folder exists or cannot be made.

    Examples
    --------
    ``new_plugin("synthesizer", "my-method")`` writes the folder ``my-method``; ``pip install -e my-method`` adds it.
    """
    if kind not in KINDS:
        raise BadInput(f"kind {kind!r} is not known{nearest(kind, KINDS)}; give one of {', '.join(KINDS)}")
    words = {"kind": kind, "group": KINDS[kind], **check_name(kind, name)}
    words["trial"] = string.Template(TRIALS[kind]).substitute(words)
    templates = files("nrbench.authoring") / "templates"
    sources = {
        "pyproject.toml": "pyproject.toml.in",
        "README.md": "README.md.in",
        f"{words['module']}.py": f"{kind}.py.in",
        f"test_{words['module']}.py": f"test_{kind}.py.in",
    }
    content = {
        target: string.Template((templates / source).read_text("utf-8")).substitute(words)
        for target, source in sources.items()
    }
    place = Path(folder if folder is not None else name)
    try:
        place.mkdir()
        for target, text in content.items():
            (place / target).write_text(text, "utf-8")
    except FileExistsError:
        raise BadInput(f"{place}: exists already; pass another folder with -o, or remove it") from None
    except OSError as error:
        raise BadInput(f"{place}: cannot be made ({error.strerror}); check the folder above it") from None
    return [place / target for target in content]


def check_name(kind: str, name: str) -> dict[str, str]:
    """Return the name of a new plugin with its ``module`` and its ``class_``.

    Raises
    ------
    BadInput
        If the name has other characters, is reserved, or is that of a plugin or of an installed module.
    """
    if not re.fullmatch(r"[a-z][a-z0-9]*([-_][a-z0-9]+)*", name, re.ASCII) or len(name) > LONGEST:
        raise BadInput(
            f"name {name[: LONGEST + 1]!r}: use at most {LONGEST} lower-case letters, digits, '-' and '_', and begin "
            "with a letter, e.g. my-method"
        )
    module = name.replace("-", "_")
    if keyword.iskeyword(module) or keyword.issoftkeyword(module) or module in _RESERVED:
        raise BadInput(f"name {name!r}: is reserved; choose another one")
    if name in plugins.names(KINDS[kind]):
        raise BadInput(f"name {name!r}: a {plugins.FORMS[KINDS[kind]].noun} of this name exists; choose another one")
    if module in sys.stdlib_module_names or find_spec(module) is not None:
        raise BadInput(f"name {name!r}: a Python module of this name is installed; choose another one")
    return {"name": name, "module": module, "class_": "".join(part.capitalize() for part in re.split("[-_]", name))}
