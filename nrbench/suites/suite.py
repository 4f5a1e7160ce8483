"""Suites: the textures, methods, lattice sources and claims of a run, as TOML."""

from __future__ import annotations

import itertools
import math
import re
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import partial
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from nrbench import plugins
from nrbench.errors import BadInput, checker
from nrbench.plugins.parameters import match_pattern, nearest
from nrbench.storage import decode_text, find_path
from nrbench.suites.cell import Recipe, Size, hash_content
from nrbench.suites.installed import builtin as builtin


class Series(BaseModel):
    """One line of a claim's panel: a score at several levels.

    Attributes
    ----------
    name
        Its name.
    levels
        The levels, for example block sizes in periods.
    methods
        The method at each level, as on the command line; one entry stands for all levels.
    textures
        Shell patterns of texture names for each level; one entry stands for all levels. Empty: those of the claim.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    name: str
    levels: tuple[float, ...] = Field(min_length=1)
    methods: tuple[str, ...] = Field(min_length=1)
    textures: tuple[tuple[str, ...], ...] = ()

    @model_validator(mode="after")
    def _check_lengths(self) -> Series:
        if len(set(self.levels)) < len(self.levels):
            raise ValueError(f"series {self.name!r}: a level is given twice")
        for key, entries in (("methods", self.methods), ("textures", self.textures)):
            if len(entries) not in (len(self.levels), 1) and (entries or key == "methods"):
                raise ValueError(f"series {self.name!r}: {len(entries)} {key} for {len(self.levels)} levels")
        return self

    def method_at(self, level: float) -> str:
        """Return the method at a level."""
        return self.methods[self.levels.index(level) if len(self.methods) > 1 else 0]

    def patterns_at(self, level: float) -> tuple[str, ...]:
        """Return the patterns of the textures at a level; empty if they are those of the claim."""
        if not self.textures:
            return ()
        return self.textures[self.levels.index(level) if len(self.textures) > 1 else 0]


class Expectation(BaseModel):
    """What the scores show if a claim holds: one number is less than, greater than or equal to another.

    The first number is the mean of the series over textures at the level ``at``. The second is ``value``, or the mean
    of ``other`` (by default the same series) at ``other_at`` (by default ``at``).

    Attributes
    ----------
    series, at
        The first number.
    relation
        ``less``, ``greater``, or ``equal``: a difference of at most ``margin``.
    value, other, other_at
        The second number.
    margin
        For ``equal``.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    series: str
    at: float
    relation: Literal["less", "greater", "equal"]
    value: float | None = None
    other: str | None = None
    other_at: float | None = None
    margin: float = Field(default=0.0, ge=0)

    @model_validator(mode="after")
    def _check_second(self) -> Expectation:
        if (self.value is None) == (self.other is None and self.other_at is None):
            raise ValueError(f"series {self.series!r} at {self.at:g}: give either value, or other and other_at")
        if (self.relation == "equal") != (self.margin > 0):
            raise ValueError(f"series {self.series!r} at {self.at:g}: relation equal needs a margin, others have none")
        return self


class Claim(BaseModel):
    """A sentence of a paper, with the scores that test it.

    Attributes
    ----------
    name
        Its name.
    quote, source
        The sentence in the words of the paper, with dots where words are left out, and where it stands.
    score
        The score, as ``metric.column``.
    axis
        What the levels are.
    textures
        Shell patterns of the names of the textures.
    series
        The lines of the panel.
    expect
        What the scores show if the claim holds.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    name: str
    quote: str
    source: str
    score: str
    axis: str
    textures: tuple[str, ...] = ("*",)
    series: tuple[Series, ...] = Field(min_length=1)
    expect: tuple[Expectation, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _check_names(self) -> Claim:
        levels = {series.name: series.levels for series in self.series}
        for wanted in self.expect:
            numbers = [(wanted.series, wanted.at)]
            if wanted.value is None:
                level = wanted.at if wanted.other_at is None else wanted.other_at
                numbers.append((wanted.other or wanted.series, level))
            for name, level in numbers:
                if level not in levels.get(name, ()):
                    raise ValueError(f"claim {self.name!r}: there is no series {name!r} with the level {level:g}")
        return self

    @property
    def methods(self) -> tuple[str, ...]:
        """All methods of the claim, each once."""
        return tuple(dict.fromkeys(method for series in self.series for method in series.methods))

    def uses(self, series: Series, level: float, texture: str) -> bool:
        """Return whether a texture is one of those of a series at a level."""
        patterns = series.patterns_at(level) or self.textures
        return any(match_pattern(pattern, [texture]) for pattern in patterns)

    def runs(self, method: str, texture: str) -> bool:
        """Return whether the claim needs a method, written as in the claim, on a texture."""
        return any(
            series.method_at(level) == method and self.uses(series, level, texture)
            for series in self.series
            for level in series.levels
        )


DEFAULT = "default"
"""The suite that runs if none is named. Its methods are also those of a directory of pictures."""

PICTURE_SIZES = {"sample": "256x256", "size": "256x256"}
"""Sizes for those pictures of a directory whose rows have none."""


MOST_ROWS = 20_000
"""Textures that a suite may have at most."""

_BAD = r"/\\\x00-\x1f"
_Name = Annotated[str, Field(pattern=rf"^[^{_BAD}]*[^{_BAD}.][^{_BAD}]*$", max_length=200)]


class TextureRow(BaseModel):
    """One texture of a suite: a dataset with its parameters, and a name.

    ``departure`` and ``level`` are the type and the strength of the departure that the row examines. Reports group by
    them. The rows of one departure go from the easiest level to the hardest.

    A picture that was rendered from a model may have a ``recipe``. If the recipe still gives the same pixels, the
    texture is drawn by it, and its complete truth is known.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    name: _Name
    dataset: str
    family: str = ""
    description: str = ""
    figure: int | None = None
    parameters: dict[str, Any] = {}
    sample: Size | None = None
    size: Size | None = None
    recipe: Recipe | None = None
    departure: str = ""
    level: float | None = None


