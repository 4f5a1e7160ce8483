"""The axes of a suite: methods, and where their lattice comes from, as read from text and checked."""

from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.parameters import label, parse_spec


@dataclass(frozen=True)
class Method:
    """A synthesizer as a suite names it, checked.

    Parameters
    ----------
    name, version, parameters, label
        As in :class:`~nrbench.suites.cell.Cell`.
    reference, uses_lattice
        What the plugin declares.
    """

    name: str
    version: str
    parameters: dict[str, Any]
    label: str
    reference: bool
    uses_lattice: bool

    @classmethod
    def parse(cls, spec: str) -> Method:
        """Read ``name:param=value,...``; raises BadInput for what is not known or not valid."""
        name, given = parse_spec(spec)
        parameters = plugins.parameters_of(plugins.build("synthesizers", name, given))
        plugin = plugins.find("synthesizers", name)
        version = f"{plugin.version}{fingerprint(plugins.build('synthesizers', name, given))}"
        shown = label(name, parameters, _defaults(plugin.cls), getattr(plugin.cls, "always_told", ()))
        reference = bool(getattr(plugin.cls, "reference", False))
        return cls(name, version, parameters, shown, reference, bool(getattr(plugin.cls, "uses_lattice", True)))


def fingerprint(method: Any) -> str:
    """Return what else decides a method's results, as it says itself (``fingerprint()``): files that it reads."""
    ask = getattr(method, "fingerprint", None)
    return f"+{ask()}" if ask is not None else ""


def _defaults(cls: Any) -> dict[str, Any]:
    made = {item.name: item.default_factory() for item in dataclasses.fields(cls) if callable(item.default_factory)}
    return {**{item.name: item.default for item in dataclasses.fields(cls)}, **made}


@dataclass(frozen=True)
class Source:
    """Where a method's lattice comes from: ``given``, ``own``, ``none``, a detector, or the user.

    Parameters
    ----------
    name
        What the tables print.
    detector
        Name, version and parameters, where it is one.
    lattice
        The lattice, where the user gives its numbers.
    """

    name: str
    detector: tuple[str, str, dict[str, Any]] | None = None
    lattice: Lattice | None = None

    @classmethod
    def parse(cls, text: str) -> Source:
        """Read an entry of the lattice axis; raises BadInput where it is no word of it, no lattice, and no detector.

        That a method uses no lattice (``none``) it says itself; the axis cannot ask for it.
        """
        if text in ("given", "own"):
            return cls(text)
        if re.match(r"\s*[-+.\d]|[^:]*,", text):
            return cls.of(Lattice.parse(text))
        name, given = parse_spec(text)
        if name not in plugins.names("detectors"):
            known = ", ".join(["given", "own", "x1,y1,x2,y2 (px)", *plugins.names("detectors")])
            raise BadInput(f"--lattice {text!r}: is not known; use one of: {known}")
        parameters = plugins.parameters_of(plugins.build("detectors", name, given))
        return cls(text, (name, plugins.find("detectors", name).version, parameters))

    @classmethod
    def of(cls, lattice: Lattice) -> Source:
        """Return the source of a lattice that the user gives: its name is its numbers, written in one way only."""
        return cls(",".join(np.format_float_positional(x, trim="-") for x in lattice.matrix.flat), lattice=lattice)
