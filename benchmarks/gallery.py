"""Write the gallery: a page for each method, each texture model and each of the four perils.

``python benchmarks/gallery.py [FOLDER]`` runs every method on seven textures and on the first two pictures of a folder,
draws every texture model with each of its departures, plants defects of growing size, and writes pages and pictures to
``docs/gallery/``. ``make docs`` calls it (``make docs PHOTOGRAPHS=FOLDER``); no photograph comes with the project. The
runs are kept in ``runs/gallery`` and resumed, so that only what changed is computed again.
"""

import os
import shutil
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from statistics import median
from typing import Any

import nrbench
from nrbench import CellRecord, Run, plugins
from nrbench.imaging.convert import quantize
from nrbench.pictures.files import list_pictures, read_image, write_image
from nrbench.plugins.registry import find, parameters_of
from nrbench.suites.suite import Suite

ROOT = Path(__file__).parents[1]
PAGES, RUNS = ROOT / "docs" / "gallery", ROOT / "runs" / "gallery"
PERILS = ("regularity", "integrity", "randomness", "appearance")
SAMPLE, OUTPUT = 128, 256
BROKEN = 0.5
"""Below this a peril is named under "where it fails"."""
BRICK, WEAVE = {"width": 27.3, "height": 12.2}, {"warp": 12.3, "weft": 13.9, "gap": 1.5}
TEXTURES: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    "brick": ("brick", {**BRICK, "color": 0.3, "intensity": 0.15, "noise": 0.04}),
    "brick-clay": ("brick", {**BRICK, "color": 0.15, "material": "clay"}),
    "brick-bent": ("brick", {**BRICK, "color": 0.3, "bend": 0.5}),
    "weave": ("weave", {**WEAVE, "color": 0.2, "noise": 0.03}),
    "weave-cloth": ("weave", {**WEAVE, "color": 0.2, "material": "cloth"}),
    "hexagon": ("hexagon", {"period": 26.2, "joint": 2.4, "color": 0.25, "noise": 0.04, "rotation": 17.3}),
    "hexagon-stone": ("hexagon", {"period": 26.2, "joint": 2.4, "color": 0.2, "material": "stone"}),
}
"""Name, model and parameters of the textures on the pages of methods. """
METHODS_LEFT_OUT = ("command", "precomputed", "planted", "lattice-only")
"""Methods that need a program, a folder or a defect."""
DEPARTURES: Mapping[str, tuple[Any, ...]] = {
    "color": (0.2, 0.6),
    "intensity": (0.2, 0.6),
    "noise": (0.05, 0.2),
    "light": (0.3, 0.9),
    "damage": (0.2, 0.5),
    "missing": (0.1, 0.3),
    "jitter": (0.3, 0.6),
    "bend": (0.5, 1.0),
    "material": ("clay", "stone", "wood", "cloth"),
}
"""Parameters of every texture model that are turned up one by one, all others being zero."""
LADDERS: Mapping[str, Mapping[str, tuple[float, ...]]] = {
    "regularity": {"phase-step": (0.05, 0.15, 0.5), "off-lattice": (0.05, 0.15, 0.4), "dropped-row": (0.1, 0.3, 0.5)},
    "integrity": {"two-tone": (0.03, 0.1, 0.5), "torn": (0.03, 0.1, 0.5), "doubled-tile": (0.1, 0.3, 0.5)},
    "randomness": {"over-regular": (0.3, 0.6, 1), "verbatim": (0.2, 0.4, 1)},
    "appearance": {
        "blur": (0.4, 0.7, 1),
        "contrast": (0.1, 0.3, 0.6),
        "color-mean": (0.02, 0.1, 0.3),
        "wrong-surface": (0.3, 0.6, 1),
        "new-color": (0.03, 0.1, 0.3),
        "seam": (0.03, 0.1, 0.3),
    },
}
"""Kinds and sizes of the planted defects that the page of a peril shows."""
LADDER_TEXTURES = ("brick", "hexagon-stone")