class GridPart(BaseModel):
    """A part of a texture's row: some of its keys, and values for its texts."""

    model_config = ConfigDict(extra="allow", frozen=True)
    parameters: dict[str, Any] = {}


class Grid(GridPart):
    """Textures as a product: one row for each combination of one entry of each axis.

    A row has the keys of the grid and of its entries. If several of them have the same key, that of the last axis is
    used; ``parameters`` are merged. ``{key}`` in a text of a row is replaced by the value of that key. Keys that are no
    fields of a texture are used in such texts only. The last axis varies fastest. The rows of all grids come after the
    ``[[texture]]`` tables.

    Examples
    --------
    Four textures, from ``brick-mild`` to ``weave-strong``::

        [[grid]]
        name = "{dataset}-{strength}"
        description = "{title} with {strength} colors."
        parameters = { noise = 0.02 }
        axes = [
          [{ dataset = "brick", title = "Running bond" }, { dataset = "weave", title = "Plain weave" }],
          [{ strength = "mild", parameters = { color = 0.1 } }, { strength = "strong", parameters = { color = 0.5 } }],
        ]
    """

    axes: tuple[Annotated[tuple[GridPart, ...], Field(min_length=1)], ...] = ()

    def rows(self) -> Iterator[dict[str, Any]]:
        """Yield the rows.

        Raises
        ------
        ValueError
            When a text names a key that neither the grid nor its entries have, or when a key is not used.
        """
        count = math.prod(map(len, self.axes))
        if count > MOST_ROWS:
            raise ValueError(
                f"has {count:,} combinations; a suite has {MOST_ROWS:,} textures at most: use fewer values"
            )
        for entries in itertools.product(*self.axes):
            row: dict[str, Any] = {}
            parameters: dict[str, Any] = {}
            for part in (self, *entries):
                row |= part.model_extra or {}
                parameters |= part.parameters
            filled = {key: _filled(value, row) for key, value in row.items() if key in TextureRow.model_fields}
            yield {**filled, "parameters": parameters}
        extras = [part.model_extra or {} for part in (self, *itertools.chain.from_iterable(self.axes))]
        used = {word for extra in extras for text in extra.values() for word in _WORD.findall(str(text))}
        for key in (key for extra in extras for key in extra if key not in {*TextureRow.model_fields, *used}):
            raise ValueError(
                f"key {key!r} is not known, and no text has {{{key}}}{nearest(key, TextureRow.model_fields)}"
            )


def _filled(value: Any, row: Mapping[str, Any]) -> Any:
    """Return a value of a row; in a text each ``{key}`` is replaced by the row's value of that key."""
    if not isinstance(value, str):
        return value
    missing = [word for word in _WORD.findall(value) if word not in row]
    if missing:
        raise ValueError(
            f"{value!r} has {{{missing[0]}}}, but a row has no key {missing[0]!r}{nearest(missing[0], row)}"
        )
    return _WORD.sub(lambda match: str(row[match[1]]), value)


_WORD = re.compile(r"\{(\w+)\}")


