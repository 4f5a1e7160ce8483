"""The plan: every cell of a suite, with its sample drawn, before anything is started."""

from __future__ import annotations

import dataclasses
import fnmatch
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from nrbench import plugins
from nrbench.cell import Cell, Recipe
from nrbench.errors import BadInput
from nrbench.imaging.door import Image, as_image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.parameters import label, parse_spec
from nrbench.streams import pixels_hash
from nrbench.suite import Suite, TextureRow
from nrbench.texture import Shape, Texture


@dataclass(frozen=True)
class Sample:
    """A texture drawn for a run: what its cells share.

    Parameters
    ----------
    row, recipe
        The suite's row, and how it was drawn.
    texture
        The texture, its image rounded to 8 bits; None where drawing failed.
    shape
        Shape (height, width) of the outputs.
    again_hash
        For a picture: hash of the region that the sample does not touch; empty where there is no room.
    fault
        Why drawing failed, or empty.
    """

    row: TextureRow
    recipe: Recipe
    texture: Texture | None
    shape: Shape
    again_hash: str = ""
    fault: str = ""

    @cached_property
    def hash(self) -> str:
        """Hash of the sample's pixels; empty where the texture could not be drawn."""
        return pixels_hash(self.texture.image) if self.texture else ""

    @property
    def again(self) -> Image | None:
        """The region that the sample does not touch, cut anew: a plan of many pictures does not keep them all."""
        return _region(self.recipe, self.texture, self.shape) if self.again_hash and self.texture else None


@dataclass(frozen=True)
class Method:
    """A synthesizer as a suite names it, checked.

    Parameters
    ----------
    name, version, parameters, label
        As in :class:`~nrbench.cell.Cell`.
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
        shown = label(name, parameters, _defaults(plugin.cls))
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
    """Where a method's lattice comes from: ``given``, ``own``, ``none``, or a detector.

    Parameters
    ----------
    name
        What the tables print.
    detector
        Name, version and parameters, where it is one.
    """

    name: str
    detector: tuple[str, str, dict[str, Any]] | None = None

    @classmethod
    def parse(cls, text: str) -> Source:
        """Read an entry of the lattice axis; raises BadInput where it is neither a word of the axis nor a detector."""
        if text in ("given", "own", "none"):
            return cls(text)
        name, given = parse_spec(text)
        if name not in plugins.names("detectors"):
            known = ", ".join(["given", "own", *plugins.names("detectors")])
            raise BadInput(f"--lattice {text!r}: is not known; use one of: {known}")
        parameters = plugins.parameters_of(plugins.build("detectors", name, given))
        return cls(text, (name, plugins.find("detectors", name).version, parameters))


@dataclass(frozen=True)
class Plan:
    """All cells of a suite.

    Parameters
    ----------
    suite
        The suite, command line options applied.
    samples
        One a texture and replicate.
    cells
        Each with its sample.
    """

    suite: Suite
    samples: list[Sample]
    cells: list[tuple[Cell, Sample]]


def make_plan(suite: Suite, textures: Sequence[str] = ()) -> Plan:
    """Draw every sample and list every cell.

    Parameters
    ----------
    suite
        What to run.
    textures
        Shell patterns of texture names; none means all.

    Raises
    ------
    BadInput
        For unknown methods, parameters or lattice sources, or patterns that match no texture.
    """
    methods = [Method.parse(spec) for spec in dict.fromkeys(suite.methods)]
    sources = [Source.parse(text) for text in dict.fromkeys(suite.lattice)]
    if not methods:
        raise BadInput(f"suite {suite.name}: names no method; add methods = [...] or pass -m METHOD")
    if not sources and any(method.uses_lattice for method in methods):
        raise BadInput(f'suite {suite.name}: names no lattice source; add lattice = ["own"] or pass --lattice own')
    samples = drawn(suite, textures)
    cells = [(cell, sample) for sample in samples for cell in _cells(suite, sample, methods, sources)]
    return Plan(suite, samples, cells)


def drawn(suite: Suite, textures: Sequence[str] = ()) -> list[Sample]:
    """Draw every sample of a suite (of the textures whose names match a pattern)."""
    rows = _chosen(suite, textures)
    return [_draw(suite, row, replicate) for row in rows for replicate in range(suite.replicates)]


def _chosen(suite: Suite, patterns: Sequence[str]) -> list[TextureRow]:
    rows = [row for row in suite.texture if not patterns or any(fnmatch.fnmatch(row.name, p) for p in patterns)]
    if not rows:
        names = ", ".join(row.name for row in suite.texture[:12])
        raise BadInput(f"-t {' '.join(patterns)}: matches no texture of suite {suite.name} ({names}, ...)")
    return rows


def _draw(suite: Suite, row: TextureRow, replicate: int) -> Sample:
    recipe, shape = _recipe(suite, row, replicate), row.size or suite.size
    try:
        texture = _checked(recipe)
        texture = dataclasses.replace(texture, image=quantize(texture.image), name=row.name)
        again = None if recipe.procedural else _region(recipe, texture, shape)
    except (Exception, SystemExit) as error:
        known = isinstance(error, BadInput)
        fault = str(error) if known else f"{type(error).__name__}: {error} ({_last_line()})"
        return Sample(row, recipe, None, shape, fault=fault)
    return Sample(row, recipe, texture, shape, pixels_hash(again) if again is not None else "")


def _checked(recipe: Recipe) -> Texture:
    """Draw a texture, and refuse what a dataset plugin must not return."""
    texture = recipe.render()
    if not isinstance(texture, Texture):
        raise BadInput(f"dataset {recipe.dataset}: render returned {type(texture).__name__} instead of a Texture")
    image = as_image(texture.image, f"dataset {recipe.dataset}")
    if recipe.procedural and image.shape[:2] != recipe.shape:
        raise BadInput(f"dataset {recipe.dataset}: render returned shape {image.shape}; asked for {recipe.shape}")
    if not (texture.lattice is None or isinstance(texture.lattice, Lattice)):
        raise BadInput(f"dataset {recipe.dataset}: lattice is {texture.lattice!r}; a Lattice or None is due")
    share = texture.regular_share
    if not (share is None or (isinstance(share, float) and 0 <= share <= 1)):
        raise BadInput(f"dataset {recipe.dataset}: regular_share is {share!r}; a number from 0 to 1 is due")
    return dataclasses.replace(texture, image=image)


def _recipe(suite: Suite, row: TextureRow, replicate: int) -> Recipe:
    """Return how a row's sample is drawn: for a picture that a model rendered, as that model did."""
    plugin = plugins.build("datasets", row.dataset, row.parameters)
    shape = row.sample or suite.sample
    own = Recipe(row.dataset, plugins.parameters_of(plugin), suite.seed, row.name, replicate, shape)
    known = row.recipe
    if known is None:
        return own
    first = Recipe(known.dataset, known.parameters, known.seed, known.texture, known.replicate, known.shape)
    try:
        parameters = plugins.parameters_of(first.plugin())
        drawn_then, picture = first.render(), dataclasses.replace(own, shape=known.shape).render()
        same = pixels_hash(drawn_then.image) == pixels_hash(picture.image) and _as_told(drawn_then, picture)
    except Exception:  # of another version, or of a plugin that is not installed here: a picture like any other
        return own
    there = dataclasses.replace(first, parameters=parameters, replicate=known.replicate + replicate, shape=shape)
    return there if same else own


