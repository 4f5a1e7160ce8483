"""The cell: one texture, one method, one lattice source and one replicate, and the key that names its result."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Annotated, Any

from pydantic import BeforeValidator, PlainSerializer, TypeAdapter

from nrbench import plugins
from nrbench.lattice.geometry import Lattice
from nrbench.lattice.vertices import Vertex
from nrbench.plugins.forms import Again, FoundLattice, Region, Shape, Texture
from nrbench.plugins.parameters import parse_size, size_text
from nrbench.streams import stream

RESULTS_VERSION = 22
"""Increased whenever a change of the code changes an output or a score. Results of other versions are never reused."""

Size = Annotated[Shape, BeforeValidator(parse_size), PlainSerializer(size_text)]
"""A shape (height, width), which files may hold as ``WIDTHxHEIGHT``."""

DetectorIdentity = tuple[str, str, Mapping[str, Any]]
"""Name, full version and parameters of a detector: all that decides its results."""


@dataclass(frozen=True)
class Recipe:
    """All that is needed to draw a texture: dataset, parameters and the entropy of its random streams.

    Parameters
    ----------
    dataset, parameters
        The plugin's name and its parameters, including defaults.
    seed, texture, replicate
        The entropy of the random streams: the suite's seed, the row's name and the replicate.
    shape
        Shape (height, width) of the sample.
    """

    dataset: str
    parameters: Mapping[str, Any]
    seed: int
    texture: str
    replicate: int
    shape: Size

    def as_dict(self) -> dict[str, Any]:
        """Return the recipe as a mapping that can be written as JSON."""
        return dict(vars(self))

    @classmethod
    def from_dict(cls, mapping: Mapping[str, Any]) -> Recipe:
        """Build a recipe from the mapping of :meth:`as_dict`.

        Raises
        ------
        ValueError
            If it is not such a mapping.
        """
        recipe: Recipe = reader_of(cls).validate_python(mapping)  # type: ignore[arg-type]
        return recipe

    def plugin(self) -> Any:
        """Return the dataset plugin's instance."""
        return plugins.build("datasets", self.dataset, self.parameters)

    @property
    def procedural(self) -> bool:
        """Whether the texture is drawn by a model and not read from a picture."""
        return bool(getattr(plugins.lookup("datasets", self.dataset).cls, "procedural", True))

    def render(self) -> Texture:
        """Draw the sample's texture."""
        rng = stream("render", self.seed, self.texture, self.replicate)
        texture: Texture = self.plugin().render(self.shape, rng)
        return texture

    def again(self, texture: Texture) -> Again:
        """Return ``again(shape, k)``: the k-th independent draw of ``texture``'s model and lattice."""
        return self._draws("again", self.plugin().again, texture)

    def recompose(self, texture: Texture) -> Again | None:
        """Return ``recompose(shape, k)``: the k-th draw made of copies of the elements of ``texture``.

        None if the dataset has no method ``recompose``.
        """
        method = getattr(self.plugin(), "recompose", None)
        return None if method is None else self._draws("recompose", method, texture)

    def _draws(self, role: str, method: Callable[..., Texture | None], texture: Texture) -> Again:
        """Return a function that calls a method of the dataset with the stream of the k-th draw."""
        return lambda shape, k: method(texture, shape, stream(role, self.seed, self.texture, self.replicate, k))


