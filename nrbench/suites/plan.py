"""The plan of a suite: its samples, and the cells of a run."""

from __future__ import annotations

import contextlib
import dataclasses
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from nrbench import plugins
from nrbench.errors import BadInput, describe_error, require
from nrbench.imaging.convert import Image, as_image, depth_of, quantize, to_integers
from nrbench.imaging.masks import Mask
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Kind, Shape, Texture
from nrbench.plugins.parameters import PRESET, list_parameters, match_pattern, parse_spec, take_label
from nrbench.plugins.registry import read_fingerprint
from nrbench.streams import pixels_hash
from nrbench.suites.cell import Cell, DetectorIdentity, Recipe
from nrbench.suites.suite import Suite, TextureRow

MOST_CELLS = 200_000
"""Cells that a run may have at most: the process that plans them keeps each in memory."""
MOST_SAMPLES = 20_000
"""Samples that a run may draw at most. A plan draws each of them, which takes about a minute."""
Draw = Callable[[Recipe, Shape], tuple[Texture, Image | None]]
"""Draws a texture by its recipe, as :func:`draw_texture` does."""


def identify_detector(spec: str) -> DetectorIdentity:
    """Return name, full version and parameters of a detector, ``name:param=value,...``.

    Raises
    ------
    BadInput
        For an unknown detector or parameter, or a value that is not valid.
    """
    name, given = parse_spec(spec)
    parameters = plugins.parameters_of(plugins.build("detectors", name, given))
    return name, plugins.find("detectors", name).full_version, parameters


@dataclass(frozen=True)
class PlannedMethod:
    """A synthesizer with parameters, as named in a suite.

    Parameters
    ----------
    name, version, parameters, label, preset, reference
        As in :class:`~nrbench.suites.cell.Cell`.
    uses_lattice
        Whether the lattice axis applies to it.
    needs_lattice
        Whether it is refused if the detector of the lattice axis finds none.
    finder
        The detector by which it finds the lattice itself; None if it uses none.
    fault
        Why it does not load; empty if it does. Then all its cells fail.
    """

    name: str
    version: str
    parameters: dict[str, Any]
    label: str
    preset: str
    reference: bool
    uses_lattice: bool
    needs_lattice: bool
    finder: DetectorIdentity | None
    fault: str = ""

    @classmethod
    def parse(cls, spec: str) -> PlannedMethod:
        """Parse ``name:param=value,...``; raise BadInput for an unknown method or parameter, or a bad value."""
        name, given = parse_spec(spec)
        label, preset = take_label(given), str(given.get(PRESET, ""))
        plugin = plugins.lookup("synthesizers", name)
        try:
            instance = plugins.build("synthesizers", name, given)
        except plugins.DoesNotLoad as error:
            return cls(name, plugin.version, given, label or spec, preset, False, True, True, None, str(error))
        parameters = plugins.parameters_of(instance)
        finder, fingerprint = getattr(instance, "finder", ""), read_fingerprint(instance, f"method {name}")
        return cls(
            name,
            plugin.full_version if fingerprint is None else f"{plugin.full_version}+{fingerprint}",
            parameters,
            label or getattr(instance, "label", "") or _name_in_tables("synthesizers", name, preset, parameters),
            preset,
            bool(getattr(plugin.cls, "reference", False)),
            bool(getattr(instance, "uses_lattice", True)),
            bool(getattr(plugin.cls, "needs_lattice", True)),
            identify_detector(finder) if finder else None,
        )

    def finder_for(self, source: LatticeSource) -> DetectorIdentity | None:
        """Return the detector that the method may call itself, where its lattice comes from a source."""
        finds_itself = source.name == "own" or (source.detector and not self.needs_lattice)
        return self.finder if finds_itself else None


def _name_in_tables(kind: str, name: str, preset: str, parameters: Mapping[str, Any]) -> str:
    """Return ``name:preset=...,param=value``, with the parameters that differ from those of the preset or the plugin.

    A preset is named also where it equals the defaults, so that nobody wonders whether it was chosen.
    """
    usual = plugins.usual_parameters(kind, name, preset)
    changed = {PRESET: preset} if preset else {}
    changed |= {key: value for key, value in parameters.items() if value != usual[key]}
    return f"{name}:{list_parameters(changed)}" if changed else name


