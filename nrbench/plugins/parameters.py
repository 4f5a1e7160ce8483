"""Parameters: convert text and TOML values to the typed fields of a plugin, or raise a clear error."""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import fnmatch
import inspect
import os
import re
import sys
import unicodedata
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

from nrbench.errors import BadInput, require
from nrbench.storage import find_path

if TYPE_CHECKING:
    from pydantic import TypeAdapter

    from nrbench.plugins.forms import Shape

LARGEST_SIDE = 16384
"""px; largest side of an output."""
PRESET, LABEL = "preset", "label"
"""The names under which a preset, and the name of a method in tables, stand among the parameters; no parameter may have
them."""


def parse_size(text: Any) -> Shape:
    """Read ``"WIDTHxHEIGHT"`` into the shape (height, width).

    Raises
    ------
    BadInput
        When it is not two integers from 1 to 16384 joined by an ``x``.
    """
    if isinstance(text, tuple | list):
        text = "x".join(str(part) for part in reversed(text))
    width, x, height = str(text).lower().partition("x")
    if not (x and width.isdecimal() and height.isdecimal() and len(width + height) <= 40):
        raise BadInput(f"size {repr(text)[:60]}: write WIDTHxHEIGHT in px, e.g. 256x256")
    if not (1 <= int(width) <= LARGEST_SIDE and 1 <= int(height) <= LARGEST_SIDE):
        raise BadInput(f"size {text!r}: each side must be from 1 to {LARGEST_SIDE} px")
    return int(height), int(width)


def size_text(shape: Shape) -> str:
    """Return the shape (height, width) as ``"WIDTHxHEIGHT"``."""
    return f"{shape[1]}x{shape[0]}"


def parse_spec(text: str) -> tuple[str, dict[str, Any]]:
    """Split ``"name:param=value,param=value"``. A comma belongs to the value unless ``word=`` follows it.

    Raises
    ------
    BadInput
        When a part has no ``=``, or a parameter occurs twice.
    """
    name, _, rest = text.partition(":")
    parameters: dict[str, Any] = {}
    for part in re.split(r",(?=\w+=)", rest) if rest else []:
        key, equals, value = part.partition("=")
        require(bool(equals and key), f"{text!r}: {part!r} is no parameter; write NAME:param=value,param=value")
        require(key not in parameters, f"{text!r}: parameter {key!r} is given twice; leave one")
        parameters[key] = value
    return name, parameters


def list_parameters(parameters: Mapping[str, Any], separator: str = ",") -> str:
    """Return ``"param=value,param=value"``."""
    return separator.join(f"{key}={value}" for key, value in parameters.items())


def take_label(parameters: dict[str, Any]) -> str:
    """Remove the name that a user gives to a method for the tables from its parameters, and return it.

    Returns
    -------
    str
        The name; empty if there is none.

    Raises
    ------
    BadInput
        If it is blank, longer than 60 characters, or has line breaks or other control characters.
    """
    if LABEL not in parameters:
        return ""
    text = str(parameters.pop(LABEL)).strip()
    require(0 < len(text) <= 60 and text.isprintable(), f"label is {text[:60]!r}; give 1 to 60 printable characters")
    return text


