"""Validation of the scores: planted defects and fresh draws as ordinary runs, and the tables of docs/validation.md.

``python benchmarks/validation.py STUDY [--count N] [--replicates N] [--sides 256 512] [--half report] [--jobs 2]``

Each study is an ordinary run of ``oracle`` (fresh draws) and ``planted`` (fresh draws with one known defect) on
textures whose models are known. The run lies in ``runs/validation/``: the same command resumes it, more replicates add
to it, and ``nrbench report`` shows its pictures.

``alarms``
    Fresh draws of textures of random periods, rotations and mixes of departures at six regular shares. Prints false
    alarms of ``regularity`` and ``integrity``, and how near fresh draws come to each limit.
``detection``
    The same textures with planted defects. Prints for each defect the area under the ROC curve (AUC) and the shares
    called lost and undecided, by regular share.
``perils``
    Fresh draws, and the baselines, of all textures of all suites, and of every model with varying geometry (``types``:
    type II with equal colors, and type III). Prints false alarms of the three perils by type of texture, and the mean
    ``quality`` of each row by suite. ``--suites`` takes some of them.
``planted``
    Two-tone elements, blur, noise in place of the texture inside elements, and loss of contrast in textures of a
    regular share of 0.5 to 0.95. Prints for each defect and size the AUC of its own column and of ``quality``, and
    Spearman's correlation of both with the size.
``without-model``
    The outputs of ``detection`` again, judged by sample and lattice alone. Prints the same tables.
``photographs``
    Photographs with known lattices, judged without a model (``--pictures FOLDER`` with a ``truth.csv``). The sample is
    a quarter of a picture, or one half of a small one; the outputs are the part that does not touch it, and random
    tiles of the sample joined edge to edge (``shuffle``) at twice its sides. Prints the verdict and ``integrity``.
``sample-integrity``
    Fresh draws and outputs with broken elements of the textures of ``core`` and ``report2004`` at 256 px, in color and
    in gray, judged by sample and lattice alone. Prints how often ``integrity`` speaks and what it says.
``bends``
    Brick, weave and hexagon, bent by 0.25, 0.5 and 1, each sample with a fresh draw, a fresh draw with a phase step of
    0.25 s, and a draw of the same model that is not bent. Prints how they are judged, and the quality of the fresh draw
    of the first sample. ``--bends`` takes some of them. This study is no run.
``variation``
    Fresh draws, an ideal copier (``copier``) and ``--methods`` on the textures of ``core``. Prints the mean of
    ``randomness.variation``, the share of outputs outside the 95 % prediction interval of the fresh draws of all
    samples of a texture, and the mean ratio to the copier of the same sample.
``references``
    Fresh draws and the baselines on the textures of type I of ``core`` and ``report2004``. Prints how many of a second
    set of fresh draws lie in the 95 % band of the first, and in which columns each baseline lies outside the 99 % band.

Limits are set on the textures of ``--half calibration``; figures are reported for those of ``--half report``.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import binomtest, mannwhitneyu, spearmanr
from scipy.stats import t as student

import nrbench
from nrbench import plugins
from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.datasets_procedural.weave import Weave
from nrbench.imaging.convert import Image, quantize
from nrbench.imaging.files import read_image
from nrbench.metrics.integrity import Integrity
from nrbench.metrics.quality import Quality
from nrbench.metrics.regularity import Regularity
from nrbench.metrics.verdict.bent import bent_reference_from_model, compute_bent_verdict
from nrbench.plugins.forms import Observation, Shape, Task, Texture
from nrbench.running.pace import Step
from nrbench.runs.records import CellRecord
from nrbench.streams import stream
from nrbench.suites.suite import load_suite, validated_suite
from nrbench.synthesizers.planted import Planted

Row = dict[str, Any]
FIRST_SEED = {"calibration": 0, "report": 100_000}
SHARES = (0.93, 0.8, 0.7, 0.55, 0.4, 0.3)
RESPONSE_TEXTURES = (14, 15, 16)
"""Numbers of the textures of ``response`` and ``silence``: brick, weave and hexagon of regular share 0.8."""

DEFECTS: Mapping[str, tuple[float, ...]] = {
    "phase-step": (0.1, 0.15, 0.3),
    "slipped-course": (0.1, 0.15, 0.3),
    "stretch": (0.01, 0.02, 0.03),
    "warp": (0.1, 0.15, 0.3),
    "off-lattice": (0.1, 0.15, 0.3),
    "dropped-row": (0.5,),
    "doubled-row": (0.5,),
    "displaced-tile": (0.15, 0.3, 0.4),
    "missing-tile": (0.6, 1.0),
    "doubled-tile": (0.3, 0.5),
    "two-tone": (0.03, 0.08, 0.25),
    "blurred-band": (0.2,),
    "seam": (0.1,),
    "color-mean": (0.1,),
    "over-regular": (0.6,),
    "verbatim": (0.4,),
}
"""The sizes at which ``detection`` plants each defect; ``silence`` takes the middle one."""


def planted(kind: str, size: float) -> str:
    """Return the method that plants a defect."""
    return f"planted:kind={kind},size={size:g}"


DETECTED = ["oracle", *(planted(kind, size) for kind, sizes in DEFECTS.items() for size in sizes)]
"""The methods of ``detection``."""
RESPONSES: Mapping[str, tuple[float, tuple[str, ...]]] = {
    "phase-step": (0.45, ("regularity.misplacement_p95",)),
    "slipped-course": (0.45, ("regularity.worst_tile_displacement",)),
    "stretch": (0.03, ("regularity.drift",)),
    "warp": (0.45, ("regularity.pairwise_displacement", "deformation.amplitude")),
    "off-lattice": (0.25, ("regularity.misplacement_p95",)),
    "dropped-row": (0.45, ("regularity.misplacement_p95",)),
    "doubled-row": (0.45, ("regularity.misplacement_p95",)),
    "displaced-tile": (0.45, ("regularity.worst_tile_displacement",)),
    "missing-tile": (1.0, ("regularity.worst_tile",)),
    "doubled-tile": (0.5, ("regularity.worst_tile",)),
    "two-tone": (0.5, ("integrity.broken_share",)),
    "blurred-band": (1.0, ("appearance.sharpness_worst",)),
    "seam": (0.5, ("appearance.seam",)),
    "color-mean": (1.0, ("appearance.color",)),
    "over-regular": (0.8, ("randomness.variation", "randomness.distance")),
    "verbatim": (0.5, ("randomness.repetition",)),
}
"""For each defect the size at which it saturates, and the columns that are meant for it."""

SUITES = ("core", "default", "integer", "frontier", "report2004", "spectrum")
"""The suites of textures with fresh draws that ``perils`` takes."""
TYPES = "types"
"""The textures of :func:`bent_rows`."""
PERILS = ("regularity", "integrity", "randomness")
ALARMS = (0.95, 0.75)
"""Scores of a fresh draw below these count as a false alarm and as a gross one."""
PLANTED: Mapping[str, tuple[tuple[float, ...], str, bool]] = {
    "two-tone": ((0.05, 0.1, 0.2, 0.3), "quality.integrity", False),
    "blur": ((0.25, 0.5, 0.75, 1.0), "randomness.distance", True),
    "noise": ((0.25, 0.5, 0.75, 1.0), "randomness.distance", True),
    "contrast": ((0.05, 0.1, 0.15, 0.2), "randomness.distance", True),
}
"""For each defect its sizes, the column that is meant for it, and whether the column grows with it."""

BASELINES = ("tiling", "supertile", "shuffle", "random-phase", "scatter")
HEADLINES = (
    "regularity.preserved",
    "regularity.score",
    "randomness.variation",
    "randomness.repetition",
    "randomness.distance",
)
LEAST_BAND = 20
"""Fewer fresh draws make no band."""


def texture_row(seed: int) -> Row:
    """Return a suite's row for a texture: family, rotation and regular share by the seed, the rest at random."""
    rng = stream("render", "validation", seed)
    family, rotated, share = seed % 3, seed // 3 % 2, SHARES[seed // 6 % len(SHARES)]
    model = at_share(
        random_model(family, float(rng.uniform(-45, 45)) if rotated else 0.0, rng), rng.dirichlet([1, 1, 1]), share
    )
    name = type(model).__name__.lower()
    parameters = {key: round(value, 6) for key, value in asdict(model).items() if value != getattr(type(model), key)}
    return {"name": f"{name}-{seed}", "dataset": name, "family": f"{share:.2f}", "parameters": parameters}