@dataclass(frozen=True)
class LatticeSource:
    """The source of a method's lattice: ``given``, ``own``, ``none``, a detector, or numbers from the user.

    Parameters
    ----------
    name
        Its name in the tables.
    detector
        Name, version and parameters of a detector.
    lattice
        A lattice that the user gives.
    fault
        Why the detector does not load; empty if it does. Then all cells of this source fail.
    """

    name: str
    detector: DetectorIdentity | None = None
    lattice: Lattice | None = None
    fault: str = ""

    @classmethod
    def parse(cls, text: str) -> LatticeSource:
        """Parse an entry of the lattice axis.

        ``none`` is not accepted, because methods themselves declare that they use no lattice. The name of a user's
        lattice is its numbers in their shortest form.

        Raises
        ------
        BadInput
            When the text is neither ``given`` nor ``own``, nor four or six numbers, nor a detector.
        """
        if text in ("given", "own"):
            return cls(text)
        if re.match(r"\s*[-+.\d]|[^:]*,", text):
            lattice = Lattice.parse(text)
            name = ",".join(np.format_float_positional(x, trim="-") for x in lattice.numbers)
            return cls(name, lattice=lattice.with_known_origin() if text.count(",") == 5 else lattice)
        if parse_spec(text)[0] not in plugins.names("detectors"):
            known = ", ".join(["given", "own", "x1,y1,x2,y2[,x,y] (px)", *plugins.names("detectors")])
            raise BadInput(f"--lattice {text!r} is not known; use one of: {known}")
        try:
            name, version, parameters = identify_detector(text)
        except plugins.DoesNotLoad as error:
            return cls(text, fault=str(error))
        return cls(
            _name_in_tables("detectors", name, str(parse_spec(text)[1].get(PRESET, "")), parameters),
            (name, version, parameters),
        )


def _find_recipe(suite: Suite, row: TextureRow, draw: Draw | None) -> Recipe:
    """Return the recipe of the first sample of a row; those of its other samples have the next replicates.

    If the row of a picture has the recipe of a model, the texture is drawn by this recipe, provided that it gives the
    pixels of the picture and its lattice in ``truth.csv``.
    """
    shape, parameters = row.sample or suite.sample, dict(row.parameters)
    with contextlib.suppress(plugins.DoesNotLoad):  # its textures then cannot be drawn
        parameters = plugins.parameters_of(plugins.build("datasets", row.dataset, row.parameters))
    own = Recipe(row.dataset, parameters, suite.seed, row.name, 0, shape)
    if row.recipe is None:
        return own
    try:
        model = dataclasses.replace(row.recipe, parameters=plugins.parameters_of(row.recipe.plugin()))
        uncropped = dataclasses.replace(own, shape=model.shape)
        texture, picture = (_chosen(draw, recipe)(recipe, recipe.shape)[0] for recipe in (model, uncropped))
        equal = pixels_hash(texture.image) == pixels_hash(picture.image) and _has_lattice_of(texture, picture)
    except Exception:  # the recipe is of another version, or of a plugin that is not installed
        return own
    return dataclasses.replace(model, shape=shape) if equal else own


def _has_lattice_of(texture: Texture, picture: Texture) -> bool:
    """Return whether a picture has the lattice of a texture, up to 1e-9 px, or no known lattice."""
    own, known = texture.lattice, picture.lattice
    if own is None or known is None:
        return known is None
    pairs = ((own.t1, known.t1), (own.t2, known.t2), (own.origin, known.origin))
    return all(np.allclose(*pair, rtol=0, atol=1e-9) for pair in pairs)


@dataclass(frozen=True)
class Sample:
    """A texture that is drawn for a run, shared by its cells.

    Parameters
    ----------
    row, recipe
        The suite's row, and the recipe of the texture.
    texture
        The texture, its image rounded to 8 bits; None if drawing failed.
    shape
        Shape (height, width) of the outputs.
    fault, log
        Why drawing failed, and what the dataset printed then; empty if it did not fail.
    region
        Of a photograph: a region that does not touch the sample; None if there is none.
    """

    row: TextureRow
    recipe: Recipe
    texture: Texture | None
    shape: Shape
    fault: str = ""
    log: str = ""
    region: Image | None = None

    @cached_property
    def hash(self) -> str:
        """Hash of the sample's pixels, and of those that count; empty if drawing failed."""
        if self.texture is None or self.texture.known is None:
            return pixels_hash(self.texture.image) if self.texture else ""
        return pixels_hash(np.dstack([self.texture.image, self.texture.known]).astype(np.float32))


