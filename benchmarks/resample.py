"""How the limits of `resample` were chosen, and how it keeps planted defects and rare elements.

``python benchmarks/resample.py STUDY``. The seeds are not those of the suites.

``elements``
    The limits of the element map and of threads: on the models on which they were chosen, and on others.
``threads``
    The limits of threads in small samples of models with threads and without.
``novelty``
    How often colors are taken for classes, and draws for strange: textures whose colors vary smoothly, and in few inks.
``widths``
    Quality by how closely the colors of copied detail must match.
``defects``, ``rare``
    Scores of defects that are planted in outputs and in fresh draws; the rate of missing and worn elements.
"""

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
from nrbench.synthesizers.resampling import element_colors, element_copies, element_map, element_threads
from nrbench.synthesizers.resampling.element_map import ElementMap
from nrbench.synthesizers.resampling.element_threads import ElementThread, link_threads
from nrbench.synthesizers.resampling.novelty import NoveltyTest

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
THREAD_LIMITS = {
    "_EVIDENCE": (1.0, 0.5, 2.0),
    "_LINKED": ((0.5, 1.0), (0.4, 1.0), (0.6, 1.0)),
    "_LINKED_THREADS": ((0.2, 1.0), (0.0, 1.0), (0.4, 1.0)),
    "_STAINED": ((0.25, 0.5, 0.75), (0.01,)),
    "_STAIN_REACHES": ((2.0, 6.0), (1.0, 3.0)),
    "_MOST": (100, 40),
}
"""The same for threads."""
WITHOUT_STAINS: Mapping[str, Any] = {"_STAINED": (0.01,)}
THREADED = {
    "weave": ("weave", {"warp": 14.1, "weft": 11.7, "gap": 1.8}),
    "twill": ("weave", {"warp": 8.3, "weft": 7.9, "gap": 1.2, "draft": "twill"}),
    "basket": ("basket", {"stake": 13.9, "strand": 7.1, "gap": 1.3}),
    "pie": ("pie", {"period": 21.3, "strip": 12.5}),
    "mat": ("mat", {"width": 26.3, "height": 19.1, "rope": 9.3}),
}
"""Models with threads."""
UNTHREADED = {
    "brick": ("brick", {"width": 25.1, "height": 11.3, "joint": 2.0}),
    "hexagon": ("hexagon", {"period": 19.1, "joint": 1.9}),
    "scales": ("scales", {}),
    "cans": ("cans", {"period": 22.7}),
    "squares": ("squares", {"period": 23.1}),
    "windows": ("windows", {"width": 26.3, "height": 29.9, "columns": 2, "lines": 2}),
}
"""Models whose elements have a color each."""
PLANTED: Mapping[str, Mapping[str, Any]] = {
    "plain": {"color": 0.25, "intensity": 0.12, "noise": 0.04},
    "faint": {"color": 0.25, "intensity": 0.12, "noise": 0.12},
    "cloth": {"color": 0.22, "intensity": 0.11, "noise": 0.01, "material": "cloth"},
    "stone": {"color": 0.22, "intensity": 0.11, "noise": 0.01, "material": "stone"},
    "light": {"color": 0.15, "intensity": 0.08, "noise": 0.03, "light": 0.4},
    "inks": {"color": 0.25, "intensity": 0.1, "noise": 0.02, "inks": 2},
}
"""How they depart from regularity."""
PLANTED_SIDES = (72, 96, 128)
PLANTED_SEEDS = {True: (931, 932, 933, 934), False: (941, 942, 943, 944)}
"""Seeds of the draws on which the limits of threads are chosen, and of those reported. Odd ones are upright."""
WIDTHS = (0.4, 0.8, 1.2, 1.6, 3.2)
WIDTH_SEED = 77
"""The seed at which the width of detail is chosen. No table reports it."""
NOVELTIES = (1.0, 1.1, 1.2, 1.3, 1.5, 2.0)
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


def draw_known(choosing: bool, jitter: float = 0.0, inks: int = 0) -> Iterator[Known]:
    """Yield draws of the textures of two suites, those on which limits are chosen, or the others."""
    changes = {"jitter": jitter, "inks": inks}
    for suite in map(load_suite, ("core", "report2004")):
        for row in suite.texture:
            parameters, shape = dict(row.parameters), row.sample or suite.sample
            if row.figure:  # the figures of the report are nearly regular in geometry, and their samples hold few tiles
                parameters, shape = parameters | {"jitter": 0.0, "bend": 0.0}, (160, 160)
            moved = parameters.get("jitter") or parameters.get("bend")
            varies = (parameters.get("color") or parameters.get("intensity")) and not moved
            if (row.dataset in CHOOSING) != choosing or not varies:
                continue
            model = build("datasets", row.dataset, parameters | {k: v for k, v in changes.items() if v})
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
        for changes in thread_changes() if tried else [WITHOUT_STAINS]:
            set_thread_limits(changes)
            print_agreement(f"{title}, threads {changes}", known, maps)
        set_thread_limits({})


