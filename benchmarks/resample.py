"""How the limits of `resample` were chosen, and how it keeps planted defects and rare elements.

``python benchmarks/resample.py STUDY``. The seeds are not those of the suites.

``elements``, ``fields``
    The limits of the element map and of threads, and of fields: on the models on which they were chosen, and on others.
``widths``
    Quality by how closely the colors of copied detail must match.
``defects``, ``rare``
    Scores of defects that are planted in outputs and in fresh draws; the rate of missing and worn elements.
"""

from __future__ import annotations

import itertools
import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

import nrbench
from nrbench import Task, Texture, synthesize
from nrbench.api.textures import score_observation_by
from nrbench.datasets_procedural.modelling.pattern import Frame
from nrbench.imaging.convert import Image, quantize
from nrbench.imaging.mean_tile import fold
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Again, Observation, Shape, Synthesis
from nrbench.plugins.registry import build
from nrbench.running.phases import freeze
from nrbench.suites.suite import load_suite
from nrbench.synthesizers import resample
from nrbench.synthesizers.planted import Planted
from nrbench.synthesizers.resampling import element_colors, element_copies, element_map
from nrbench.synthesizers.resampling.cell_field import measure_steps
from nrbench.synthesizers.resampling.element_colors import ElementColors, ElementThread
from nrbench.synthesizers.resampling.element_map import ElementMap