@dataclass(frozen=True, eq=False)
class PlannedSample:
    """The sample of cells of a plan. It holds no pictures that a model can draw again, so that a plan stays small.

    Parameters
    ----------
    recipe
        The recipe of the texture.
    shape
        Shape (height, width) of the outputs.
    size
        Shape (height, width) of the sample; None if drawing failed.
    log
        What the dataset printed if drawing failed, else empty.
    kept
        The pixels of the sample and of the region that does not touch it, where drawing again might give others:
        of pictures, and of third-party plugins.
    known
        Which pixels of the sample count; None: all.
    """

    recipe: Recipe
    shape: Shape
    size: Shape | None
    log: str
    kept: tuple[NDArray[Any] | None, NDArray[Any] | None]
    known: Mask | None = None

    @classmethod
    def of(cls, sample: Sample) -> PlannedSample:
        """Return a sample without what can be drawn again."""
        image = sample.texture.image if sample.texture else None
        redrawn = sample.recipe.procedural and plugins.lookup("datasets", sample.recipe.dataset).built_in
        pixels = [
            None if redrawn or each is None else to_integers(each, depth_of(each)) for each in (image, sample.region)
        ]
        size = image.shape[:2] if image is not None else None
        known = sample.texture.known if sample.texture else None
        return cls(sample.recipe, sample.shape, size, sample.log, (pixels[0], pixels[1]), known)

    def image(self) -> Image:
        """Return the pixels of the sample. Those of the last samples are kept; the others are drawn again."""
        return _drawn_again(self)

    def again(self) -> Image | None:
        """Return the region of a photograph that does not touch the sample; None if there is none."""
        return as_image(self.kept[1], "sample", smallest=1) if self.kept[1] is not None else None


@lru_cache(maxsize=4)  # the cells of a few samples follow each other
def _drawn_again(sample: PlannedSample) -> Image:
    kept = sample.kept[0]
    return draw_texture(sample.recipe, sample.shape)[0].image if kept is None else as_image(kept, "sample", smallest=1)


@dataclass(frozen=True)
class Plan:
    """All cells of a suite.

    Parameters
    ----------
    suite
        The suite, with the options of the command line.
    cells
        All cells, each with its sample.
    """

    suite: Suite
    cells: list[tuple[Cell, PlannedSample]]


def make_plan(
    suite: Suite,
    textures: Sequence[str] = (),
    draw: Draw | None = None,
    progress: Callable[[float], None] = lambda done: None,
) -> Plan:
    """Draw every sample and list every cell.

    Parameters
    ----------
    suite
        The suite.
    textures
        Shell patterns of texture names. Empty: all textures.
    draw
        Draws the textures of datasets that are not part of nrbench; None draws them in this process.
    progress
        Called with the share of the samples that are drawn, in [0, 1].

    Raises
    ------
    BadInput
        For unknown methods, parameters or lattice sources, patterns that match no texture, or too many cells.
    """
    sources = list({source.name: source for source in map(LatticeSource.parse, suite.lattice)}.values())
    methods = _distinct({spec: PlannedMethod.parse(spec) for spec in suite.all_methods}, sources)
    if not methods:
        raise BadInput(f"suite {suite.name}: names no method; add methods = [...] or pass -m METHOD")
    _check_count(suite, textures, methods, len(sources))
    if not sources and any(method.uses_lattice for method in methods.values()):
        raise BadInput(f'suite {suite.name}: names no lattice source; add lattice = ["own"] or pass --lattice own')
    cells = [
        (_make_cell(suite, sample, method, source), planned)
        for sample in _draw_each(suite, textures, draw, progress)
        for planned in [PlannedSample.of(sample)]
        for spec, method in methods.items()
        if suite.runs(spec, sample.row.name)
        for source in _sources_of(method, sample, sources, suite.references_once and method.reference)
    ]
    return Plan(suite, cells)