def random_model(family: int, rotation: float, rng: np.random.Generator) -> Model:
    """Return a brick wall, a weave or a hexagonal pattern of random periods."""
    if family == 0:
        width, height, joint = rng.uniform(22, 36), rng.uniform(11, 17), rng.uniform(1.8, 3)
        return Brick(rotation=rotation, width=width, height=height, joint=joint)
    if family == 1:
        warp, weft, gap = rng.uniform(9, 16), rng.uniform(9, 16), rng.uniform(1.2, 2.2)
        return Weave(rotation=rotation, warp=warp, weft=weft, gap=gap)
    return Hexagon(rotation=rotation, period=rng.uniform(18, 34), joint=rng.uniform(1.8, 3.2))


def at_share(model: Model, mix: NDArray[np.float64], share: float) -> Model:
    """Return the model with departures in the proportions ``mix``, as strong as the regular share allows."""

    def at(level: float) -> Model:
        color, intensity, noise = (float(min(1, level * part)) for part in 3 * mix * (1, 1, 0.3))
        return replace(model, color=color, intensity=intensity, noise=noise)

    low, high = 0.0, 1.0
    for _ in range(25):
        level = (low + high) / 2
        low, high = (level, high) if at(level).regular_share > share else (low, level)
    return at(low)


def run_study(name: str, options: argparse.Namespace, rows: list[Row], methods: list[str], **keys: Any) -> pd.DataFrame:
    """Run a study; return its table with the defect's ``kind`` and ``size``, the excesses and the ``record``."""
    content = {
        **{"name": f"validation-{name}", "seed": FIRST_SEED[options.half], "sample": "128x128", "lattice": ["given"]},
        **{"replicates": options.replicates, "texture": rows, "methods": methods},
        **keys,
    }
    out = Path(options.out) / f"{name}-{options.half}-{keys.get('size', 'own')!s}"
    chosen = nrbench.Options(jobs=options.jobs)
    run = nrbench.run(validated_suite(content, name), out=out, options=chosen, progress=show_progress)
    table = run.table()
    table["record"] = pd.Series(run.cells, dtype=object)
    table["defect"] = [record.parameters.get("kind", "none") for record in run.cells]
    table["size"] = [float(record.parameters.get("size", 0)) for record in run.cells]
    table["excess"] = [record.records.get("regularity", {}).get("excess", {}) for record in run.cells]
    table["worst_excess"] = [max(each.values(), default=np.nan) for each in table["excess"]]
    return table[table["status"] == "ok"]