def _as_told(texture: Texture, picture: Texture) -> bool:
    """Return whether the lattice told of a picture, if any, is the texture's own: vectors and origin to 1e-9 px."""
    own, told = texture.lattice, picture.lattice
    if own is None or told is None:
        return told is None
    pairs = ((own.t1, told.t1), (own.t2, told.t2), (own.origin, told.origin))
    return all(np.allclose(*pair, rtol=0, atol=1e-9) for pair in pairs)


def _region(recipe: Recipe, texture: Texture, shape: Shape) -> Image | None:
    drawn = recipe.again(texture)(shape, 0)
    return quantize(drawn.image) if drawn is not None else None


def _last_line() -> str:
    return traceback.format_exc().strip().splitlines()[-3].strip()


def _cells(suite: Suite, sample: Sample, methods: list[Method], sources: list[Source]) -> Iterator[Cell]:
    for method in methods:
        for source in sources if method.uses_lattice else [Source("none")]:
            yield _cell(suite, sample, method, source)


def _cell(suite: Suite, sample: Sample, method: Method, source: Source) -> Cell:
    texture, row = sample.texture, sample.row
    cell = Cell(
        suite=suite.name,
        texture=row.name,
        recipe=sample.recipe,
        method=method.name,
        version=method.version,
        parameters=method.parameters,
        label=method.label,
        reference=method.reference,
        lattice_source=source.name,
        detector=source.detector,
        replicate=sample.recipe.replicate,
        seed=suite.seed,
        shape=sample.shape,
        sample_hash=sample.hash,
        family=row.family or (texture.family if texture else ""),
        description=row.description,
        procedural=sample.recipe.procedural,
        again_hash=sample.again_hash if method.reference else "",
    )
    return (
        _with_truth(cell, texture, source)
        if texture
        else dataclasses.replace(cell, fault=sample.fault, fault_status="error")
    )


def _with_truth(cell: Cell, texture: Texture, source: Source) -> Cell:
    cell = dataclasses.replace(
        cell,
        kind=texture.kind,
        regular_share=None if texture.regular_share is None else float(np.round(texture.regular_share, 6)),
        region=texture.region,
        lattice_truth=texture.lattice,
    )
    if source.name != "given":
        return cell
    if texture.lattice is None:
        return dataclasses.replace(cell, fault="no lattice of this texture is known, so none can be given")
    return dataclasses.replace(cell, lattice_given=texture.lattice)
