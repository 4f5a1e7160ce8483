"""What straightening and bending again keeps of the geometry of bent textures, and what it gains.

``python benchmarks/geometry.py [fields] [quality] [regular] [--seeds 0 1 2] [--models ...] [--bends 0.25 0.5]``

Samples have 192 x 192 px, outputs 256 x 256 px; the lattice is given. Subjects:

``fields``
    Amplitude and correlation length of the displacements in outputs of regularized-patch, over those in equally large
    parts of the sample, by the metric ``deformation``, for each way to make the field; and the share of folded cells.
``quality``
    How many outputs of some methods (``--methods``) keep and lose their regularity, how many are undecided, and the
    mean ``quality.score``. The method ``fresh`` is another draw of the model.
``regular``
    Which undisturbed, displaced and bent draws are straightened, over all models.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from studies import Options, run_studies

from nrbench import plugins
from nrbench.calling.bent_samples import find_bend, synthesize_in_geometry
from nrbench.imaging.convert import quantize
from nrbench.plugins.forms import Observation, Refused, Shape, Synthesis, Task, Texture
from nrbench.plugins.parameters import parse_spec
from nrbench.streams import stream

SAMPLE, OUTPUT = (192, 192), (256, 256)
ROTATIONS = {"brick": 0.0, "weave": 12.0, "hexagon": 33.0}
FIELDS = ("", ":geometry=argmax", ":geometry=straight")
NOT_LATTICES = ("images", "noise")


def draw(model: str, seed: int, shape: Shape = SAMPLE, **parameters: float) -> tuple[Texture, object]:
    """Return a texture with pixels of 8 bits, and its model."""
    built = plugins.build("datasets", model, {"rotation": ROTATIONS.get(model, 0.0), **parameters})
    texture: Texture = built.render(shape, np.random.default_rng(seed))
    return replace(texture, image=quantize(texture.image)), built


def observe(texture: Texture, model: object, made: Synthesis) -> Observation:
    """Return what a metric sees of a synthesis."""

    def again(shape: Shape, k: int) -> Texture:
        drawn: Texture = model.again(texture, shape, stream("again", "geometry", k))  # type: ignore[attr-defined]
        return replace(drawn, image=quantize(drawn.image))

    image = quantize(made.image)
    return Observation(texture.image, image, texture, lattice_used=made.lattice, source=made.source, again=again)


def task_of(texture: Texture, seed: int) -> Task:
    """Return the task; methods that are compared get the same random numbers."""
    return Task(texture.image, OUTPUT, texture.lattice, np.random.default_rng(seed))


def show_fields(options: Options) -> None:
    """Print amplitude and length ratios."""
    metric = plugins.build("metrics", "deformation")
    for model in options.models:
        for bend in options.bends:
            for variant in FIELDS:
                method = plugins.build("synthesizers", *parse_spec(f"regularized-patch{variant}"))
                rows = []
                for seed in options.seeds:
                    texture, built = draw(model, seed, bend=bend)
                    values = metric.score(
                        observe(texture, built, synthesize_in_geometry(method, task_of(texture, seed)))
                    ).values
                    rows.append([values[name] for name in ("amplitude_ratio", "length_ratio", "folded")])
                amplitude, length, folded = (
                    [float(value) for value in column if value is not None] for column in zip(*rows, strict=True)
                )
                print(f"  {model:8} bend {bend:<5} {variant or ':geometry=bent':16}", end="")
                print(f"  amplitude {spread(amplitude)}  length {spread(length)}  folded {max(folded):.3f}", flush=True)


def spread(values: list[float]) -> str:
    """Return mean, least and greatest."""
    if not values:
        return "-                   "
    return f"{np.mean(values):.2f} ({min(values):.2f} to {max(values):.2f})"


def show_quality(options: Options) -> None:
    """Print how many outputs keep their regularity, lose it, and are undecided, and their mean quality.

    The method ``fresh`` is another draw of the model, as large as the output.
    """
    regularity, quality = (plugins.build("metrics", name) for name in ("regularity", "quality"))
    for spec in options.methods:
        total = Counter[str]()
        for model in options.models:
            for bend in options.bends:
                verdicts, scores, odd = Counter[str](), [], []
                for seed in options.seeds:
                    texture, built = draw(model, seed, bend=bend)
                    try:
                        made = make(spec, texture, built, seed)
                    except Refused as refused:
                        verdicts["refused"] += 1
                        odd.append(f"{seed} {refused.reason}")
                        continue
                    seen = observe(texture, built, made)
                    found = regularity.score(seen)
                    kept = found.values["preserved"]
                    verdicts["undecided" if kept is None else "kept" if kept else "lost"] += 1
                    if kept is None:
                        odd.append(f"{seed} {found.reasons['preserved']}")
                        continue
                    score = quality.score(seen).values["score"]
                    scores += [] if score is None else [float(score)]
                    if not kept or (spec != "fresh" and "straightened" not in made.note):
                        odd.append(f"{seed} {found.values['score']:.2f} {made.note}")
                total += verdicts
                show_verdicts(f"{spec:20} {model:8} bend {bend:<5}", verdicts)
                print(f"  quality {f'{np.mean(scores):.2f}' if scores else '-'}  {odd or ''}", flush=True)
        show_verdicts(f"{spec:20} all", total)
        print(flush=True)


def make(spec: str, texture: Texture, model: object, seed: int) -> Synthesis:
    """Return the output of a method, or a fresh draw."""
    if spec == "fresh":
        drawn: Texture = model.again(texture, OUTPUT, stream("fresh", "geometry", seed))  # type: ignore[attr-defined]
        return Synthesis(quantize(drawn.image), lattice=texture.lattice)
    return synthesize_in_geometry(plugins.build("synthesizers", *parse_spec(spec)), task_of(texture, seed))


def show_verdicts(head: str, verdicts: Counter[str]) -> None:
    """Print the number of each verdict."""
    print(f"  {head}", *(f" {name} {verdicts[name]}" for name in ("kept", "lost", "undecided", "refused")), end="")


def show_regular(options: Options) -> None:
    """Print how many undisturbed and bent draws count as departing, over all models."""
    cases: Mapping[str, dict[str, float]] = {
        "undisturbed": {},
        "undisturbed, color 0.6": {"color": 0.6},
        "jitter 0.3": {"jitter": 0.3},
        "bend 0.25": {"bend": 0.25},
        "bend 0.5": {"bend": 0.5},
    }
    models = [name for name in plugins.names("datasets") if name not in NOT_LATTICES]
    for case, parameters in cases.items():
        found, measured, odd = 0, 0, []
        for model in models:
            for seed in options.seeds:
                texture, _ = draw(model, seed, **parameters)
                if texture.lattice is None:
                    continue
                straight, _ = find_bend(texture.image, texture.lattice, given=True)
                measured += 1
                found += straight is not None
                if (straight is None) == case.startswith("bend"):
                    odd.append(model)
        print(f"  {case:24} {found} of {measured} are straightened; not as expected: {sorted(set(odd))}")


if __name__ == "__main__":
    methods = ["rsgf", "rsgf:geometry=as-is", "tile-set"]
    more = {"seeds": [0, 1, 2], "models": list(ROTATIONS), "methods": methods, "bends": [0.5, 1.0]}
    run_studies(__doc__, show_fields, show_quality, show_regular, **more)