def show_progress(step: Step) -> None:
    """Print a line for each hundredth cell."""
    if step.done == step.total or not step.done % 100:
        print(f"{step.done} of {step.total} cells", flush=True)


def auc(low: pd.Series[float], high: pd.Series[float]) -> float:
    """Return how often a value of ``high`` exceeds one of ``low``, ties counting half; NaN if one has no value."""
    low, high = low.dropna(), high.dropna()
    return float(mannwhitneyu(high, low).statistic) / (len(low) * len(high)) if len(low) and len(high) else np.nan


def upper_bound(events: int, trials: int) -> float:
    """Return the one-sided 95 % Clopper-Pearson bound of a rate."""
    return float(binomtest(events, trials).proportion_ci(0.9, "exact").high) if trials else 1.0


def print_head(*names: str) -> None:
    """Print the head of a Markdown table."""
    print(f"\n| {' | '.join(names)} |\n|{' --- |' * len(names)}")


def print_row(*cells: object) -> None:
    """Print a row of a Markdown table."""
    print(f"| {' | '.join(map(str, cells))} |", flush=True)


def study_alarms(options: argparse.Namespace) -> None:
    """Print false alarms and margins of fresh draws on textures of all regular shares."""
    for side in options.sides:
        fresh = run_verdicts("alarms", options, side, ["oracle"])
        print_alarms(fresh, side)
        print_margins(fresh)


def study_detection(options: argparse.Namespace) -> None:
    """Print how well each defect is detected on textures of all regular shares."""
    for side in options.sides:
        table = run_verdicts("detection", options, side, DETECTED)
        print(f"\nOutputs of {side} x {side} px.")
        print_detection(table, table[table["defect"] == "none"])


def study_perils(options: argparse.Namespace) -> None:
    """Print false alarms of the three perils on fresh draws of all models, and the quality of the baselines."""
    names = options.textures or ["*"]
    tables = []
    for suite in options.suites:
        keys: Row = {"sample": "128x128", "size": "256x256"}
        rows = bent_rows()
        if suite != TYPES:
            content = load_suite(suite).model_dump(mode="json")
            rows, keys = content["texture"], {key: content[key] for key in keys}
        rows = [row for row in rows if any(Path(row["name"]).match(name) for name in names)]
        if rows:
            table = run_study(f"perils-{suite}", options, rows, options.methods, metrics=[*PERILS, "quality"], **keys)
            tables.append(table.assign(suite=suite))
    table = pd.concat(tables, ignore_index=True)
    print_peril_alarms(table[table["method"] == "oracle"].drop_duplicates("key"))
    print_suite_quality(table)


def bent_rows() -> list[Row]:
    """Return a row of type II and one of type III for every model with a lattice: moved elements, and bent ones."""
    rows = []
    for name in sorted(set(plugins.names("datasets")) - {"images", "noise"}):
        for kind, parameters in (
            ("II", {"color": 0.0, "intensity": 0.0, "noise": 0.0, "jitter": 0.2}),
            ("III", {"color": 0.2, "intensity": 0.1, "noise": 0.02, "bend": 0.25}),
        ):
            rows.append({"name": f"{name}-{kind}", "dataset": name, "family": name, "parameters": parameters})
    return rows


def print_peril_alarms(fresh: pd.DataFrame) -> None:
    """Print how many fresh draws have a false alarm of each peril, with two-sided 95 % intervals, by type."""
    print("\nFalse alarms of fresh draws: lost (regularity), or a score below a limit; 95 % Clopper-Pearson interval.")
    print_head("type", "peril", "draws", "judged", *(f"below {limit:g}" for limit in ALARMS))
    for kind, own in [*fresh.groupby("kind"), ("all", fresh)]:
        for peril in PERILS:
            values = own[f"quality.{peril}" if peril != "regularity" else "regularity.preserved"].dropna()
            scores = values.astype(float)
            counts = [int((scores < limit).sum()) for limit in ALARMS]
            print_row(kind, peril, len(own), len(scores), *(interval(count, len(scores)) for count in counts))