def main() -> None:
    """Make the runs, and write all pages."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    shutil.rmtree(PAGES, ignore_errors=True)
    for part in ("methods", "textures", "perils"):
        (PAGES / part / "pictures").mkdir(parents=True)
    write_methods(list(photograph_rows(Path(sys.argv[1]))) if sys.argv[1:] else [])
    write_textures()
    write_perils()


# ------------------------------------------------------------------ methods


def write_methods(photographs: list[dict[str, Any]]) -> None:
    """Write a page for each method: its outputs, what it costs, where it fails, its parameters and its BibTeX."""
    names = [name for name in plugins.names("synthesizers") if name not in METHODS_LEFT_OUT]
    run = make_run("methods", [*texture_rows(), *photographs], names)
    for name in names:
        cells = [record for record in run.cells if record.method == name]
        lines = [
            f"Each output has {OUTPUT} x {OUTPUT} px. The sample of {SAMPLE} x {SAMPLE} px stands before it, at the "
            "same magnification. Lattices are given; those of photographs were detected.",
            "",
            *(line for record in cells for line in show_cell(record, PAGES / "methods")),
            "## What it costs",
            "",
            describe_cost(cells),
            "",
            "## Where it fails",
            "",
            *list_failures(cells),
            "",
        ]
        write_page("methods", name, "synthesizers", lines)


def texture_rows(names: Iterable[str] = TEXTURES) -> Iterator[dict[str, Any]]:
    """Yield the rows of texture models for a suite."""
    for name in names:
        model, parameters = TEXTURES[name]
        yield {"name": name, "dataset": model, "parameters": dict(parameters)}


def photograph_rows(folder: Path) -> Iterator[dict[str, Any]]:
    """Yield rows of the first two pictures of a folder, with the lattices that are detected in them."""
    for path in list_pictures(folder)[:2]:
        try:
            lattice = nrbench.detect_lattice(read_image(path)).lattice
            vectors = {"t1": lattice.t1, "t2": lattice.t2, "origin": lattice.origin}
        except nrbench.NoLatticeFound:
            vectors = {}
        yield {"name": path.stem, "dataset": "images", "parameters": {"path": path, **vectors}}


def describe_cost(cells: list[CellRecord]) -> str:
    """Return a sentence on seconds and memory of the outputs that were made."""
    made = [record for record in cells if record.seconds is not None]
    if not made:
        return "It made no output."
    seconds, memory = (sorted(values) for values in ([r.seconds for r in made], [r.peak_mib or 0 for r in made]))
    return (
        f"Median of {len(made)} outputs: {median(seconds):.2f} s and {median(memory):.0f} MiB beyond the sample; "
        f"at most {seconds[-1]:.2f} s and {memory[-1]:.0f} MiB. Seconds are those of the machine that made this page."
    )


def list_failures(cells: list[CellRecord]) -> list[str]:
    """Return lines on the textures that the method refused or of which a peril is low."""
    lines = []
    for record in cells:
        low = [f"{peril} {record.values[f'{peril}.score']:.2f}" for peril in PERILS if is_low(record, peril)]
        if record.status != "ok":
            lines.append(f"- `{record.texture}`: {record.status}: {record.message}")
        elif low:
            lines.append(f"- `{record.texture}`: {', '.join(low)}")
    return lines or [f"No score of these outputs is below {BROKEN}."]


def is_low(record: CellRecord, peril: str) -> bool:
    """Return whether a peril of an output was measured and is below BROKEN."""
    score = record.values.get(f"{peril}.score")
    return isinstance(score, float) and score < BROKEN


# ------------------------------------------------------------------ textures


def write_textures() -> None:
    """Write a page for each texture model, its departures turned up one by one."""
    for name in plugins.names("datasets"):
        if name == "images":
            continue
        fields = parameters_of(plugins.build("datasets", name))
        off = {key: "plain" if key == "material" else 0.0 for key in DEPARTURES if key in fields}
        lines = ["Each row turns one departure up; all others are off.", ""]
        for key in off:
            lines += [f"## {key}", "", "::::{container} pictures"]
            for value in (off[key], *DEPARTURES[key]):
                texture = nrbench.texture(name, (192, 192), 1, **{**off, key: value})
                lines += figure(PAGES / "textures", f"{name}-{key}-{value}", texture.image, f"{key} = {value}")
            lines += ["::::", ""]
        write_page("textures", name, "datasets", lines)


# ------------------------------------------------------------------ perils


def write_perils() -> None:
    """Write a page for each peril: planted defects of growing size, each with its scores."""
    methods = [
        f"planted:kind={kind},size={size:g}" for ladder in LADDERS.values() for kind in ladder for size in ladder[kind]
    ]
    run = make_run("perils", list(texture_rows(LADDER_TEXTURES)), ["oracle", *methods])
    for peril, ladder in LADDERS.items():
        lines = [
            "Defects of growing size in fresh draws, each with the score of this peril and the quality. "
            "The first picture of a row has no defect.",
            "",
        ]
        for kind in ladder:
            for texture in LADDER_TEXTURES:
                lines += [f"## {kind}, {texture}", "", "::::{container} pictures"]
                for record in run.cells:
                    size = record.cell.parameters.get("size") if record.cell.parameters.get("kind") == kind else None
                    if record.texture == texture and (record.method == "oracle" or size is not None):
                        about = f"size {size:g}" if size is not None else "no defect"
                        about += f": {peril} {show(record, f'{peril}.score')}, quality {show(record, 'quality.score')}"
                        picture = read_image(record.folder / "output.png")
                        lines += figure(PAGES / "perils", f"{texture}-{kind}-{size}", picture, about)
                lines += ["::::", ""]
        write_page("perils", peril, "metrics", lines)


# ------------------------------------------------------------------ pages


def make_run(name: str, textures: list[dict[str, Any]], methods: list[str]) -> Run:
    """Run a suite, or resume it; the perils are scored."""
    suite = Suite.model_validate(
        {
            "name": f"gallery-{name}",
            "description": "Pictures of the documentation.",
            "seed": 1,
            "sample": (SAMPLE, SAMPLE),
            "size": (OUTPUT, OUTPUT),
            "lattice": ("given",),
            "methods": methods,
            "metrics": ("cost", *PERILS, "quality"),
            "texture": textures,
        }
    )
    return nrbench.run(suite, out=RUNS / name)


def show_cell(record: CellRecord, folder: Path) -> list[str]:
    """Return the lines that show a sample and its output."""
    lines = [f"## {record.texture}", "", "::::{container} pictures"]
    sample = folder / "pictures" / f"{record.texture}.png"
    if (record.folder / "sample.png").exists() and not sample.exists():
        shutil.copy(record.folder / "sample.png", sample)
    lines += figure(folder, record.texture, None, "sample")
    if record.status == "ok":
        worst = min(
            (record.values[f"{peril}.score"], peril)
            for peril in PERILS
            if record.values.get(f"{peril}.score") is not None
        )
        about = f"quality {show(record, 'quality.score')}; worst: {worst[1]} {worst[0]:.2f}"
        lines += figure(folder, f"{record.method}-{record.texture}", read_image(record.folder / "output.png"), about)
    return [*lines, "::::", "", *([record.note, ""] if record.note else [])]


def figure(folder: Path, name: str, picture: Any, about: str) -> list[str]:
    """Write a picture, unless it is None, and return the lines that show it."""
    path = folder / "pictures" / f"{name}.png"
    if picture is not None:
        write_image(path, quantize(picture))
    return ["", f":::{{figure}} pictures/{path.name}", ":align: left", "", about, ":::"]


def show(record: CellRecord, key: str) -> str:
    """Return a score with two digits, or a dash."""
    value = record.values.get(key)
    return "–" if value is None else f"{value:.2f}"


def write_page(part: str, name: str, kind: str, lines: list[str]) -> None:
    """Write a page: the plugin's name, the first line of its docstring, the lines, its docstring and its BibTeX."""
    cls = find(kind, name).cls
    assert cls is not None
    about = (cls.__doc__ or "").strip().partition("\n")[0].replace("``", "`")
    reference = ["```{eval-rst}", f".. autoclass:: {cls.__module__}.{cls.__qualname__}", "```", ""]
    if paper := getattr(cls, "paper", ""):
        reference += ["## BibTeX", "", "```bibtex", paper, "```", ""]
    page = [f"# {name}", "", about, "", *lines, "## Reference", "", *reference]
    (PAGES / part / f"{name}.md").write_text("\n".join(page), "utf-8")


if __name__ == "__main__":
    main()