CHOOSING = frozenset(
    (
        *("brick", "cans", "card", "cracker", "knit", "mat", "mosaic"),
        *("pavement", "plaid", "rug", "scales", "weave", "windows"),
    )
)
"""Models on which limits are chosen. Both they and the other models have threads, walls and prints."""
SEEDS = {True: (911, 912, 913), False: (921, 922, 923)}
"""Seeds of the draws on which limits are chosen, and of those of the other models, on which they are reported."""
ELEMENT_LIMITS = {
    "_SAME": (0.7, 0.6, 0.8),
    "_SALIENT": (0.8, 0.7, 0.9),
    "_DOUBT": (3.0, 5.0),
    "_GROUND": (0.2, 0.1, 0.3),
    "_SMALL": (0.15, 0.05, 0.3),
    "_STILL": (0.05, 0.1, 0.0),
}
"""The limits of the element map: the value in use, and those that are tried in its place."""
WITHOUT_STILL = {"_STILL": 0.0}
THREADS = (((0.3, 2.0), (0.5, 1.0)), ((0.6, 0.0), (0.85, 0.0)), ((0.2, 2.0), (0.5, 1.0)), ((0.4, 2.0), (0.5, 1.0)))
THREADS += (((0.3, 2.0), (0.4, 1.0)), ((0.3, 2.0), (0.6, 1.0)), ((0.3, 2.0), (0.8, 0.0)))
"""The limits of threads of one element and of several: those in use, and those that are tried in their place."""
WIDTHS = (0.4, 0.8, 1.2, 1.6, 3.2)
WIDTH_SEED = 77
"""The seed at which the width of detail is chosen. No table reports it."""
CONTINUOUS = (0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
PERILS = ("regularity", "integrity", "randomness", "appearance")
DEFECTS = {
    **{"none": 0.0, "phase-step": 0.3, "off-lattice": 0.4, "two-tone": 0.5, "over-regular": 0.7},
    **{"verbatim": 0.5, "blur": 1.0, "contrast": 0.3, "noise": 0.9, "color-mean": 0.1},
}
RARE = (("brick", {"missing": 0.1}), ("brick", {"damage": 0.15}), ("hexagon", {"missing": 0.1}))


@dataclass(frozen=True)
class Known:
    """A draw of a model, and what is known of it.

    Parameters
    ----------
    name
        Name of the texture in its suite.
    model
        The model.
    made
        The draw, rounded to 8 bits.
    lattice
        Its reduced lattice.
    """

    name: str
    model: Any
    made: Texture
    lattice: Lattice

    @property
    def shape(self) -> Shape:
        """Shape of the draw."""
        height, width, _ = self.made.image.shape
        return height, width

    def residual(self, image: Image) -> Image:
        """Return a draw of the model on this lattice without its mean tile."""
        return image - fold(image, self.lattice, grid=element_map.map_grid(self.lattice)).unfold(self.shape)

    def fresh_residual(self, number: int) -> Image:
        """Return the residual of a fresh draw."""
        fresh = self.model.again(self.made, self.shape, np.random.default_rng((77, number)))
        return self.residual(quantize(fresh.image))

    def true_elements(self) -> np.ndarray:
        """Return the number of the model's element, or whole thread, at each pixel; -1 between elements."""
        assert self.made.lattice
        frame = Frame(self.made.lattice.origin, self.model.rotation)
        number, count = np.full(self.shape, -1), 0
        grid = frame.grid(self.shape, moved=self.made.displacement)
        for layer in self.model.colored_pattern(*grid).layers:
            row = np.broadcast_to(layer.census().row, self.shape)
            inside = np.broadcast_to(layer.coverage, self.shape) > 0.5
            number[inside] = row[inside] + count
            count += int(row.max()) + 1
        return number


def draw_known(choosing: bool, jitter: float = 0.0) -> Iterator[Known]:
    """Yield draws of the textures of two suites, those on which limits are chosen, or the others."""
    for suite in map(load_suite, ("core", "report2004")):
        for row in suite.texture:
            parameters, shape = dict(row.parameters), row.sample or suite.sample
            if row.figure:  # the figures of the report are nearly regular in geometry, and their samples hold few tiles
                parameters, shape = parameters | {"jitter": 0.0, "bend": 0.0}, (160, 160)
            moved = parameters.get("jitter") or parameters.get("bend")
            varies = (parameters.get("color") or parameters.get("intensity")) and not moved
            if (row.dataset in CHOOSING) != choosing or not varies:
                continue
            model = build("datasets", row.dataset, parameters | ({"jitter": jitter} if jitter else {}))
            for seed in SEEDS[choosing]:
                made = model.render(shape, np.random.default_rng(seed))
                if made.lattice and shape[0] * shape[1] >= 8 * made.lattice.area:
                    yield Known(row.name, model, replace(made, image=quantize(made.image)), made.lattice.reduced())


def thread_numbers(elements: ElementMap, threads: Sequence[ElementThread], shape: Shape) -> np.ndarray:
    """Return a number of the thread at each pixel."""
    label, instance = elements.instances(shape)
    number = np.array([thread.number(instance) for thread in threads])
    number = np.take_along_axis(number, label[np.newaxis, ..., np.newaxis], 0)[0]
    first = np.array([thread.first for thread in threads])[label]
    both = np.concatenate([first[..., np.newaxis], number], -1).reshape(-1, 3)
    return np.unique(both, axis=0, return_inverse=True)[1].reshape(shape)


def agreement(true: np.ndarray, found: np.ndarray) -> float:
    """Return the mean over pixels of the Jaccard index of the true and the found element that the pixel lies in."""
    inside = true >= 0
    if not inside.any():
        return float("nan")
    pairs = [np.unique(part[inside], return_inverse=True)[1] for part in (true, found)]
    common = np.zeros([int(part.max()) + 1 for part in pairs])
    np.add.at(common, tuple(pairs), 1)
    union = common.sum(1, keepdims=True) + common.sum(0) - common
    return float((common**2 / union).sum() / inside.sum())


def mean_of_textures(rows: Iterable[tuple[str, Any]]) -> np.ndarray:
    """Return the mean over textures of the means over their draws; draws without a value are left out."""
    found: dict[str, list[Any]] = {}
    for name, value in rows:
        found.setdefault(name, []).append(value)
    return np.nanmean([np.mean(values, 0) for values in found.values()], 0)


def print_elements() -> None:
    """Print how far the elements and threads agree with the model's, with some choices of limits."""
    for choosing, jitter in ((True, 0.0), (True, 0.3), (False, 0.0), (False, 0.3)):
        tried = choosing and not jitter
        title = f"choosing: {choosing}, jitter {jitter}"
        known = [(k, k.residual(k.made.image), k.true_elements()) for k in draw_known(choosing, jitter)]
        every = [{name: value} for name, values in ELEMENT_LIMITS.items() for value in values[1:]]
        for changes in (*(every if tried else [WITHOUT_STILL]), {}):
            for name, values in ELEMENT_LIMITS.items():
                setattr(element_map, name, changes.get(name, values[0]))
            maps = [element_map.segment(k.made.image, residual, k.lattice) for k, residual, _ in known]
            print_agreement(f"{title}, elements {changes or 'as they are'}", known, maps)
        for links in THREADS[1:] if tried else THREADS[1:2]:
            element_colors._LINKED, element_colors._LINKED_ELEMENTS = links
            print_agreement(f"{title}, threads {links}", known, maps)
        element_colors._LINKED, element_colors._LINKED_ELEMENTS = THREADS[0]


def print_agreement(title: str, known: Iterable[tuple[Known, Image, np.ndarray]], maps: Iterable[ElementMap]) -> None:
    """Print the mean agreement of threads."""
    rows = []
    for (k, residual, true), elements in zip(known, maps, strict=True):
        threads = element_colors.link_threads(elements.mean_colors(residual))
        rows.append((k.name, agreement(true, thread_numbers(elements, threads, k.shape))))
    print(f"{title}: {mean_of_textures(rows):.3f}", flush=True)


def print_fields() -> None:
    """Print how often a field is drawn where its steps at borders are farther from those of fresh draws, or not drawn.

    The gain is the mean difference of the logarithms, of the choice that is made.
    """
    for choosing, colored in itertools.product((True, False), (False, True)):
        cases = [compare_fields(k, colored) for k in draw_known(choosing)]
        for limit in CONTINUOUS:
            gained = np.array([gain if ratio < limit else -gain for ratio, gain in cases])
            title = f"choosing: {choosing}, colors are drawn: {colored}, {limit}"
            print(f"{title}: wrong {np.mean(gained < 0):.3f}, gain {gained.mean():.3f}", flush=True)


def compare_fields(k: Known, colored: bool) -> tuple[float, float]:
    """Return the ratio that is compared with the limit, and by how much a field is closer to the truth."""
    model = resample.VariationModel.fit(k.made.image, k.lattice)
    detail = model.details(k.made.image)[colored]
    elements, rng = detail.elements, np.random.default_rng(1)
    fresh = [k.fresh_residual(number) for number in range(2)]
    if colored:
        fits = [ElementColors.fit(elements, one) for one in fresh]
        fresh = [one - fit.render(fit.of_sample(k.shape), k.shape) for one, fit in zip(fresh, fits, strict=True)]
    alone = detail.render(detail.draw(k.shape, rng), k.shape)
    joined = model.with_field(detail, colored)
    assert joined.field is not None
    field = joined.field.render(joined.field.draw(k.shape, rng), k.shape, slice(None))
    field = field + joined.detail.render(joined.detail.draw(k.shape, rng), k.shape)
    true = np.mean([measure_steps(one, elements) for one in fresh])
    far = [abs(np.log(true / measure_steps(one, elements))) for one in (alone, field)]
    return resample.compare_steps(detail), float(far[0] - far[1])


def draws_of(name: str, seed: int, parameters: dict[str, float]) -> tuple[Texture, Again]:
    """Return a sample of 128 px and its fresh draws."""
    model = build("datasets", name, parameters)
    made = model.render((128, 128), np.random.default_rng(seed))
    made = replace(made, image=freeze(quantize(made.image)))
    return made, lambda shape, k: model.again(made, shape, np.random.default_rng((seed, k)))


def outputs_of(made: Texture, again: Again) -> Again:
    """Return outputs of `resample` in the place of fresh draws."""

    def draw(shape: Shape, k: int) -> Texture:
        image = synthesize("resample", made.image, shape, lattice=made.lattice, seed=k % 2**31).image
        fresh = again(shape, k)
        assert fresh is not None
        return replace(fresh, image=freeze(quantize(image)))

    return draw


def score(made: Texture, again: Again, output: Synthesis) -> dict[str, float | bool | None]:
    """Return the scores of an output."""
    seen = Observation(made.image, quantize(output.image), made, made.lattice, made.lattice, again=again)
    return dict(score_observation_by(seen, PERILS).values)


def print_defects() -> None:
    """Print the scores of each defect, planted in outputs and in fresh draws."""
    cases = [draws_of(name, 903, {"color": 0.3}) for name in ("brick", "weave", "hexagon")]
    print("defect, size | regularity, integrity, randomness, appearance of outputs | of fresh draws")
    for kind, size in DEFECTS.items():
        row = []
        for planted_in in (outputs_of, lambda _, again: again):
            found = []
            for made, again in cases:
                draws = planted_in(made, again)
                task = Task(made.image, (256, 256), None, np.random.default_rng(1), again=draws)
                scores = score(made, again, Planted(kind, size).synthesize(task))
                found.append([np.nan if (value := scores[f"{p}.score"]) is None else float(value) for p in PERILS])
            row.append(", ".join("--" if np.isnan(mean) else f"{mean:.2f}" for mean in np.nanmean(found, 0)))
        print(f"{kind} {size} | {row[0]} | {row[1]}", flush=True)


def print_rare() -> None:
    """Print the share of pixels that departs by more than 0.15 from the ideal image: missing and worn elements."""
    for name, parameters in RARE:
        shares = []
        for seed in range(904, 916):
            made, again = draws_of(name, seed, {"color": 0.1, "intensity": 0.05, "noise": 0.02} | parameters)
            fresh = again((256, 256), 1)
            assert fresh is not None and fresh.ideal is not None and made.ideal is not None
            output = synthesize("resample", made.image, (256, 256), lattice=made.lattice, seed=seed)
            pairs = (made.image, made.ideal), (output.image, fresh.ideal), (fresh.image, fresh.ideal)
            shares.append([np.mean(np.abs((image - ideal).mean(-1)) > 0.15) for image, ideal in pairs])
        sample, own, drawn = np.mean(shares, 0)
        print(f"{name} {parameters}: sample {sample:.3f}, output {own:.3f}, fresh draw {drawn:.3f}")


def print_widths() -> None:
    """Print the mean quality, integrity and repetition of `resample` for each width, in standard deviations of colors.

    The suites ``core`` and ``default`` are drawn at :data:`WIDTH_SEED`, and the lattice is given.
    """
    columns = ("quality.score", "integrity.score", "randomness.repetition")
    print(f"| sigmas | {' | '.join(f'{suite}: {name}' for suite in ('core', 'default') for name in columns)} |")
    chosen = {"methods": "resample", "lattice": "given", "seed": WIDTH_SEED, "replicates": 1}
    for width in WIDTHS:
        element_copies._ALIKE = width
        means = []
        for suite in ("core", "default"):
            out = Path(tempfile.mkdtemp()) / "run"
            table = nrbench.run(suite, **chosen, out=out, options=nrbench.Options(jobs=0)).table()
            means += [float(table[name].mean()) for name in columns]
        print(f"| {width} | {' | '.join(f'{mean:.3f}' for mean in means)} |", flush=True)


STUDIES: Mapping[str, Callable[[], None]] = {
    "elements": print_elements,
    "fields": print_fields,
    "widths": print_widths,
    "defects": print_defects,
    "rare": print_rare,
}


if __name__ == "__main__":
    STUDIES[sys.argv[1]]()