class Suite(BaseModel):
    """A suite: the cells are textures x methods x lattice sources x replicates.

    Attributes
    ----------
    seed
        The seed of all random streams.
    fresh_seed
        Whether nrbench drew the seed from the system for one run, so that no method can have seen the samples before.
    sample, size
        Shapes (height, width) of sample and output. Those of a texture's row take precedence.
    lattice
        ``given``, ``own``, a detector's name (with parameters), or a lattice's numbers
        ``x1,y1,x2,y2`` or, with its origin, ``x1,y1,x2,y2,x,y``.
    metrics
        The metrics that score the cells. Empty: all metrics.
    methods
        Methods as on the command line: ``name:param=value,...``.
    texture
        The textures. In a file they are ``[[texture]]`` tables, or ``[[grid]]`` tables of several textures each; see
        :class:`Grid`.
    references_once
        Whether the reference methods run on the first draw of each texture alone, and with the first source of the
        lattice.
    claim
        Sentences of papers to test, ``[[claim]]`` tables; see :class:`~nrbench.suites.suite.Claim`. A method runs only
        on the textures of the claims that name it. If ``methods`` is empty, it is the methods of all claims.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    name: _Name
    version: int = 1
    description: str = ""
    seed: int = Field(default=0, ge=0)
    fresh_seed: bool = False
    replicates: int = Field(default=1, ge=1, le=100000)
    sample: Size = (128, 128)
    size: Size = (256, 256)
    lattice: tuple[str, ...] = ("own",)
    methods: tuple[str, ...] = Field(default=(), min_length=0)
    metrics: tuple[str, ...] = ()
    references_once: bool = False
    texture: tuple[TextureRow, ...] = ()
    claim: tuple[Claim, ...] = ()

    @property
    def hash(self) -> str:
        """Hexadecimal hash of the suite's whole content."""
        # Unused keys that older versions did not have are left out, so that the hash stays the same.
        unset: dict[str, Any] = {
            key: True for key in ("fresh_seed", "metrics", "references_once", "claim") if not getattr(self, key)
        }
        unset["texture"] = {
            number: {key for key in ("departure", "level") if getattr(row, key) in ("", None)}
            for number, row in enumerate(self.texture)
        }
        return hash_content(self.model_dump(mode="json", exclude=unset), 8)

    @property
    def all_methods(self) -> tuple[str, ...]:
        """The methods; those of the claims if the suite names none."""
        return self.methods or tuple(dict.fromkeys(method for claim in self.claim for method in claim.methods))

    def runs(self, method: str, texture: str) -> bool:
        """Return whether a method runs on a texture. A method that claims name runs only on their textures."""
        claims = [claim for claim in self.claim if method in claim.methods]
        return not claims or any(claim.runs(method, texture) for claim in claims)

    def with_changes(self, **changes: Any) -> Suite:
        """Return the suite with some fields replaced, checked like the file."""
        return validated_suite({**self.model_dump(mode="json"), **changes}, f"suite {self.name}")


def validated_suite(content: dict[str, Any], where: str) -> Suite:
    """Build a suite from a mapping.

    Raises
    ------
    BadInput
        For an unknown key (the message names the nearest), a wrong value, no texture, or two textures of one name.
    """
    check, place = checker(where), next(_infinite_places(content), None)
    check(place is None, f"{place}: is not a finite number; correct it")
    try:
        suite = Suite.model_validate(_without_grids(content, where))
    except ValidationError as error:
        raise BadInput(f"{where}: {_first(error)}") from error
    rows = [row.name for row in suite.texture]
    twice = next((name for name, count in Counter(rows).items() if count > 1), None)
    check(twice is None, f"two textures have the name {twice!r}; rename one")
    check(len(rows) <= MOST_ROWS, f"has {len(rows):,} textures, the most are {MOST_ROWS:,}; make several suites of it")
    check(bool(rows), "has no texture; add a [[texture]] table with name and dataset")
    check(
        not suite.claim or len(set(suite.lattice)) < 2,
        f"claims compare methods with one source of the lattice; name one of {', '.join(suite.lattice)}",
    )
    for claim in suite.claim:
        for series in claim.series:
            for level in series.levels:
                check(
                    any(claim.uses(series, level, name) for name in rows),
                    f"claim {claim.name!r}, series {series.name!r}, level {level:g}: no texture matches "
                    f"{', '.join(series.patterns_at(level) or claim.textures)}",
                )
    return suite


