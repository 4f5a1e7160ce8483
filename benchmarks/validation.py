"""Validation of the scores: fresh draws, planted defects, edits by dose, baselines, bases and photographs.

``python benchmarks/validation.py STUDY [--count N] [--textures PATTERN ...]``. Each study prints one table. N is the
number of fresh draws of each model, or of planted textures of each share; ``--first`` is the seed of the first planted
one, ``--kinds`` names the kinds that are planted, and ``--unedited`` leaves out the edits of photographs.

``fresh``
    False alarms: fresh draws of all texture models, judged with the model and by sample and lattice alone.
``planted``
    Planted defects in textures of regular shares from 0.93 to 0.4: the area under the ROC curve (AUC) of ``quality``
    and of the perils against fresh draws of the same textures. Three kinds are also planted where they belong: new
    colors among few inks, wrong surfaces on materials, torn elements among equal ones.
``ladder``
    Edits that nobody sees and edits that everybody sees (``edits.py``), on fresh draws of the textures of ``default``.
    Constants are set on one half of the textures; the figures of the other half are the report.
``baselines``
    The baselines on the textures of ``default``, judged with the model and without it.
``bases``
    Other bases of a lattice, and supercells of two to four cells: a fresh draw, and one whose halves have slipped,
    judged by sample and lattice alone.
``photographs FOLDER``
    Photographs with known lattices (``truth.csv``): one half is the sample. The outputs are the other half, edited,
    slipped and unedited, and tiles of the sample joined at random.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from edits import Scene, edit_picture, shortest, slip
from numpy.typing import NDArray
from scipy.stats import mannwhitneyu
from studies import Options, read_options

import nrbench
from nrbench import Lattice, plugins
from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.cans import Cans
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.datasets_procedural.plate import Plate
from nrbench.datasets_procedural.wallpaper import Wallpaper
from nrbench.datasets_procedural.weave import Weave
from nrbench.imaging.convert import Image, quantize
from nrbench.metrics.perception import limits
from nrbench.metrics.quality import PERILS, Quality
from nrbench.pictures.files import read_image
from nrbench.plugins.forms import Again, Observation, Refused, Shape, Task, Texture
from nrbench.streams import stream
from nrbench.suites.cell import Recipe
from nrbench.suites.plan import draw_samples
from nrbench.suites.suite import load_suite
from nrbench.synthesizers.planted import Planted

Row = dict[str, Any]
SIZE = (256, 256)
"""Shape of the outputs."""
FIRST_DRAW = 200
"""Number of the first fresh draw that is judged; no reference has these numbers."""
LEAST_FRESH, LEAST_UNSEEN, MOST_SEEN = 0.9, 0.85, 0.6
"""Quality below which a fresh draw, or an unseen edit, is a false alarm, and above which a seen edit escapes."""
LEAST_HALF = 0.8
"""Quality that the other half of a photograph has at least."""
SLIPS = (0.15, 0.3)
"""Shares of s by which halves of photographs are moved."""
SHARES = (0.93, 0.8, 0.7, 0.55, 0.4)
PLANTED: Mapping[str, tuple[float, ...]] = {
    "phase-step": (0.15, 0.3),
    "slipped-course": (0.15, 0.3),
    "warp": (0.15, 0.3),
    "off-lattice": (0.15, 0.3),
    "dropped-row": (0.5,),
    "displaced-tile": (0.3,),
    "missing-tile": (1.0,),
    "two-tone": (0.03, 0.1, 0.3),
    "torn": (0.03, 0.1, 0.3),
    "blurred-band": (0.2,),
    "blur": (1.0,),
    "contrast": (0.2,),
    "noise": (0.5,),
    "wrong-surface": (1.0,),
    "new-color": (0.03, 0.1, 0.3),
    "seam": (0.2,),
    "color-mean": (0.1,),
    "over-regular": (0.6,),
    "verbatim": (0.4,),
}
"""The sizes at which each defect is planted. These textures are flat but for grain: a wrong surface is no defect."""
PLANTED_IN: Mapping[str, Mapping[str, tuple[float, ...]]] = {
    "tints": PLANTED,
    "inks": {"new-color": (0.03, 0.1, 0.3)},
    "material": {"wrong-surface": (0.3, 0.6, 1.0), "new-color": (0.1,)},
    "equal": {"torn": (0.03, 0.1, 0.3)},
}
"""The textures: elements of continuous tints, of few inks, of a material, and elements that are alike."""
BASELINES = ("tiling", "supertile", "shuffle", "random-phase", "scatter")
CHANGES = {
    "own": ((1, 0), (0, 1)),
    "sheared": ((1, 1), (0, 1)),
    "sheared twice": ((2, 1), (1, 1)),
    "turned": ((0, 1), (-1, 0)),
    "2 x 1": ((2, 0), (0, 1)),
    "centered": ((1, 1), (-1, 1)),
    "1 x 3": ((1, 0), (0, 3)),
    "2 x 2": ((2, 0), (0, 2)),
    "4 x 1": ((4, 0), (0, 1)),
}
"""Whole numbers of lattice vectors that make another basis, or the vectors of a supercell."""


@dataclass(frozen=True)
class Subject:
    """A sample by which outputs are judged.

    Parameters
    ----------
    name
        Name of the texture.
    texture
        The sample, rounded to 8 bits, with its truth.
    again
        Fresh draws; None if the texture is known by its sample and lattice alone.
    """

    name: str
    texture: Texture
    again: Again | None = None

    @property
    def vectors(self) -> NDArray[np.float64]:
        """The reduced generating vectors, px."""
        assert self.texture.lattice is not None
        return self.texture.lattice.canonical().matrix

    def bare(self, lattice: Lattice | None = None) -> Subject:
        """Return the sample with a lattice, by default its own, and nothing else."""
        lattice = lattice or self.texture.lattice
        image = self.texture.image
        return Subject(self.name, Texture(image, lattice, (lattice,) if lattice else ()))

    def draw(self, number: int) -> Image:
        """Return a fresh draw."""
        assert self.again is not None
        return quantize(self.again(SIZE, FIRST_DRAW + number).image)

    def observe(self, output: Image) -> Observation:
        """Return what a metric receives."""
        return Observation(self.texture.image, output, self.texture, again=self.again)

    def judge(self, output: Image) -> Row:
        """Return the quality and the perils of an output, and the worst peril."""
        score = Quality().score(self.observe(output))
        return {"texture": self.name, **score.values, "worst": score.records.get("worst", "none")}


def subject_of(recipe: Recipe) -> Subject:
    """Draw a texture."""
    texture = recipe.render()
    texture = replace(texture, image=quantize(texture.image))
    return Subject(recipe.texture, texture, recipe.again(texture))


def subjects(suite: str, patterns: Sequence[str]) -> Iterator[Subject]:
    """Draw the textures of a suite whose names match a pattern, or all."""
    for row in load_suite(suite).texture:
        if not patterns or any(Path(row.name).match(pattern) for pattern in patterns):
            yield subject_of(draw_samples(load_suite(suite), [row.name])[0].recipe)


def models(patterns: Sequence[str]) -> Iterator[Subject]:
    """Draw a texture of every model with a lattice: the first one in ``core``, ``report2004`` or ``default``.

    Those of ``report2004`` are drawn with exact geometry, and larger than in the suite, where samples hold few tiles.
    """
    found: dict[str, tuple[str, str]] = {}
    for suite in ("core", "report2004", "default"):
        for row in load_suite(suite).texture:
            found.setdefault(row.dataset, (suite, row.name))
    for model in sorted(set(plugins.names("datasets")) - {"images", "noise"}):
        suite, name = found[model]
        if not patterns or any(Path(model).match(pattern) for pattern in patterns):
            recipe = draw_samples(load_suite(suite), [name])[0].recipe
            if suite == "report2004":
                exact = {**recipe.parameters, "jitter": 0.0, "bend": 0.0}
                recipe = replace(recipe, parameters=exact, shape=(160, 160))
            yield replace(subject_of(recipe), name=model)


def print_table(*columns: str) -> Callable[..., None]:
    """Print the head of a Markdown table, and return the function that prints its rows."""
    print(f"\n| {' | '.join(columns)} |\n|{' --- |' * len(columns)}")
    return lambda *cells: print(f"| {' | '.join(map(str, cells))} |", flush=True)


def show(value: float | None) -> str:
    """Return a value with two decimals, or a dash."""
    return "-" if value is None or np.isnan(value) else f"{value:.2f}"


def perils_text(row: Row) -> str:
    """Return quality and perils of an output in short."""
    if row["regularity"] is None:
        return "undecided"
    bound = "" if row["complete"] else "<= "
    return f"{bound}{show(row['score'])} (" + ", ".join(f"{name[:3]} {show(row[name])}" for name in PERILS) + ")"


def study_fresh(options: Options) -> None:
    """Print the quality of fresh draws of all models, and the perils of those that are false alarms."""
    tell = print_table(
        "model", "judged by", "draws", "mean", "least", f"below {LEAST_FRESH}", "complete", "false alarms"
    )
    every = []
    for subject in models(options.textures):
        outputs = [subject.draw(number) for number in range(options.count)]
        for by, judge in (("model", subject), ("sample", subject.bare())):
            rows = [judge.judge(output) for output in outputs]
            every += [{**row, "by": by} for row in rows]
            score = pd.Series([row["score"] for row in rows], dtype=float)
            bad = [perils_text(row) for row in rows if row["score"] is not None and row["score"] < LEAST_FRESH]
            complete = sum(bool(row["complete"]) for row in rows)
            cells = len(rows), show(score.mean()), show(score.min()), len(bad), complete, "; ".join(bad) or "-"
            tell(subject.name, by, *cells)
    for by, own in pd.DataFrame(every).groupby("by"):
        score = own["score"].astype(float)
        shares = [f"{(score.dropna() >= limit).mean():.3f} at least {limit}" for limit in (0.95, LEAST_FRESH, 0.8)]
        print(
            f"\nby {by}: {len(own)} draws, {score.notna().sum()} judged, mean {score.mean():.3f}, {', '.join(shares)}"
        )


def planted_subject(seed: int, textures: str = "tints") -> tuple[float, Subject]:
    """Return a texture of random periods, of a regular share by the seed; equal elements have the share 1."""
    rng = stream("render", "validation", seed)
    share, rotation = SHARES[seed % len(SHARES)], float(rng.uniform(-45, 45))
    kinds: list[Model] = [
        Brick(rotation=rotation, width=rng.uniform(22, 36), height=rng.uniform(11, 17), joint=rng.uniform(1.8, 3)),
        Weave(rotation=rotation, warp=rng.uniform(9, 16), weft=rng.uniform(9, 16), gap=rng.uniform(1.2, 2.2)),
        Hexagon(rotation=rotation, period=rng.uniform(18, 34), joint=rng.uniform(1.8, 3.2)),
    ]
    mix, place = rng.dirichlet([1, 1, 1]), seed // len(SHARES) % 3
    if textures == "equal":
        flat: dict[str, float] = {"rotation": rotation, "color": 0, "intensity": 0.04, "noise": 0.02}
        kinds = [Cans(period=rng.uniform(22, 34), **flat), Plate(period=rng.uniform(14, 22), **flat)]
        kinds += [Wallpaper(width=rng.uniform(24, 36), height=rng.uniform(24, 36), motif=seed, **flat)]
        share, model = 1.0, kinds[place]
    else:
        departures = dict(zip(("color", "intensity", "noise"), 3 * mix * (1, 1, 0.3), strict=True))
        model = at_share(kinds[place], departures, share)
    if textures == "inks":
        model = replace(model, inks=2 + seed % 3)
    if textures == "material":
        model = replace(model, material=("clay", "stone", "wood", "cloth")[seed % 4])
    name = type(model).__name__.lower()
    return share, subject_of(Recipe(name, asdict(model), seed, f"{name}-{textures}-{seed}", 0, (128, 128)))


def at_share(model: Model, departures: Mapping[str, float], share: float, steps: int = 25) -> Model:
    """Return the model with departures of these proportions, as strong as the regular share allows."""
    low, high, found = 0.0, 1.0, model
    for _ in range(steps):
        level = (low + high) / 2
        found = replace(model, **{name: min(1.0, level * float(part)) for name, part in departures.items()})
        low, high = (level, high) if found.regular_share > share else (low, level)
    return found


def auc(low: pd.Series[float], high: pd.Series[float]) -> float:
    """Return how often a value of ``high`` exceeds one of ``low``, ties counting half; NaN if one has no value."""
    low, high = low.dropna(), high.dropna()
    return float(mannwhitneyu(high, low).statistic) / (len(low) * len(high)) if len(low) and len(high) else np.nan


def study_planted(options: Options) -> None:
    """Print how well ``quality`` and each peril separate each planted defect from fresh draws."""
    tell = print_table("textures", "defect", "size", "n", "mean quality", "AUC", "worst share", *PERILS)
    for textures, kinds in PLANTED_IN.items():
        chosen = {kind: sizes for kind, sizes in kinds.items() if not options.kinds or kind in options.kinds}
        if chosen:
            table = judge_planted(range(options.first, options.first + 5 * options.count), textures, chosen)
            print_planted(table, textures, tell)


def judge_planted(seeds: range, textures: str, kinds: Mapping[str, Sequence[float]]) -> pd.DataFrame:
    """Judge fresh draws of textures, of kind ``"none"``, and defects that are planted in them."""
    rows = []
    for seed in seeds:
        share, subject = planted_subject(seed, textures)
        rows += [{"share": share, "kind": "none", "size": 0.0, **subject.judge(subject.draw(k))} for k in range(3)]
        for kind, sizes in kinds.items():
            for size in sizes:
                output = plant(subject, kind, size, stream("synthesis", "validation", seed, kind))
                if output is not None:
                    rows.append({"share": share, "kind": kind, "size": size, **subject.judge(output)})
    return pd.DataFrame(rows).astype(dict.fromkeys(["score", *PERILS], float))


def plant(subject: Subject, kind: str, size: float, rng: np.random.Generator) -> Image | None:
    """Return a fresh draw with a defect; None if the texture has no room for it."""
    task = Task(subject.texture.image, SIZE, None, rng, again=subject.again)
    try:
        return quantize(np.clip(Planted(kind, size).synthesize(task).image, 0, 1))
    except Refused:
        return None


def print_planted(table: pd.DataFrame, textures: str, tell: Callable[..., None]) -> None:
    """Print how well the scores separate each defect from fresh draws; of the perils, the mean and the AUC."""
    fresh = table[table["kind"] == "none"]
    means = [show(fresh[name].mean()) for name in ("score", *PERILS)]
    tell(textures, "none", "-", len(fresh), means[0], "-", "-", *means[1:])
    for (kind, size), own in table[table["kind"] != "none"].groupby(["kind", "size"], sort=False):
        by_share = [
            auc(part["score"], fresh.loc[fresh["share"] == share, "score"]) for share, part in own.groupby("share")
        ]
        perils = [f"{show(own[name].mean())}, {auc(own[name], fresh[name]):.2f}" for name in PERILS]
        total = f"{auc(own['score'], fresh['score']):.3f}"
        tell(textures, kind, f"{size:g}", len(own), show(own["score"].mean()), total, f"{min(by_share):.2f}", *perils)


def judge_edits(subject: Subject, picture: Image, group: str) -> list[Row]:
    """Return how all edits of a picture are judged."""
    return [
        {"group": group, "edit": name, "dose": dose, "seen": seen, **subject.judge(edited)}
        for seen in (False, True)
        for name, dose, edited in edit_picture(picture, subject.vectors, seen)
    ]


def print_ladder(table: pd.DataFrame) -> None:
    """Print the mean and the worst quality of each edit in each group of textures, and those beyond the bounds."""
    table["wrong"] = np.where(table["seen"], ~(table["score"] <= MOST_SEEN), ~(table["score"] >= LEAST_UNSEEN))
    groups = list(table["group"].unique())
    tell = print_table("edit", "dose", "seen", *(f"{group}: mean, worst, wrong of n" for group in groups), "wrong on")
    for (seen, edit, dose), own in table.groupby(["seen", "edit", "dose"], sort=False):
        cells = []
        for group in groups:
            part = own[own["group"] == group]
            worst = part["score"].max() if seen else part["score"].min()
            cells.append(f"{show(part['score'].mean())}, {show(worst)}, {part['wrong'].sum()} of {len(part)}")
        wrong = [f"{row['texture']} {perils_text(row)}" for row in own[own["wrong"]].to_dict("records")]
        tell(edit, f"{dose:g}", "yes" if seen else "no", *cells, "; ".join(wrong) or "-")
    for (group, seen), own in table.groupby(["group", "seen"], sort=False):
        bound = f"at most {MOST_SEEN}" if seen else f"at least {LEAST_UNSEEN}"
        print(f"\n{group}, {'seen' if seen else 'unseen'}: {(~own['wrong']).mean():.3f} of {len(own)} {bound}")


def study_ladder(options: Options) -> None:
    """Print the quality of edited fresh draws, by halves of the textures."""
    rows = []
    names = [row.name for row in load_suite("default").texture]
    for subject in subjects("default", options.textures):
        group = "report" if names.index(subject.name) % 2 else "setting"
        rows += judge_edits(subject, subject.draw(0), group)
    print_ladder(pd.DataFrame(rows).astype({"score": float}))


def baseline(name: str, sample: Image, lattice: Lattice | None, shape: Shape) -> Image | None:
    """Return the output of a baseline; None if it refuses the sample."""
    try:
        return quantize(np.clip(nrbench.synthesize(name, sample, shape, lattice=lattice).image, 0, 1))
    except nrbench.Refused:
        return None


def study_baselines(options: Options) -> None:
    """Print how the baselines are judged, with the model and without it."""
    tell = print_table("texture", "judged by", *BASELINES)
    every: list[Row] = []
    for subject in subjects("default", options.textures):
        texture = subject.texture
        outputs = {name: baseline(name, texture.image, texture.lattice, SIZE) for name in BASELINES}
        for by, judge in (("model", subject), ("sample", subject.bare())):
            rows = {name: judge.judge(output) for name, output in outputs.items() if output is not None}
            every += [{"by": by, "method": name, **row} for name, row in rows.items()]
            tell(subject.name, by, *(perils_text(rows[name]) if name in rows else "refused" for name in BASELINES))
    table = pd.DataFrame(every).astype({"score": float})
    for (by, method), own in table.groupby(["by", "method"], sort=False):
        print(f"\nby {by}, {method}: mean {own['score'].mean():.3f}, largest {own['score'].max():.2f}")


def study_bases(options: Options) -> None:
    """Print how a fresh draw and a slip are judged by other bases and by supercells of the lattice."""
    tell = print_table("texture", "output", *CHANGES)
    for subject in subjects("default", options.textures):
        fresh = subject.draw(0)
        scene = Scene(fresh, subject.vectors, stream("bases"))
        moved = slip(scene, 0, round(0.3 * shortest(scene)))
        found: dict[str, list[str]] = {"fresh": [], "slipped by 0.3 s": []}
        for change in CHANGES.values():
            assert subject.texture.lattice is not None
            lattice = Lattice.from_basis(np.array(change) @ subject.vectors, subject.texture.lattice.origin)
            for name, output in zip(found, (fresh, quantize(moved)), strict=True):
                found[name].append(perils_text(subject.bare(lattice).judge(output)))
        for name, cells in found.items():
            tell(subject.name, name, *cells)


def photographs(folder: Path, patterns: Sequence[str]) -> Iterator[tuple[Subject, Image]]:
    """Yield each half of each photograph, cut across its longer side, as the sample, and the other half."""
    truth = pd.read_csv(folder / "truth.csv")
    for row in truth.dropna(subset=["t1x"]).to_dict("records"):
        if patterns and not any(Path(row["file"]).match(pattern) for pattern in patterns):
            continue
        picture = quantize(read_image(folder / row["file"]))
        height, width = picture.shape[:2]
        lattice = Lattice((row["t1x"], row["t1y"]), (row["t2x"], row["t2y"]))
        halves = (picture[:, : width // 2], picture[:, -(width // 2) :])
        if height > width:
            halves = (picture[: height // 2], picture[-(height // 2) :])
        for halves_turned in (halves, halves[::-1]):
            sample, other = (np.ascontiguousarray(half) for half in halves_turned)
            yield Subject(Path(row["file"]).stem, Texture(sample, lattice, (lattice,))), other


def crop_cells(subject: Subject, cells: float) -> Subject:
    """Return the corner of a sample that shows a number of cells along each side."""
    sides = np.minimum(np.ceil(cells * np.abs(subject.vectors).max(0))[::-1], subject.texture.image.shape[:2]).astype(
        int
    )
    image = np.ascontiguousarray(subject.texture.image[: sides[0], : sides[1]])
    return replace(subject, texture=replace(subject.texture, image=image))


def study_photographs(options: Options) -> None:
    """Print how the other half of each photograph, its slips and edits, and shuffled tiles of the sample are judged.

    The other half is also judged by a corner of the sample that shows 3.5 cells a side.
    """
    slips = [(axis, share) for share in SLIPS for axis in (0, 1)]
    names = [
        "other half",
        "by 3.5 cells",
        *(f"slipped by {share} s, {axis}" for axis, share in slips),
        "shuffled tiles",
    ]
    tell = print_table("photograph", *names)
    rows, found = [], []
    for subject, other in photographs(Path(options.folder), options.textures):
        sample = subject.texture.image
        scene = Scene(other, subject.vectors, stream("photographs"))
        moved = [quantize(np.float32(slip(scene, axis, round(share * shortest(scene))))) for axis, share in slips]
        shuffled = baseline("shuffle", sample, subject.texture.lattice, (384, 384))
        small = crop_cells(subject, 3.5)
        judges = [(subject, other), (small, other), *((subject, output) for output in moved), (subject, shuffled)]
        judged = [judge.judge(output) if output is not None else None for judge, output in judges]
        tell(subject.name, *("refused" if row is None else perils_text(row) for row in judged))
        found += [{"output": name, **row} for name, row in zip(names, judged, strict=True) if row is not None]
        if not options.unedited:
            rows += judge_edits(subject, other, "photographs")
    table = pd.DataFrame(found).astype({"score": float, "regularity": float})
    for name, own in table.groupby("output", sort=False):
        known, good = own["regularity"].notna().mean(), (own["score"] >= LEAST_HALF).mean()
        lost, bound = (own["regularity"] < limits.PRESERVED).mean(), (own["complete"] == False).mean()  # noqa: E712
        print(
            f"\n{name}: {len(own)}, known {known:.3f}, lost {lost:.3f}, quality of {LEAST_HALF} {good:.3f}, "
            f"upper bounds {bound:.3f}"
        )
    if rows:
        print_ladder(pd.DataFrame(rows).astype({"score": float}))


STUDIES: Mapping[str, Callable[[Options], None]] = {
    "fresh": study_fresh,
    "planted": study_planted,
    "ladder": study_ladder,
    "baselines": study_baselines,
    "bases": study_bases,
    "photographs": study_photographs,
}


def main() -> None:
    """Run a study, and print its table."""
    lists = {"kinds": [], "textures": []}
    more = {"study": "fresh", "folder": "", "count": 3, "first": 100_000, "unedited": False, **lists}
    options = read_options(__doc__, ["study", "folder"], {"study": STUDIES, "kinds": PLANTED}, **more)
    if options.study == "photographs" and not options.folder:
        raise SystemExit("photographs needs a folder with truth.csv")
    STUDIES[options.study](options)


if __name__ == "__main__":
    main()
