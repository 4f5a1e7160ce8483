r"""Write the gallery page from a run: docs/gallery.md, and docs/gallery/ with one picture for each texture.

The page of the repository is from this run::

    nrbench run core -t brick-strong -t weave-middle -t hexagon-middle-rotated -m oracle -m rsgf -m tile-set \
        -m fftm-patch -m graph-cuts -m quilting -m tiling --lattice given --out runs/gallery
    python docs/make_gallery.py runs/gallery
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

from nrbench import Run, load
from nrbench.imaging.files import read_image
from nrbench.runs.records import CellRecord

HERE = Path(__file__).parent
COLUMNS = 4
MARKS = {True: "preserved", False: "LOST", None: "undecided"}


def caption(record: CellRecord) -> str:
    """Return the method, the verdict and the quality of an output."""
    quality = record.values.get("quality.score")
    number = "" if quality is None else f", quality {quality:.2f}"
    return f"{record.method}\nlattice {MARKS[record.values.get('regularity.preserved')]}{number}"


def draw(records: list[CellRecord], path: Path) -> None:
    """Draw the sample and the outputs of one texture."""
    rows = -(-(len(records) + 1) // COLUMNS)
    figure, axes = plt.subplots(rows, COLUMNS, figsize=(11, 3.1 * rows))
    pictures = [("sample", records[0].folder / "sample.png"), *((caption(r), r.folder / "output.png") for r in records)]
    for axis in np.ravel(axes):
        axis.set_axis_off()
    for axis, (title, file) in zip(np.ravel(axes), pictures, strict=False):
        axis.imshow(np.squeeze(read_image(file)), interpolation="nearest", cmap="gray", vmin=0, vmax=1)
        axis.set_title(title, fontsize=9)
    figure.tight_layout()
    figure.savefig(path, dpi=80, pil_kwargs={"quality": 82})
    plt.close(figure)


def page(run: Run) -> str:
    """Return the page, and draw its pictures."""
    lines = [
        "# Gallery",
        "",
        f"Outputs on textures of the suite `{run.info['suite']['name']}`, with the lattice given.",
        "They show what methods do; scores of the present version may differ.",
        "In each picture the sample comes first. A method that refused the texture is left out.",
        "",
        "The page is made by `python docs/make_gallery.py RUN`.",
    ]
    (HERE / "gallery").mkdir(exist_ok=True)
    for texture in dict.fromkeys(record.texture for record in run.cells):
        made = [record for record in run.cells if record.texture == texture and record.status == "ok"]
        if made:
            draw(made, HERE / "gallery" / f"{texture}.jpg")
            about = made[0].cell.description
            lines += [
                "",
                f"## {texture}",
                "",
                about,
                "",
                f"![{texture}: the sample and the outputs](gallery/{texture}.jpg)",
            ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    (HERE / "gallery.md").write_text(page(load(sys.argv[1])), "utf-8")