def _infinite_places(content: Any, place: str = "") -> Iterator[str]:
    """Yield the keys, joined by dots, under which TOML holds ``nan`` or ``inf``, which JSON cannot hold."""
    if isinstance(content, float) and not math.isfinite(content):
        yield place
    parts = content.items() if isinstance(content, Mapping) else enumerate(content) if isinstance(content, list) else ()
    for key, part in parts:
        yield from _infinite_places(part, f"{place}.{key}".lstrip("."))


def _without_grids(content: dict[str, Any], where: str) -> dict[str, Any]:
    """Return the content of a suite with the rows of each grid written out."""
    if "grid" not in content:
        return content
    grids, rows = content["grid"], content.get("texture", [])
    if not (isinstance(grids, list) and all(isinstance(table, dict) for table in grids)):
        raise BadInput(f"{where}: grid: write [[grid]] in front of each grid")
    if not isinstance(rows, list | tuple):
        raise BadInput(f"{where}: texture: write [[texture]] in front of each texture")
    rows = list(rows)
    for number, table in enumerate(grids):
        try:
            rows += Grid.model_validate(table).rows()
        except ValidationError as error:
            raise BadInput(f"{where}: grid.{number}.{_first(error)}") from error
        except ValueError as error:
            raise BadInput(f"{where}: grid.{number}: {error}") from None
    return {**{key: value for key, value in content.items() if key != "grid"}, "texture": rows}


_TABLES: dict[str, type[BaseModel]] = {
    "texture": TextureRow,
    "claim": Claim,
    "series": Series,
    "expect": Expectation,
}


def _first(error: ValidationError) -> str:
    first = min(error.errors(), key=lambda found: found["type"] != "extra_forbidden")
    place = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        tables = [part for part in first["loc"][:-1] if part in _TABLES]
        model = _TABLES[str(tables[-1])] if tables else Suite
        return f"key {place!r} is not known{nearest(str(first['loc'][-1]), model.model_fields)}"
    message = first["msg"].removeprefix("Value error, ")
    return f"{place}: {message}"


def load_suite(what: str | Path) -> Suite:
    """Load a suite by name, from a TOML file, or from a directory of pictures.

    Raises
    ------
    BadInput
        When there is no such suite, or its content is not valid.
    """
    name = str(what)
    if name in builtin():
        return _read(builtin()[name], f"suite {name}")
    path = find_path(Path(what))
    if path.is_dir():
        return directory_suite(path)
    if path.is_file():
        return _read(path, name)
    raise BadInput(f"suite {name!r}: no suite, TOML file or directory of that name{nearest(name, builtin())}")


def _read(file: Path | Traversable, where: str) -> Suite:
    try:
        content = tomllib.loads(decode_text(file.read_bytes()))
    except UnicodeDecodeError:
        raise BadInput(
            f"{where}: is no TOML file; for one picture use `nrbench synth`, or pass its directory"
        ) from None
    except ValueError as error:  # also of an integer of thousands of digits
        raise BadInput(f"{where}: is no valid TOML: {error}") from None
    except RecursionError:
        raise BadInput(f"{where}: is nested too deeply; a suite has three levels at most") from None
    return validated_suite(content, where)


def directory_suite(directory: Path) -> Suite:
    """Return a suite of all pictures in a directory. A dataset plugin with ``directory_rows`` lists them."""
    for plugin in map(partial(plugins.find, "datasets"), plugins.names("datasets")):  # those of nrbench come first
        lister = getattr(plugin.cls, "directory_rows", None)
        if lister is not None:
            rows = [{"dataset": plugin.name, **row} for row in lister(directory)]
            title = directory.resolve().name or "pictures"
            recipes = [_validated_row(row, directory).recipe for row in rows]
            seeds = {recipe.seed if recipe else 0 for recipe in recipes}
            seed = seeds.pop() if len(seeds) == 1 else 0  # that of the suite from which all pictures were rendered
            content: dict[str, Any] = {"name": title, "texture": rows, "seed": seed, **PICTURE_SIZES}
            content["methods"] = load_suite(DEFAULT).methods
            return validated_suite(content, str(directory))
    raise BadInput(f"{directory}: no dataset plugin reads a directory; see `nrbench list datasets`")


def _validated_row(row: Mapping[str, Any], directory: Path) -> TextureRow:
    try:
        return TextureRow.model_validate(row)
    except ValidationError as error:
        in_truth = error.errors()[0]["loc"][0] not in ("name", "dataset", "parameters")
        in_truth = in_truth and (directory / "truth.json").is_file()
        where = directory / "truth.json" if in_truth else directory
        remedy = "; render the textures again, or delete the file" if in_truth else ""
        raise BadInput(f"{where}: picture {row.get('name')!r}: {_first(error)}{remedy}") from None