@dataclass(frozen=True)
class Cell:
    """All that determines a result, and the description of the result in tables.

    Parameters
    ----------
    suite, texture, family, kind, regular_share, description, region
        The description of the texture in tables.
    recipe
        The recipe of the sample.
    method, version, parameters
        The synthesizer, its version, and its parameters, including defaults.
    label, preset
        The name of the method in tables, and its preset. Neither is part of the key, so methods that differ in nothing
        else share a result.
    reference
        Whether the method calibrates the scores and is never ranked.
    lattice_source
        ``given``, ``own``, a detector's name, the numbers ``x1,y1,x2,y2`` or ``x1,y1,x2,y2,x,y``, or ``none``
        for a method that uses no lattice.
    detector
        Name, version and parameters of the detector, if ``lattice_source`` is one.
    finder
        Name, version and parameters of the detector by which the method finds the lattice itself, if it may have to;
        None if it gets a lattice, or uses no detector.
    lattice_given, lattice_truth
        The lattice that the method gets, and the true one, in the sample's coordinates.
    vertices_truth
        The vertices of the lattice that a person set in a photograph.
    detected
        The result of the detector, also if it found no lattice; None before it has run.
    replicate, seed
        The number of the draw, and the suite's seed.
    shape
        Shape (height, width) of the output.
    sample_hash
        Hash of the sample's pixels; empty if the texture could not be drawn.
    procedural
        Whether the texture is drawn by a model; a metric can then draw it again.
    again_hash
        For a picture and a reference method: hash of the region that the method gets.
    fault
        Why the cell cannot be run (the texture could not be drawn, no lattice was found); empty otherwise.
    fault_status
        The status that such a cell gets.
    """

    suite: str
    texture: str
    recipe: Recipe
    method: str
    version: str
    parameters: Mapping[str, Any]
    label: str
    reference: bool
    lattice_source: str
    replicate: int
    seed: int
    shape: Shape
    sample_hash: str
    family: str = ""
    kind: str | None = None
    regular_share: float | None = None
    description: str = ""
    region: Region | None = None
    detector: DetectorIdentity | None = None
    finder: DetectorIdentity | None = None
    lattice_given: Lattice | None = None
    lattice_truth: Lattice | None = None
    vertices_truth: tuple[Vertex, ...] = ()
    detected: FoundLattice | None = None
    procedural: bool = True
    again_hash: str = ""
    fault: str = ""
    fault_status: str = "refused"
    preset: str = ""

    @cached_property
    def key(self) -> str:
        """Hexadecimal hash of all that determines the result: the name of the cell's folder."""
        decides: dict[str, Any] = {
            "results": RESULTS_VERSION,
            "method": [self.method, self.version, dict(self.parameters)],
            "lattice": [None if self.detector else self.lattice_source, self.detector, self.finder],
            "truth": [self.lattice_truth.as_dict() if self.lattice_truth else None, self.vertices_truth],
            "sample": self.sample_hash,
            "shape": list(self.shape),
            "seed": [self.seed, self.replicate],
            "recipe": self.recipe.as_dict() if self.procedural else self.again_hash,
            "dataset": plugins.lookup("datasets", self.recipe.dataset).full_version,
        }
        if not self.sample_hash:  # without pixels, the file and the reason tell such cells apart
            decides["fault"] = [self.recipe.as_dict(), self.fault]
        return hash_content(decides)

    @property
    def preparation_key(self) -> str:
        """Hexadecimal hash of all that the preparation of the method may depend on; equal for all sizes and draws."""
        method = [self.method, self.version, dict(self.parameters), self.finder]
        given = self.lattice_given.as_dict() if self.lattice_given else None
        return hash_content([RESULTS_VERSION, method, given, self.sample_hash, self.seed])

    def as_dict(self) -> dict[str, Any]:
        """Return the cell as a mapping that can be written as JSON. No parameter is copied, to save time."""
        known = {name: getattr(self, name) for name in ("lattice_given", "lattice_truth", "detected")}
        parts = {name: dataclasses.asdict(part) for name, part in known.items() if part}
        return {"key": self.key, **vars(self), **parts, "recipe": self.recipe.as_dict()}

    @classmethod
    def from_dict(cls, mapping: Mapping[str, Any]) -> Cell:
        """Build a cell from the mapping of :meth:`as_dict`.

        Raises
        ------
        ValueError
            If it is not such a mapping.
        """
        cell: Cell = reader_of(cls).validate_python(mapping)  # type: ignore[arg-type]
        return cell


def hash_content(content: Any, size: int = 12) -> str:
    """Return a hexadecimal hash of ``size`` bytes of what JSON can hold; the order of keys does not matter."""
    return hashlib.blake2b(json.dumps(content, sort_keys=True).encode(), digest_size=size).hexdigest()


@cache
def reader_of(cls: type[Any]) -> TypeAdapter[Any]:
    """Return the converter of mappings to objects of a class. A worker makes it before its children need it."""
    return TypeAdapter(cls)
