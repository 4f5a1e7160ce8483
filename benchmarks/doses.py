"""Dose against score: how strong an edit must be before the judge minds it, and before labelers see it.

``python benchmarks/doses.py sheets FOLDER`` writes numbered pairs of pictures in random order, six a sheet, and
``key.csv``, which says what each pair is: a fresh draw, and another one that is edited or not.

``python benchmarks/doses.py plot PICTURE.svg`` judges the same edited draws, prints one table, and draws the mean
quality by dose, with the range over the textures. A dashed line stands at the dose at which labelers begin to see the
edit: the smallest dose from which on at least half of the answers call it wrong. Three defects that are planted in
other textures (``validation.py``) have panels as well; no labeler saw them.

``labels/doses.csv`` holds the answers of two vision-language models, who saw the sheets alone. They answered for
each pair: could the right picture be another photograph of what the left one shows (0), or is something wrong (1)?
"""

import zlib
from collections.abc import Iterator
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from edits import apply_edit
from PIL import Image as Pillow
from PIL import ImageDraw
from studies import read_options
from validation import SIZE, Subject, plant, planted_subject, print_table, show, subjects

from nrbench.imaging.convert import Image
from nrbench.streams import stream

LABELS = Path(__file__).parent / "labels" / "doses.csv"
TEXTURES = ("brick-rotated", "weave-rotated", "hexagon-weathered")
DOSES = {
    "JPEG 4:2:0, quality": (60, 30, 18, 10, 6),
    "gray grain, levels": (4, 8, 12, 18, 25),
    "smooth chroma, levels": (2, 5, 8, 12, 20),
    "blur, px": (0.6, 0.9, 1.2, 1.6, 2.2),
    "turned, degrees": (0.5, 1, 2, 3, 5),
    "brighter, levels": (4, 8, 14, 20, 30),
    "warmer, levels": (3, 6, 10, 15, 22),
    "contrast": (0.95, 0.85, 0.75, 0.65, 0.5),
    "step of light": (0.03, 0.06, 0.09, 0.12, 0.16),
    "blurred hole, cells": (0.3, 0.6, 1, 1.4, 2),
    "half slipped along rows, s": (0.05, 0.1, 0.15, 0.2, 0.3),
}
"""The doses of each edit, from what nobody sees to what everybody sees."""
DEFECTS = {
    "new color, share of tiles": ("new-color", "tints", (0.01, 0.03, 0.1, 0.3, 1)),
    "torn, share of tiles": ("torn", "equal", (0.01, 0.03, 0.1, 0.3, 1)),
    "wrong surface, share of variance": ("wrong-surface", "material", (0.1, 0.3, 0.5, 0.7, 1)),
}
"""The kind of each defect, the textures in which it is one, and its sizes."""
SEEDS = (200_003, 200_009, 200_011)
"""One texture of each family, of regular shares 0.55, 0.4 and 0.8."""
UNEDITED = "unedited"
CONTROLS = 5
"""Unedited pairs of each texture."""
A_SHEET = 6
SHOWN = 240
"""Side of the pictures of a pair, px: a slip makes a picture narrower."""


def edited_draws(subject: Subject) -> Iterator[tuple[str, float, Image]]:
    """Yield edit, dose and picture: each edit at each dose, and unedited draws."""
    for number in range(CONTROLS):
        yield UNEDITED, 0, subject.draw(number + 2)
    picture = subject.draw(0)
    for edit, doses in DOSES.items():
        for dose in doses:
            rng = np.random.default_rng(zlib.crc32(f"{subject.name} {edit} {dose}".encode()))
            yield edit, dose, apply_edit(edit, dose, picture, subject.vectors, rng)


def planted_draws() -> Iterator[tuple[str, float, Subject, Image]]:
    """Yield defect, size, texture and picture."""
    for name, (kind, textures, sizes) in DEFECTS.items():
        for seed in SEEDS:
            subject = planted_subject(seed, textures)[1]
            for size in sizes:
                picture = plant(subject, kind, size, stream("synthesis", "doses", seed, kind))
                if picture is not None:
                    yield name, size, subject, picture