def _check_count(suite: Suite, textures: Sequence[str], methods: Mapping[str, PlannedMethod], sources: int) -> None:
    """Raise BadInput if a run would have too many samples (:data:`MOST_SAMPLES`) or cells, before a sample is drawn."""
    rows = _matching_rows(suite, textures)
    lattices = {spec: sources if method.uses_lattice else 1 for spec, method in methods.items()}
    count = suite.replicates * sum(lattices[spec] for row in rows for spec in methods if suite.runs(spec, row.name))
    if count > MOST_CELLS:
        parts = f"{len(rows):,} textures, {suite.replicates:,} replicates, {len(methods)} methods, {sources} lattices"
        raise BadInput(
            f"suite {suite.name}: a run has {MOST_CELLS:,} cells at most, this one would have {count:,} ({parts}); use "
            "fewer replicates, or choose textures by -t and methods by -m"
        )
    if len(rows) * suite.replicates > MOST_SAMPLES:
        raise BadInput(
            f"suite {suite.name}: a run draws {MOST_SAMPLES:,} samples at most, this one would draw {len(rows):,} "
            f"textures {suite.replicates:,} times; use fewer replicates, or choose textures by -t"
        )


def _sources_of(method: PlannedMethod, sample: Sample, sources: list[LatticeSource], once: bool) -> list[LatticeSource]:
    """Return the sources of the lattice with which a method runs on a sample; at most one of a texture if ``once``."""
    first = sample.row.recipe.replicate if sample.row.recipe else 0
    if once and sample.recipe.replicate > first:
        return []
    return sources[: 1 if once else None] if method.uses_lattice else [LatticeSource("none")]


def _distinct(methods: Mapping[str, PlannedMethod], sources: Sequence[LatticeSource]) -> dict[str, PlannedMethod]:
    """Return the methods without those that were named twice, by the texts that name them.

    Raises
    ------
    BadInput
        If two different methods have the same name in the tables, where the source of the lattice may follow it.
    """
    known: dict[str, str] = {}
    for spec, method in methods.items():
        rows = [f"{method.label} ({source.name})" for source in sources if method.uses_lattice]
        for name in (method.label, *rows):
            other = known.setdefault(name, spec)
            if (methods[other].name, methods[other].parameters) != (method.name, method.parameters):
                raise BadInput(
                    f"two methods have the label {name!r} in the tables: {other} and {spec}; give one of them another "
                    "label="
                )
    return {spec: method for spec, method in methods.items() if known[method.label] == spec}


def draw_samples(suite: Suite, textures: Sequence[str] = (), draw: Draw | None = None) -> list[Sample]:
    """Draw every sample of the textures whose names match a pattern; of all textures if there is no pattern.

    The parameters are those of :func:`make_plan`.
    """
    return list(_draw_each(suite, textures, draw))


def _matching_rows(suite: Suite, textures: Sequence[str]) -> list[TextureRow]:
    """Return the textures whose names match a pattern; all if there is none. Raise BadInput if none matches."""
    known = [row.name for row in suite.texture]
    wanted = set().union(*(match_pattern(each, known) for each in textures)) if textures else set(known)
    rows = [row for row in suite.texture if row.name in wanted]
    if not rows:
        names = ", ".join(row.name for row in suite.texture[:12])
        raise BadInput(f"-t {' '.join(textures)}: matches no texture of suite {suite.name} ({names}, ...)")
    return rows


def _draw_each(
    suite: Suite, textures: Sequence[str], draw: Draw | None, progress: Callable[[float], None] = lambda done: None
) -> Iterator[Sample]:
    rows = _matching_rows(suite, textures)
    for number, row in enumerate(rows):
        try:
            first = _find_recipe(suite, row, draw)
        except BadInput as error:
            raise BadInput(f"suite {suite.name}, texture {row.name!r}: {error}") from None
        for replicate in range(suite.replicates):
            progress((number + replicate / suite.replicates) / len(rows))
            recipe = dataclasses.replace(first, replicate=first.replicate + replicate)
            yield _draw(row, recipe, row.size or suite.size, _chosen(draw, recipe))


def _draw(row: TextureRow, recipe: Recipe, shape: Shape, draw: Draw) -> Sample:
    try:
        texture, again = draw(recipe, shape)
    except BadInput as error:
        log = "\n".join(getattr(error, "__notes__", ()))
        return Sample(row, recipe, None, shape, fault=str(error), log=log)
    except (Exception, SystemExit) as error:
        return Sample(row, recipe, None, shape, fault=describe_error(error))
    return Sample(row, recipe, dataclasses.replace(texture, name=row.name), shape, region=again)


def _chosen(draw: Draw | None, recipe: Recipe) -> Draw:
    """Return the function that draws a recipe's texture: ``draw`` for a dataset that is not part of nrbench."""
    own = plugins.lookup("datasets", recipe.dataset).built_in
    return draw_texture if own or draw is None else draw