def thread_changes() -> list[Mapping[str, Any]]:
    """Return the changes of one limit of threads each."""
    return [{name: value} for name, values in THREAD_LIMITS.items() for value in values[1:]]


def set_thread_limits(changes: Mapping[str, Any]) -> None:
    """Set the limits of threads to those in use but for some changes."""
    for name, values in THREAD_LIMITS.items():
        setattr(element_threads, name, changes.get(name, values[0]))


def print_agreement(title: str, known: Iterable[tuple[Known, Image, np.ndarray]], maps: Iterable[ElementMap]) -> None:
    """Print the mean agreement of threads."""
    rows = []
    for (k, residual, true), elements in zip(known, maps, strict=True):
        threads = link_threads(elements.mean_colors(residual), k.lattice)
        rows.append((k.name, agreement(true, thread_numbers(elements, threads, k.shape))))
    print(f"{title}: {mean_of_textures(rows):.3f}", flush=True)


def draw_planted(models: Mapping[str, tuple[str, Mapping[str, Any]]], choosing: bool) -> Iterator[Known]:
    """Yield draws of small samples of models with threads, or without; the sample holds at least six cells."""
    for name, (model, parameters) in models.items():
        for departure in PLANTED.values():
            for side in PLANTED_SIDES:
                for seed in PLANTED_SEEDS[choosing]:
                    built: Any = build(
                        "datasets", model, {**parameters, **departure, "rotation": (1 - seed % 2) * 14.3}
                    )
                    made = built.render((side, side), np.random.default_rng(seed))
                    if side**2 >= 6 * made.lattice.area:
                        yield Known(name, built, replace(made, image=quantize(made.image)), made.lattice.reduced())


def print_threads() -> None:
    """Print how far threads in small samples agree with the model's, and how often some are found where there are none.

    The first number is the mean agreement; the second one the share of samples in which elements without threads have
    a turn.
    """
    for choosing in (True, False):
        studied = []
        for models in (THREADED, UNTHREADED):
            known = list(draw_planted(models, choosing))
            maps = [element_map.segment(k.made.image, k.residual(k.made.image), k.lattice) for k in known]
            colors = [m.mean_colors(k.residual(k.made.image)) for k, m in zip(known, maps, strict=True)]
            studied.append((known, maps, colors))
        for changes in ({}, *(thread_changes() if choosing else [WITHOUT_STAINS])):
            set_thread_limits(changes)
            found = [
                [link_threads(c, k.lattice) for k, c in zip(known, colors, strict=True)] for known, _, colors in studied
            ]
            agreed = [
                (k.name, agreement(k.true_elements(), thread_numbers(m, threads, k.shape)))
                for k, m, threads in zip(studied[0][0], studied[0][1], found[0], strict=True)
            ]
            false = [
                (k.name, any(t.turn != (0, 0) for t in threads))
                for k, threads in zip(studied[1][0], found[1], strict=True)
            ]
            print(
                f"choosing: {choosing}, {changes or 'as they are'}: {mean_of_textures(agreed):.3f}, "
                f"false {mean_of_textures(false):.3f}",
                flush=True,
            )
        set_thread_limits({})


def print_novelty() -> None:
    """Print how often smooth colors, and three inks, are taken for classes, and a draw without classes for strange."""
    print("draws | in classes | strange at the limits " + ", ".join(map(str, NOVELTIES)))
    for choosing, inks in itertools.product((True, False), (0, 3)):
        rows = [
            (k.name, row)
            for k in draw_known(choosing, inks=inks)
            if bool(k.model.inks) == bool(inks)
            for row in judge_novelty(k)
        ]
        classes, *strange = mean_of_textures(rows)
        title = f"choosing: {choosing}, {'three inks' if inks else 'smooth'}, {len(rows)}"
        print(f"{title} | {classes:.3f} | {', '.join(f'{share:.3f}' for share in strange)}", flush=True)


def judge_novelty(k: Known) -> Iterator[list[float]]:
    """Yield whether colors are taken for classes, and whether a draw without classes is farther than each limit."""
    found: list[float] = []

    def record(test: NoveltyTest, picture: Image) -> bool:
        found.append(test.compare(picture))
        return True

    passes, group = NoveltyTest.passes, element_colors.group_colors
    NoveltyTest.passes = record  # type: ignore[method-assign]
    classes = resample.VariationModel.fit(k.made.image, k.lattice).colors.classes
    if classes:
        found.clear()
        element_colors.group_colors = lambda color: None
        resample.VariationModel.fit(k.made.image, k.lattice)
    NoveltyTest.passes, element_colors.group_colors = passes, group  # type: ignore[method-assign]
    if found:
        yield [bool(classes), *(found[0] > limit for limit in NOVELTIES)]


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
    "threads": print_threads,
    "novelty": print_novelty,
    "widths": print_widths,
    "defects": print_defects,
    "rare": print_rare,
}


if __name__ == "__main__":
    STUDIES[sys.argv[1]]()