def interval(events: int, trials: int) -> str:
    """Return a count with the two-sided 95 % Clopper-Pearson interval of its rate."""
    if not trials:
        return "-"
    found = binomtest(events, trials).proportion_ci(0.95, "exact")
    return f"{events} = {events / trials:.3f} ({found.low:.3f} to {found.high:.3f})"


def print_suite_quality(table: pd.DataFrame) -> None:
    """Print the mean quality of each row by suite, over textures where it is no right answer, and the largest one."""
    print("\nMean of `quality` over textures (n), and its extreme: least for the oracle, largest for a baseline.")
    methods = [name for name in ("oracle", *BASELINES) if (table["method"] == name).any()]
    right = {name: plugins.build("synthesizers", name).right_on for name in methods if name != "oracle"}
    print_head("suite", *methods)
    for suite, own in table.groupby("suite", sort=False):
        cells = []
        for method in methods:
            mine = own[(own["method"] == method) & ~own["kind"].isin(right.get(method, ()))]
            means = mine.groupby("texture")["quality.score"].apply(lambda one: one.astype(float).mean()).dropna()
            extreme = means.min() if method == "oracle" else means.max()
            cells.append(f"{means.mean():.3f} ({len(means)}) {extreme:.2f}" if len(means) else "-")
        print_row(suite, *cells)