def fill_preset(cls: type[Any], parameters: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return the parameters with those of the chosen preset filled in; given ones take precedence.

    Parameters
    ----------
    cls
        The plugin; its class variable ``presets`` maps names to parameters.
    parameters
        Parameters by name. The entry ``preset``, if there is one, names the preset; the result does not have it.
    where
        The plugin, for messages.

    Raises
    ------
    BadInput
        If the plugin has no preset of this name; the message names those that it has.
    """
    given = dict(parameters)
    if PRESET not in given:
        return given
    name, presets = given.pop(PRESET), getattr(cls, "presets", {})
    if not isinstance(name, str) or name not in presets:
        known = f"choose one of: {', '.join(presets)}" if presets else "it has none; leave preset out"
        raise BadInput(f"{where}: preset {name!r} is not known; {known}")
    return {**presets[name], **given}


def missing(cls: type[Any], parameters: Iterable[str]) -> list[str]:
    """Return the names of the parameters that have no default and are not among the given ones."""
    bare = (f for f in dataclasses.fields(cls) if f.default is f.default_factory is dataclasses.MISSING)
    given = set(parameters)
    return [field.name for field in bare if field.name not in given]


def converted(cls: type[Any], parameters: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return the parameters converted to the declared types of the fields of ``cls``.

    Raises
    ------
    BadInput
        For an unknown parameter (the message names the nearest) or a value of the wrong type.
    """
    return {key: _convert(cls, key, value, where) for key, value in parameters.items()}


def validated(cls: type[Any], parameters: Mapping[str, Any], where: str) -> Any:
    """Return ``cls(**parameters)`` after converting each value to its field's declared type.

    The entry ``preset`` chooses a preset of the plugin; the other parameters override those of the preset.

    Raises
    ------
    BadInput
        For an unknown preset or parameter (the message names the nearest), a missing parameter, a value of the wrong
        type, or a value that the class refuses.
    """
    values = converted(cls, fill_preset(cls, parameters, where), where)
    for name in missing(cls, values):
        raise BadInput(f"{where}: parameter {name!r} is missing; give {where.split()[-1]}:{name}=...")
    try:
        return cls(**values)
    except BadInput as error:
        raise BadInput(str(error) if str(error).startswith(where) else f"{where}: {error}") from error
    except (TypeError, ValueError) as error:
        raise BadInput(f"{where}: {error}") from error


def prepare_conversion(cls: type[Any] | None) -> None:
    """Build the converters of all parameters of a plugin, so that no child of this process has to.

    A converter that cannot be built is left out. The conversion of that parameter raises the error.
    """
    for field in dataclasses.fields(cls) if cls else ():
        with contextlib.suppress(Exception):  # the annotations of third-party plugins may be wrong in any way
            _adapter(cls, field.name)  # type: ignore[arg-type]


@cache
def _adapter(cls: type[Any], name: str) -> TypeAdapter[Any]:
    from pydantic import TypeAdapter

    return TypeAdapter(get_type_hints(cls)[name])


def _convert(cls: type[Any], key: str, value: Any, where: str) -> Any:
    from pydantic import ValidationError

    names = [field.name for field in dataclasses.fields(cls)]
    if key not in names:
        raise BadInput(f"{where}: parameter {key!r} is not known{nearest(key, names)}")
    for attempt in _readings(value):
        try:
            return _located(_adapter(cls, key).validate_python(attempt))  # type: ignore[arg-type]
        except ValidationError as error:
            if attempt != (value,):  # that text is no list of one item says nothing about a number
                why = error.errors()[0]["msg"]
    raise BadInput(f"{where}: {key}={value!r}: {why[:1].lower()}{why[1:]}")


_user_folder: Path | None = None


def leave_user_folder(user_folder: Path, working: Path) -> None:
    """Make another folder the working directory of this process, which is about to run a plugin.

    Files that the plugin writes to relative paths then do not litter the user's folder. :func:`user_path` still starts
    from there, and so do the relative entries of ``sys.path``, which become absolute.

    Parameters
    ----------
    user_folder
        The folder in which the user started nrbench.
    working
        The new working directory. It is made if it does not exist.
    """
    global _user_folder
    sys.path[:] = [str(user_folder / entry) if (user_folder / entry).exists() else entry for entry in sys.path]
    working.mkdir(parents=True, exist_ok=True)
    os.chdir(working)
    _user_folder = user_folder


def user_path(path: str | Path) -> Path:
    """Return a path that a user gave, as it is to be opened: a relative one starts from the user's folder.

    Parameters
    ----------
    path
        As the user wrote it.

    Returns
    -------
    Path
        Absolute where the working directory is not the user's folder.

    Examples
    --------
    >>> from nrbench import user_path
    >>> user_path("picture.png").name
    'picture.png'
    """
    return find_path(Path(path) if _user_folder is None else _user_folder / path)


def _located(value: Any) -> Any:
    """Return a value whose paths can be opened: the working directory of a plugin may not be the user's folder."""
    if type(value) in (tuple, list):
        return type(value)(map(_located, value))
    return user_path(value) if isinstance(value, Path) else value


def _readings(value: Any) -> list[Any]:
    """Return the possible meanings of a value: itself; for text also None, or a list of its comma-separated items."""
    if not isinstance(value, str):
        return [value]
    if value.lower() in ("none", "null"):
        return [None, value]
    return [value, value.split(",")] if "," in value else [value, (value,)]


def match_pattern(pattern: str, names: Iterable[str]) -> set[str]:
    """Return the names that a shell pattern matches; if the pattern itself is one of the names, only that one.

    A bracket is a letter where it begins no set of letters that matches. Accents match in each form (NFC, NFD).
    """
    known = {unicodedata.normalize("NFC", name): name for name in names}
    plain = unicodedata.normalize("NFC", pattern)
    if plain in known:
        return {known[plain]}
    matches = [fnmatch.filter(known, each) for each in (plain, plain.replace("[", "[[]"))]
    return {known[name] for name in matches[0] or matches[1]}


def nearest(word: str, known: Iterable[str]) -> str:
    """Return ``" (did you mean 'x'?)"``, or a list of the known words if none is similar.

    Words are similar if two thirds of their letters agree, in the same order, or if they begin with the same four
    letters; three suffice where one word is so short. Of those that are similar by their letters the nearest is
    returned, of the others up to three.
    """
    options = list(known)
    begun = [each for each in options if len(word) > 2 and each.startswith(word[: max(3, min(4, len(each)))])]
    close = difflib.get_close_matches(word, options, n=1, cutoff=0.66) or begun
    if 0 < len(close) <= 3:
        return f" (did you mean {' or '.join(map(repr, close))}?)"
    return f" (known: {', '.join(options)})" if options else " (there are none)"


def fields_by_call(cls: type[Any]) -> list[dataclasses.Field[Any]]:
    """Return the fields of a plugin in the order of its constructor: keyword-only fields come last.

    A method inherits shared parameters as keyword-only fields, so its own parameters come first, as on its page.
    """
    return sorted(dataclasses.fields(cls), key=lambda field: field.kw_only is True)


class SharedParameters:
    """The base of a class whose parameters several plugins inherit. The page of each plugin describes them, too."""

    def __init_subclass__(cls) -> None:
        """Append the parameters that base classes document to the docstring of a class that inherits them."""
        super().__init_subclass__()
        for base in reversed(cls.__mro__[1:]):
            if SharedParameters in base.__bases__ and cls.__doc__ and base.__doc__:
                shared = inspect.cleandoc(base.__doc__).partition("Parameters\n----------\n")[2]
                own, heading, references = inspect.cleandoc(cls.__doc__).partition("\n\nReferences\n")
                begin = "" if "\nParameters\n" in own else "\nParameters\n----------\n"
                cls.__doc__ = f"{own}\n{begin}{shared}{heading}{references}\n"
