"""The plan: every cell of a suite, with its sample drawn, before anything is started."""

from __future__ import annotations

import dataclasses
import fnmatch
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from nrbench.errors import BadInput
from nrbench.imaging.convert import Image, as_image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Shape, Texture
from nrbench.streams import pixels_hash
from nrbench.suites.axes import Method, Source
from nrbench.suites.cell import Cell, Recipe
from nrbench.suites.origin import Origin
from nrbench.suites.suite import Suite, TextureRow


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
    sources = list({source.name: source for source in map(Source.parse, suite.lattice)}.values())
    if not methods:
        raise BadInput(f"suite {suite.name}: names no method; add methods = [...] or pass -m METHOD")
    if not sources and any(method.uses_lattice for method in methods):
        raise BadInput(f'suite {suite.name}: names no lattice source; add lattice = ["own"] or pass --lattice own')
    samples = drawn(suite, textures)
    cells = [(cell, sample) for sample in samples for cell in _cells(suite, sample, methods, sources)]
    return Plan(suite, samples, cells)


def drawn(suite: Suite, textures: Sequence[str] = ()) -> list[Sample]:
    """Draw every sample of a suite (of the textures whose names match a pattern)."""
    return [sample for row in _chosen(suite, textures) for sample in _of_row(suite, row)]


def _chosen(suite: Suite, patterns: Sequence[str]) -> list[TextureRow]:
    rows = [row for row in suite.texture if not patterns or any(fnmatch.fnmatch(row.name, p) for p in patterns)]
    if not rows:
        names = ", ".join(row.name for row in suite.texture[:12])
        raise BadInput(f"-t {' '.join(patterns)}: matches no texture of suite {suite.name} ({names}, ...)")
    return rows


def _of_row(suite: Suite, row: TextureRow) -> Iterator[Sample]:
    try:
        origin = Origin.of(suite, row)
    except BadInput as error:
        raise BadInput(f"suite {suite.name}, texture {row.name!r}: {error}") from None
    return (_draw(suite, row, origin, replicate) for replicate in range(suite.replicates))


def _draw(suite: Suite, row: TextureRow, origin: Origin, replicate: int) -> Sample:
    recipe, shape = origin.recipe(replicate), row.size or suite.size
    try:
        texture = _checked(recipe, origin.render(recipe))
        texture = dataclasses.replace(texture, image=quantize(texture.image), name=row.name)
        again = None if recipe.procedural else _region(recipe, texture, shape)
    except (Exception, SystemExit) as error:
        known = isinstance(error, BadInput)
        fault = str(error) if known else f"{type(error).__name__}: {error} ({_last_line()})"
        return Sample(row, recipe, None, shape, fault=fault)
    return Sample(row, recipe, texture, shape, pixels_hash(again) if again is not None else "")


def _checked(recipe: Recipe, texture: object) -> Texture:
    """Refuse what a dataset plugin must not return."""
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
    asked = Cell(
        suite=suite.name,
        texture=sample.row.name,
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
    )
    return _handed(_described(asked, sample), sample, source)


def _described(cell: Cell, sample: Sample) -> Cell:
    """Return a cell with what is known of its texture."""
    texture, row = sample.texture, sample.row
    share = texture.regular_share if texture else None
    return dataclasses.replace(
        cell,
        family=row.family or (texture.family if texture else ""),
        description=row.description,
        procedural=sample.recipe.procedural,
        again_hash=sample.again_hash if cell.reference else "",
        kind=texture.kind if texture else None,
        regular_share=None if share is None else float(np.round(share, 6)),
        region=texture.region if texture else None,
        lattice_truth=texture.lattice if texture else None,
    )


def _handed(cell: Cell, sample: Sample, source: Source) -> Cell:
    """Return a cell with the lattice that is given, or why it cannot be run."""
    if sample.texture is None:
        return dataclasses.replace(cell, fault=sample.fault, fault_status="error")
    if source.name != "given":
        return dataclasses.replace(cell, lattice_given=source.lattice)
    if sample.texture.lattice is None:
        return dataclasses.replace(cell, fault="no lattice of this texture is known, so none can be given")
    return dataclasses.replace(cell, lattice_given=sample.texture.lattice)