def study_planted(options: argparse.Namespace) -> None:
    """Print how well the defects inside tiles are seen by their own columns and by quality."""
    rows = [texture_row(FIRST_SEED[options.half] + number) for number in range(6 * len(SHARES))]
    rows = [row for row in rows if float(row["family"]) >= 0.5]
    rows = rows[:: max(len(rows) // options.count, 1)]
    methods = ["oracle", *(planted(kind, size) for kind, (sizes, *_) in PLANTED.items() for size in sizes)]
    side = f"{options.sides[0]}x{options.sides[0]}"
    table = run_study("planted", options, rows, methods, size=side, metrics=[*PERILS, "quality"])
    fresh = table[table["defect"] == "none"]
    print(f"\n{len(rows)} textures of {side} px, {len(fresh)} fresh draws. AUC over all images (n with a value).")
    print("Where an own column has no value, elements have no tones. The last AUC leaves these images out.")
    print_head("defect", "size", "column", "AUC", "AUC of `quality`", "of `quality` where known", "mean `quality`")
    for kind, (sizes, column, grows) in PLANTED.items():
        for size in sizes:
            own = table[(table["defect"] == kind) & np.isclose(table["size"], size)]
            cells, known = [], [one[one[column].notna()] for one in (fresh, own)]
            for name, sign, some in (
                (column, 1 if grows else -1, (fresh, own)),
                ("quality.score", -1, (fresh, own)),
                ("quality.score", -1, known),
            ):
                pair = [sign * one[name].astype(float) for one in some]
                cells.append(f"{auc(*pair):.3f} ({pair[1].notna().sum()})")
            print_row(kind, f"{size:g}", f"`{column}`", *cells, f"{own['quality.score'].astype(float).mean():.3f}")
    print("\nSpearman's correlation with the size, fresh draws as size 0: mean over textures (least); over all.")
    print_head("defect", "column", "within a texture", "over all", "`quality` within a texture", "over all")
    for kind, (_, column, _) in PLANTED.items():
        own = table[(table["defect"] == kind) | (table["defect"] == "none")]
        cells = []
        for name in (column, "quality.score"):
            judged = own[own[column].notna()]
            values = [rank_correlation(one, name) for _, one in judged.groupby("texture")]
            cells += [
                f"{np.nanmean(values):+.3f} ({min(values, key=abs):+.3f})",
                f"{rank_correlation(judged, name):+.3f}",
            ]
        print_row(kind, f"`{column}`", *cells)


def rank_correlation(table: pd.DataFrame, column: str) -> float:
    """Return Spearman's correlation of the size with a column; 0 if the column has one value only."""
    values = table[column].astype(float)
    known = values.notna()
    return float(spearmanr(table["size"][known], values[known]).statistic) if values.nunique() > 1 else 0.0


def run_verdicts(name: str, options: argparse.Namespace, side: int, methods: list[str]) -> pd.DataFrame:
    """Return the table of ``regularity`` and ``integrity`` on textures of all regular shares."""
    rows = [texture_row(FIRST_SEED[options.half] + number) for number in range(options.count)]
    return run_study(name, options, rows, methods, size=f"{side}x{side}", metrics=["regularity", "integrity"])


def print_alarms(fresh: pd.DataFrame, side: int) -> None:
    """Print how many fresh draws have a fault, with the one-sided 95 % bound of the rate."""
    print(f"\nFalse alarms: fresh draws of {side} x {side} px.")
    print_head("share", "n", "lost", "95 % bound", "undecided", "not intact", "n integrity", "broken", "95 % bound")
    for share, own in [*fresh.groupby("family"), ("all", fresh)]:
        kept, tiles = own["regularity.preserved"], own["integrity.broken_tiles"].dropna()
        lost, broken = int((kept == False).sum()), int((tiles > 0).sum())  # noqa: E712
        intact = int((own["regularity.intact"] == False).sum())  # noqa: E712
        print_row(
            *(share, len(own), lost, f"{upper_bound(lost, len(own)):.4f}", int(kept.isna().sum()), intact),
            *(len(tiles), broken, f"{upper_bound(broken, len(tiles)):.4f}"),
        )


def print_margins(fresh: pd.DataFrame) -> None:
    """Print how near fresh draws come to each limit; above 1 is a false alarm."""
    print("\nExcess over each limit on fresh draws: 99th percentile, largest. Above 1 is a false alarm.")
    names = list(fresh["excess"].iloc[0])
    print_head("share", "n", *names)
    for share, own in fresh.groupby("family"):
        values = pd.DataFrame(list(own["excess"]))
        print_row(share, len(own), *(f"{values[name].quantile(0.99):.2f}, {values[name].max():.2f}" for name in names))


def print_detection(table: pd.DataFrame, fresh: pd.DataFrame) -> None:
    """Print AUC, number of images, and shares called lost and undecided, by defect and regular share."""
    print("\nDetection: AUC of the worst excess (n) lost / undecided; two-tone: AUC of broken tiles (n) found.")
    shares = sorted(fresh["family"].unique(), reverse=True)
    print_head("defect", "size", *shares)
    for kind, sizes in DEFECTS.items():
        for size in sizes:
            own = table[(table["defect"] == kind) & np.isclose(table["size"], size)]
            cells = (detection(fresh[fresh["family"] == share], own[own["family"] == share], kind) for share in shares)
            print_row(kind, f"{size:g}", *cells)


def detection(fresh: pd.DataFrame, defective: pd.DataFrame, kind: str) -> str:
    """Return a cell of the table of detection."""
    if defective.empty:
        return "-"
    if kind == "two-tone":
        column = "integrity.broken_tiles"
        held = defective[column].dropna()
        return f"{auc(fresh[column], held):.3f} ({len(held)}) {(held > 0).mean():.2f}" if len(held) else "undecided"
    kept = defective["regularity.preserved"]
    value = auc(fresh["worst_excess"], defective["worst_excess"])
    return f"{value:.3f} ({len(kept)}) {(kept == False).mean():.2f} / {kept.isna().mean():.2f}"  # noqa: E712


def study_without_model(options: argparse.Namespace) -> None:
    """Print the tables of ``detection`` for outputs that are judged by their sample and its lattice alone."""
    for side in options.sides:
        rows = []
        for _, row in run_verdicts("detection", options, side, DETECTED).iterrows():
            score = Regularity().score(bare_observation(row["record"]))
            excess = score.records.get("excess", {})
            values = {f"regularity.{name}": value for name, value in score.values.items()}
            worst = max(excess.values(), default=np.nan)
            known = {"excess": excess, "worst_excess": worst, "integrity.broken_tiles": np.nan}
            rows.append({**row[["family", "defect", "size"]], **known, **values})
        table = pd.DataFrame(rows)
        fresh = table[table["defect"] == "none"]
        print_alarms(fresh, side)
        print_detection(table, fresh)


def bare_observation(record: CellRecord, gray: bool = False) -> Observation:
    """Return the output of a cell with its sample and the lattice alone, in color or as the mean of the channels."""
    sample, output = (read_image(record.folder / f"{name}.png") for name in ("sample", "output"))
    if gray:
        sample, output = (quantize(np.repeat(each.mean(-1, keepdims=True), 3, -1)) for each in (sample, output))
    lattice = record.cell.lattice_truth
    return Observation(sample, output, Texture(sample, lattice, (lattice,) if lattice else ()))


SMALL_PICTURE = 400
"""Pictures with a shorter side are cut in halves, px."""
SMALLEST_SCORE = 0.95
"""Least score of integrity of a fresh draw."""


def study_photographs(options: argparse.Namespace) -> None:
    """Print the verdict and the integrity of photographs' own regions, and of random tiles of them."""
    names = ("photograph", "sample", "own region: preserved", "integrity", "power", "shuffle: preserved", "integrity")
    print_head(*names, "power", "reason")
    folder, truth = Path(options.pictures), pd.read_csv(Path(options.pictures) / "truth.csv")
    for _, row in truth.dropna(subset=["t1x"]).iterrows():
        picture = read_image(folder / row["file"])
        lattice = nrbench.Lattice((row["t1x"], row["t1y"]), (row["t2x"], row["t2y"]))
        height, width = picture.shape[:2]
        small = min(height, width) < SMALL_PICTURE
        tall = height // 2 if height >= width or not small else height
        wide = width // 2 if width > height or not small else width
        sample, region = quantize(picture[:tall, :wide]), quantize(picture[-tall:, -wide:])
        cells, reason = [], ""
        for output in (region, shuffle_sample(sample, lattice)):
            if output is None:
                cells += ["refused", "-", "-"]
                continue
            scores = sample_scores(Observation(sample, output, Texture(sample, lattice, (lattice,))))
            cells += [show_verdict(scores["preserved"]), show_value(scores["score"]), show_value(scores["power"])]
            reason = scores["reason"] or reason
        print_row(Path(row["file"]).stem, f"{wide} x {tall}", *cells, reason)


def shuffle_sample(sample: Image, lattice: nrbench.Lattice) -> Image | None:
    """Return random tiles of a sample, joined edge to edge at twice its sides; None if it holds no whole tile."""
    try:
        made = nrbench.synthesize(
            "shuffle", sample, (2 * sample.shape[0], 2 * sample.shape[1]), lattice=lattice, seed=0
        )
    except nrbench.Refused:
        return None
    return quantize(made.image)


def sample_scores(observation: Observation) -> Row:
    """Return the verdict and the integrity of an output that is judged by its sample and the lattice."""
    integrity = Integrity().score(observation)
    return {
        "preserved": Regularity().score(observation).values["preserved"],
        "score": integrity.values["score"],
        "power": integrity.values["detection_power"],
        "reason": integrity.reasons.get("score", ""),
    }


def show_verdict(preserved: bool | None) -> str:
    """Return the verdict in words."""
    return "undecided" if preserved is None else "preserved" if preserved else "lost"


def show_value(value: float | None) -> str:
    """Return a value with two decimals, or a dash."""
    return "-" if value is None else f"{value:.2f}"


def study_sample_integrity(options: argparse.Namespace) -> None:
    """Print how integrity without a model judges fresh draws and outputs with broken elements."""
    rows = []
    for suite in ("core", "report2004"):
        own = [row for row in load_suite(suite).model_dump(mode="json")["texture"] if not row["parameters"].get("bend")]
        rows += [{key: value for key, value in row.items() if key not in ("sample", "size")} for row in own]
    rows = rows[:: max(len(rows) // options.count, 1)]
    methods = ["oracle", planted("two-tone", 0.3), "shuffle", "rsgf:block=20,border=5,seam=blend,subpixel=false"]
    sizes = {"sample": "256x256", "size": "256x256"}
    made = run_study("sample-integrity", options, rows, methods, metrics=["cost"], **sizes)
    table = pd.DataFrame(
        {"method": record.method, "color": color, **sample_scores(bare_observation(record, color == "gray"))}
        for record in made["record"]
        if record.cell.lattice_truth is not None
        for color in ("color", "gray")
    )
    names = ("output", "n", "verdict", "integrity speaks", "median power", "median score", "least, largest")
    print_head("", *names, f"below {SMALLEST_SCORE}", "AUC against fresh draws")
    for color, own in table.groupby("color"):
        fresh = own.loc[own["method"] == "oracle", "score"].astype(float)
        for method, some in own.groupby("method", sort=False):
            judged, score = some["preserved"].notna().sum(), some["score"].astype(float)
            known = score.dropna()
            values = [f"{known.median():.2f}", f"{known.min():.2f}, {known.max():.2f}"] if len(known) else ["-", "-"]
            below = int((known < SMALLEST_SCORE).sum())
            power = show_value(some["power"].astype(float).median())
            cells = (len(some), judged, len(known), power, *values, below, f"{auc(-fresh, -known):.3f}")
            print_row(color, method, *cells)


def study_response(options: argparse.Namespace) -> None:
    """Print how the columns follow the size of the defect that they are meant for."""
    rows = [texture_row(FIRST_SEED["report"] + number) for number in RESPONSE_TEXTURES]
    steps = [(kind, most * step / 8) for kind, (most, _) in RESPONSES.items() for step in range(1, 9)]
    side = f"{options.sides[0]}x{options.sides[0]}"
    table = run_study("response", options, rows, [planted(*step) for step in steps], size=side)
    print_head("defect", "column", "up to", *(row["name"] for row in rows))
    for kind, (most, columns) in RESPONSES.items():
        for column in columns:
            cells = []
            for row in rows:
                own = table[(table["texture"] == row["name"]) & (table["defect"] == kind)]
                cells.append(correlation(own["size"], own[column]))
            print_row(kind, column, f"{most:g}", *cells)


def correlation(sizes: pd.Series[float], values: pd.Series[float]) -> str:
    """Return Spearman's correlation, the number of images, and the median values at the least and the largest size."""
    known = values.notna()
    sizes, values = sizes[known].astype(float), values[known].astype(float)
    if values.nunique() < 2:
        return "-"
    low, high = (values[sizes == end].median() for end in (sizes.min(), sizes.max()))
    return f"{spearmanr(sizes, values).statistic:+.3f} ({len(values)}) {low:.3f} to {high:.3f}"


def study_silence(options: argparse.Namespace) -> None:
    """Print which columns respond to which defects."""
    rows = [texture_row(FIRST_SEED["report"] + number) for number in RESPONSE_TEXTURES]
    middle = {kind: sizes[len(sizes) // 2] for kind, sizes in DEFECTS.items()}
    side = f"{options.sides[0]}x{options.sides[0]}"
    methods = ["oracle", *(planted(kind, size) for kind, size in middle.items())]
    table = run_study("silence", options, rows, methods, size=side)
    columns = [name for name in table if str(name).partition(".")[0] in output_metrics() and table[name].nunique() > 2]
    columns = [name for name in columns if ".sample_" not in str(name)]
    print_head("column", "none", *(f"{kind} {size:g}" for kind, size in middle.items()))
    for column in columns:
        print_row(f"`{column}`", *(outside_share(table, str(column), kind) for kind in ("none", *middle)))


def output_metrics() -> set[str]:
    """Return the names of the metrics that measure an output, costs and what rests on the method's word aside."""
    return set(plugins.names("metrics")) - {"cost", "source", "lattice_recovery"}


def outside_share(table: pd.DataFrame, column: str, kind: str) -> str:
    """Return the share of images outside the 95 % prediction interval of fresh draws of the same texture."""
    outside: list[bool] = []
    for _, own in table.groupby("texture"):
        fresh = own.loc[own["defect"] == "none", column].astype(float).dropna()
        for index, value in own.loc[own["defect"] == kind, column].astype(float).dropna().items():
            others = fresh.drop(index) if kind == "none" else fresh
            if len(others) > 1:
                reach = student.ppf(0.975, len(others) - 1) * others.std() * np.sqrt(1 + 1 / len(others))
                outside.append(bool(abs(value - others.mean()) > max(reach, 1e-9)))
    return f"{np.mean(outside):.2f} ({len(outside)})" if outside else "-"


def study_bends(options: argparse.Namespace) -> None:
    """Print how fresh draws, phase steps and straightened draws of bent textures are judged."""
    outputs = "fresh: preserved, lost, undecided", "step of 0.25 s: lost, undecided", "not bent: too regular"
    print_head("texture", "bend", "px", "n", *outputs, "amplitude of fresh draws", "quality of a fresh draw")
    for side in options.sides:
        for bend in options.bends:
            for kind in (Brick, Weave, Hexagon):
                judge_bent(kind(color=0.2, noise=0.03, bend=bend), side, options)


def judge_bent(model: Model, side: int, options: argparse.Namespace) -> None:
    """Print a row of the table of :func:`study_bends`."""
    name, shape = type(model).__name__.lower(), (side, side)
    fresh, steps, straight, amplitudes, quality = [], [], [], [], None
    for number in range(options.replicates):
        seed = FIRST_SEED[options.half] + number
        sample = model.render((128, 128), stream("render", f"bends-{name}", seed))
        sample = replace(sample, image=quantize(sample.image))

        def again(wanted: Shape, k: int, sample: Texture = sample, seed: int = seed) -> Texture:
            return model.again(sample, wanted, stream("again", f"bends-{name}", seed, k))

        assert sample.lattice is not None
        reference = bent_reference_from_model(sample, sample.lattice, again)
        task = Task(sample.image, shape, None, stream("synthesis", f"bends-{name}", seed), again=again)
        still = replace(model, bend=0.0).again(sample, shape, stream("again", f"bends-{name}", seed, "still"))
        images = again(shape, 0).image, Planted("phase-step", 0.25).synthesize(task).image, still.image
        judged = [compute_bent_verdict(quantize(np.clip(image, 0, 1)), reference) for image in images]
        fresh.append(judged[0].preserved)
        amplitudes.append(judged[0].amplitude_ratio)
        steps.append(judged[1].preserved)
        straight.append(judged[2].preserved is not False and judged[2].too_regular)
        if not number:
            observation = Observation(sample.image, quantize(images[0]), sample, again=again)
            quality = Quality().score(observation).values["score"]
    verdicts = ", ".join(str(fresh.count(one)) for one in (True, False, None))
    found = f"{steps.count(False)}, {steps.count(None)}"
    spread = f"{min(amplitudes):.2f} to {max(amplitudes):.2f}"
    print_row(name, model.bend, side, len(fresh), verdicts, found, sum(straight), spread, show_value(quality))


def study_variation(options: argparse.Namespace) -> None:
    """Print whether outputs of methods vary as the texture does, and as an ideal copier of the same sample."""
    rows = load_suite("core").model_dump(mode="json")["texture"][: options.count]
    methods = list(dict.fromkeys(["oracle", "copier", *options.methods]))
    table = run_study("variation", options, rows, methods, metrics=["regularity", "randomness"])
    table["defect"] = table["method"].replace("oracle", "none")
    table["variation"] = table["randomness.variation"].astype(float)
    sample = ["texture", "replicate"]
    copier = table[table["method"] == "copier"].set_index(sample)["variation"]
    table["ratio"] = table["variation"] / copier.reindex(pd.MultiIndex.from_frame(table[sample])).to_numpy()
    print_head("method", "variation", "outside of fresh draws (n)", "over the copier's", "95 % interval over textures")
    for method, own in table.groupby("method", sort=False):
        ratios = own.groupby("texture")["ratio"].mean().dropna()
        reach = student.ppf(0.975, len(ratios) - 1) * ratios.std() / np.sqrt(len(ratios))
        outside = outside_share(table, "variation", own["defect"].iloc[0])
        interval = f"{ratios.mean() - reach:.2f} to {ratios.mean() + reach:.2f}"
        print_row(method, f"{own['variation'].mean():.2f}", outside, f"{ratios.mean():.2f}", interval)


def study_references(options: argparse.Namespace) -> None:
    """Print where a second set of fresh draws and the baselines lie."""
    names = options.textures or ["*"]
    for suite in ("core", "report2004"):
        rows = [
            row
            for row in load_suite(suite).model_dump(mode="json")["texture"]
            if any(Path(row["name"]).match(name) for name in names) and not row["parameters"].get("bend")
        ][: options.count]
        metrics = ["regularity", "randomness"]
        table = run_study(f"references-{suite}", options, rows, ["oracle", *BASELINES], metrics=metrics)
        table[list(HEADLINES)] = table[list(HEADLINES)].astype(float)
        print_head("texture", "n", "second set in the band", *BASELINES)
        for texture, own in table.groupby("texture", sort=False):
            fresh = own[own["method"] == "oracle"]
            cells = (escape(fresh, own[own["method"] == name]) for name in BASELINES)
            print_row(texture, len(fresh), second_set(fresh), *cells)


def second_set(fresh: pd.DataFrame) -> str:
    """Return the share of the odd draws that lie in the 95 % band of the even ones, over all columns."""
    inside = [
        band(fresh[column].iloc[::2], 0.95)(fresh[column].iloc[1::2].dropna())
        for column in HEADLINES
        if fresh[column].iloc[::2].notna().sum() >= LEAST_BAND and fresh[column].nunique() > 2
    ]
    return f"{np.concatenate(inside).mean():.3f}" if inside else f"fewer than {LEAST_BAND} draws"


def escape(fresh: pd.DataFrame, outputs: pd.DataFrame) -> str:
    """Return the columns in which all outputs of a baseline lie outside the 99 % band of fresh draws."""
    if outputs.empty or fresh["regularity.score"].notna().sum() < LEAST_BAND:
        return "refused" if outputs.empty else "too few draws"
    outside = [
        column.partition(".")[2]
        for column in HEADLINES
        if fresh[column].notna().sum() >= LEAST_BAND
        and len(values := outputs[column].dropna())
        and not band(fresh[column], 0.99)(values).any()
    ]
    return ", ".join(outside) or "ESCAPES"


def band(values: pd.Series[float], level: float) -> Callable[[pd.Series[float]], NDArray[np.bool_]]:
    """Return a test of whether further values lie in the middle ``level``: between order statistics.

    The r-th of n draws has r / (n + 1) of all further ones below it, whatever their distribution.
    """
    tail = (1 - level) / 2
    low, high = np.quantile(values.dropna(), [tail, 1 - tail], method="weibull")
    return lambda further: np.asarray(further.between(low, high))


STUDIES: Mapping[str, Callable[[argparse.Namespace], None]] = {
    "alarms": study_alarms,
    "detection": study_detection,
    "perils": study_perils,
    "planted": study_planted,
    "without-model": study_without_model,
    "photographs": study_photographs,
    "sample-integrity": study_sample_integrity,
    "response": study_response,
    "silence": study_silence,
    "bends": study_bends,
    "variation": study_variation,
    "references": study_references,
}


def main() -> None:
    """Run the studies, and print their tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", nargs="+", choices=STUDIES)
    parser.add_argument("--count", type=int, default=36, help="textures; multiples of 36 hold each kind equally often")
    parser.add_argument("--replicates", type=int, default=3, help="samples of each texture, and outputs of each method")
    parser.add_argument("--sides", type=int, nargs="+", default=[256], help="width and height of the outputs in px")
    parser.add_argument("--half", choices=FIRST_SEED, default="report", help="which textures and seeds")
    parser.add_argument("--bends", type=float, nargs="+", default=[0.25, 0.5, 1.0], help="of bends: strengths")
    parser.add_argument("--textures", nargs="*", help="of references: patterns of texture names")
    parser.add_argument("--pictures", help="of photographs: a folder with truth.csv")
    parser.add_argument("--suites", nargs="*", default=[*SUITES, TYPES], help="of perils")
    parser.add_argument("--methods", nargs="*", default=["oracle"], help="of perils, variation")
    parser.add_argument("--jobs", type=int, default=2, help="cells at the same time")
    parser.add_argument("--out", default="runs/validation", help="where the runs lie")
    options = parser.parse_args()
    for study in options.study:
        print(f"\n# {study}")
        STUDIES[study](options)


if __name__ == "__main__":
    main()