def write_sheets(folder: Path) -> None:
    """Write the pairs, and the key to their numbers."""
    folder.mkdir(parents=True, exist_ok=True)
    pairs = [(each, *edited) for each in subjects("default", TEXTURES) for edited in edited_draws(each)]
    order = np.random.default_rng(1).permutation(len(pairs))
    key = [
        {"number": n, "texture": pairs[k][0].name, "edit": pairs[k][1], "dose": pairs[k][2]}
        for n, k in enumerate(order)
    ]
    pd.DataFrame(key).to_csv(folder / "key.csv", index=False)
    for first in range(0, len(pairs), A_SHEET):
        sheet = Pillow.new("RGB", (4 * SIZE[1] + 60, A_SHEET // 2 * (SIZE[0] + 20)), "white")
        for place, number in enumerate(range(first, min(first + A_SHEET, len(pairs)))):
            subject, _, _, edited = pairs[order[number]]
            left, top = place % 2 * (2 * SIZE[1] + 40), place // 2 * (SIZE[0] + 20)
            ImageDraw.Draw(sheet).text((left, top + 4), f"pair {number}", fill="black")
            for k, picture in enumerate((subject.draw(1), edited)):
                pixels = np.rint(picture[:SHOWN, :SHOWN] * 255).astype(np.uint8)
                sheet.paste(Pillow.fromarray(pixels), (left + k * (SIZE[1] + 10), top + 18))
        sheet.save(folder / f"sheet-{first // A_SHEET:02}.png")


def seen_from(labels: pd.DataFrame, edit: str) -> float | None:
    """Return the smallest dose of an edit from which on at least half of the answers are "wrong"; None if none is."""
    own = labels[labels["edit"] == edit]
    seen = own.groupby("dose")[["first_wrong", "second_wrong"]].mean().mean(axis=1).reindex(DOSES[edit]) >= 0.5
    from_here = seen[::-1].cummin()[::-1]
    return float(from_here.index[from_here][0]) if from_here.any() else None


def plot_doses(path: Path) -> None:
    """Judge the edited draws, print the table, and draw one panel for each edit."""
    rows = []
    for subject in subjects("default", TEXTURES):
        rows += [
            {"edit": edit, "dose": dose, **subject.judge(picture)} for edit, dose, picture in edited_draws(subject)
        ]
    rows += [{"edit": name, "dose": size, **subject.judge(picture)} for name, size, subject, picture in planted_draws()]
    scores = pd.DataFrame(rows).astype({"score": float}).groupby(["edit", "dose"])["score"].agg(["mean", "min", "max"])
    labels = pd.read_csv(LABELS)
    wrong = labels.loc[labels["edit"] == UNEDITED, ["first_wrong", "second_wrong"]].mean()
    print(f"unedited draws: quality {show(scores.loc[UNEDITED, 'mean'].item())}, called wrong {wrong.mean():.2f}")
    tell = print_table("edit", "dose: mean quality", "labelers see it from")
    panels = DOSES | {name: sizes for name, (*_, sizes) in DEFECTS.items()}
    figure, axes = plt.subplots(3, 5, figsize=(15, 7.5), layout="constrained", sharey=True)
    for axis, (edit, doses) in zip(axes.flat, panels.items(), strict=False):
        own, threshold = scores.loc[edit].reindex(doses), seen_from(labels, edit) if edit in DOSES else None
        places = range(len(doses))
        axis.fill_between(places, own["min"], own["max"], alpha=0.25, linewidth=0)
        axis.plot(places, own["mean"], marker="o")
        if threshold is not None:
            axis.axvline(doses.index(threshold), color="0.3", linestyle="--")
        axis.set(title=edit, xticks=places, xticklabels=[f"{dose:g}" for dose in doses], ylim=(-0.03, 1.03))
        tell(edit, ", ".join(f"{dose:g}: {show(own['mean'][dose])}" for dose in doses), threshold or "-")
    axes.flat[len(panels)].axis("off")
    figure.supylabel("quality: mean and range of three textures")
    figure.savefig(path)


def main() -> None:
    """Write the sheets, or draw the plot."""
    tasks = {"sheets": write_sheets, "plot": plot_doses}
    options = read_options(__doc__, ["task", "path"], {"task": tasks}, task="plot", path=Path("doses.svg"))
    tasks[options.task](options.path)


if __name__ == "__main__":
    main()
