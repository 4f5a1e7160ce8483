"""Claims: sentences of papers that a suite tests, and what the scores must show if they hold."""

from __future__ import annotations

import fnmatch
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator


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
        return any(fnmatch.fnmatchcase(texture, pattern) for pattern in patterns)

    def runs(self, method: str, texture: str) -> bool:
        """Return whether the claim needs a method, written as in the claim, on a texture."""
        return any(
            series.method_at(level) == method and self.uses(series, level, texture)
            for series in self.series
            for level in series.levels
        )
