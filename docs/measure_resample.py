r"""Measure what the page on `resample` says of its elements, of planted defects and of rare elements.

::

    python docs/measure_resample.py elements
    python docs/measure_resample.py defects
    python docs/measure_resample.py rare

The seeds are not those of the suites.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from nrbench import Task, Texture, texture
from nrbench.api import score_observation_by, synthesize
from nrbench.imaging.convert import quantize
from nrbench.imaging.mean_tile import fold
from nrbench.plugins.forms import Again, Observation, Shape, Synthesis
from nrbench.plugins.registry import build
from nrbench.running.phases import freeze
from nrbench.suites.suite import load_suite
from nrbench.synthesizers.planted import Planted
from nrbench.synthesizers.resampling import element_map
from nrbench.synthesizers.resampling.element_colors import ElementColors

PLAIN = {"noise": 0.0, "material": "plain", "light": 0.0}
ONE_ELEMENT = ("brick-", "hexagon-", "figure-11", "figure-12", "figure-13", "figure-16", "figure-35", "figure-36",
               "figure-39", "figure-41", "figure-45")  # fmt: skip
LIMITS = ("_SAME", "_SALIENT", "_DOUBT", "_GROUND", "_SMALL")
CHOICES = (
    (0.6, 0.9, 5.0, 0.35, 0.15),
    (0.7, 0.8, 3.0, 0.35, 0.15),
    (0.7, 0.8, 3.0, 0.2, 0.15),
    (0.7, 0.8, 3.0, 0.2, 0.1),
    (0.7, 0.9, 3.0, 0.2, 0.1),
    (0.6, 0.8, 3.0, 0.2, 0.1),
    (0.6, 0.8, 3.0, 0.2, 0.05),
    (0.8, 0.8, 3.0, 0.28, 0.1),
    (0.5, 0.8, 3.0, 0.2, 0.1),
)
PERILS = ("regularity", "integrity", "randomness", "appearance")
DEFECTS = (
    ("none", 0.0),
    ("phase-step", 0.3),
    ("off-lattice", 0.4),
    ("two-tone", 0.5),
    ("over-regular", 0.7),
    ("verbatim", 0.5),
    ("blur", 1.0),
    ("contrast", 0.3),
    ("noise", 0.9),
    ("color-mean", 0.1),
)
RARE = (("brick", {"missing": 0.1}), ("brick", {"damage": 0.15}), ("hexagon", {"missing": 0.1}))


def draw_known() -> Iterator[tuple[str, Texture, np.ndarray]]:
    """Yield the name of each texture of two suites, a draw, and the same draw of which only the colors depart."""
    for suite in map(load_suite, ("core", "report2004")):
        for row in suite.texture:
            given = dict(row.parameters)
            if not (given.get("color") or given.get("intensity")) or given.get("jitter") or given.get("bend"):
                continue
            for seed in (901, 902):
                shape = row.sample or suite.sample
                made, plain = (texture(row.dataset, shape, seed, **p) for p in (given, given | PLAIN))
                if made.lattice and shape[0] * shape[1] >= 8 * made.lattice.area:
                    yield row.name, replace(made, image=quantize(made.image)), plain.image


def print_elements() -> None:
    """Print how much of the true colors the elements explain that are found with some choices of limits."""
    known = list(draw_known())
    for choice in CHOICES:
        for limit, value in zip(LIMITS, choice, strict=True):
            setattr(element_map, limit, value)
        explained, count = [], []
        for _, made, plain in known:
            assert made.lattice
            shape, lattice = made.image.shape[:2], made.lattice.reduced()
            residual, true = (
                image - fold(image, lattice, grid=element_map.map_grid(lattice)).unfold(shape)
                for image in (made.image, plain)
            )
            elements = element_map.segment(made.image, residual, lattice)
            colors = ElementColors.fit(elements, true)
            explained.append(1 - (true - colors.render(colors.of_sample(shape), shape)).var() / true.var())
            count.append(elements.count)
        single = np.array([name.startswith(ONE_ELEMENT) for name, *_ in known])
        split = np.mean(np.array(count)[single] > 1)
        print(
            f"{choice}: explained {np.mean(explained):.3f}, split {split:.2f} of {single.sum()}, of {len(known)} in all"
        )


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
    for kind, size in DEFECTS:
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


if __name__ == "__main__":
    {"elements": print_elements, "defects": print_defects, "rare": print_rare}[sys.argv[1]]()