def draw_texture(recipe: Recipe, shape: Shape) -> tuple[Texture, Image | None]:
    """Draw a texture by its recipe.

    Parameters
    ----------
    recipe
        The recipe.
    shape
        Shape (height, width) of the outputs.

    Returns
    -------
    texture
        The texture, its image rounded to 8 bits, but for a picture that has 16.
    again
        Of a photograph: a region of the outputs' shape that does not touch the sample, or None.

    Raises
    ------
    BadInput
        When the dataset returns no valid texture.
    """
    texture = _checked(recipe, recipe.render())
    texture = dataclasses.replace(texture, image=quantize(texture.image, depth_of(texture.image)))
    region = None if recipe.procedural else recipe.again(texture)(shape, 0)
    return texture, None if region is None else quantize(region.image, depth_of(region.image))


def _checked(recipe: Recipe, texture: object) -> Texture:
    """Return what a dataset plugin rendered; raise BadInput if it is no valid texture."""
    where = f"dataset {recipe.dataset}"
    if not isinstance(texture, Texture):
        raise BadInput(f"{where}: render returned {type(texture).__name__} instead of a Texture")
    image, region, share = as_image(texture.image, where), texture.region, texture.regular_share
    if recipe.procedural and image.shape[:2] != recipe.shape:
        raise BadInput(f"{where}: render returned the wrong shape: expected {recipe.shape}, got {image.shape}")
    whole = isinstance(region, tuple) and all(isinstance(edge, int | np.integer) for edge in region)
    kinds = get_args(Kind)
    fields = {
        "lattice": ("a Lattice or None", texture.lattice is None or isinstance(texture.lattice, Lattice)),
        "kind": (f"one of {', '.join(kinds)} or None", texture.kind is None or texture.kind in kinds),
        "region": ("four integers x0, y0, x1, y1 or None", region is None or (whole and len(region) == 4)),
        "family": ("text", isinstance(texture.family, str)),
        "regular_share": ("a number from 0 to 1", share is None or (isinstance(share, float) and 0 <= share <= 1)),
    }
    for name, (form, holds) in fields.items():
        require(holds, f"{where}: {name}: expected {form}, got {getattr(texture, name)!r}")
    plain = None if region is None else (int(region[0]), int(region[1]), int(region[2]), int(region[3]))
    return dataclasses.replace(texture, image=image, region=plain)


def _make_cell(suite: Suite, sample: Sample, method: PlannedMethod, source: LatticeSource) -> Cell:
    texture, row = sample.texture, sample.row
    known: dict[str, Any] = {"family": row.family}
    if texture is not None:
        share = texture.regular_share
        known = {
            "family": row.family or texture.family,
            "kind": texture.kind,
            "regular_share": None if share is None else float(np.round(share, 6)),
            "region": texture.region,
            "lattice_truth": texture.lattice,
            "vertices_truth": texture.vertices,
        }
    cell = Cell(
        suite=suite.name,
        texture=row.name,
        recipe=sample.recipe,
        method=method.name,
        version=method.version,
        parameters=method.parameters,
        label=method.label,
        preset=method.preset,
        reference=method.reference,
        lattice_source=source.name,
        detector=source.detector,
        finder=method.finder_for(source),
        replicate=sample.recipe.replicate,
        seed=suite.seed,
        shape=sample.shape,
        sample_hash=sample.hash,
        description=row.description,
        procedural=sample.recipe.procedural,
        again_hash=pixels_hash(sample.region) if method.reference and sample.region is not None else "",
        **known,
    )
    if texture is None:
        return dataclasses.replace(cell, fault=sample.fault, fault_status="error")
    if method.fault or source.fault:
        return dataclasses.replace(cell, fault=method.fault or source.fault, fault_status="error")
    if texture.known is not None:
        used = [("synthesizers", method.name), *([("detectors", source.detector[0])] if source.detector else [])]
        classes = ((kind, plugins.find(kind, name).cls) for kind, name in used)
        lacks = (plugins.describe_lack(kind, cls, "masks") for kind, cls in classes if cls is not None)
        cell = dataclasses.replace(cell, fault=next(filter(None, lacks), ""))
    if source.name != "given":
        return dataclasses.replace(cell, lattice_given=source.lattice)
    if texture.lattice is None:
        return dataclasses.replace(cell, fault="no lattice of this texture is known, so none can be given")
    return dataclasses.replace(cell, lattice_given=texture.lattice)
