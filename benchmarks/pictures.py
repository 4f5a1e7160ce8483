r"""Draw the pictures of the docs, into ``docs/``: of the README and the page on `resample` from runs, and of the tree.

``python benchmarks/pictures.py first-light runs/core`` draws ``first-light.jpg`` from a run of the suite ``core``.
``python benchmarks/pictures.py resample runs/resample`` draws ``resample.jpg`` and ``resample_perils.jpg`` from ::

    nrbench run core -m resample -m rsgf -m tile-set -m copier -m cartoon -m oracle --lattice given --replicates 5 \
        --seed 5 --out runs/resample

``python benchmarks/pictures.py cases`` draws ``resample_cases.jpg``: prints, photographs, and failures of `resample`.
``python benchmarks/pictures.py presets`` draws ``presets/METHOD.jpg`` for each method that has presets, ``presets rsgf
gpnn`` those of two methods.
``python benchmarks/pictures.py structure`` draws ``structure.svg`` from the packages and their docstrings.
"""

import ast
import textwrap
from collections.abc import Callable, Mapping
from html import escape
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.figure
import skimage.data
from prints import graded_samples
from studies import read_options

matplotlib.use("Agg")

import matplotlib.pyplot as plt

import nrbench
from nrbench import Lattice, Refused, Run, Texture, draw_lattice, plugins, read_image
from nrbench.imaging.convert import as_image
from nrbench.runs.records import CellRecord
from nrbench.suites.plan import draw_samples
from nrbench.suites.suite import load_suite

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PERILS = ("regularity", "integrity", "randomness", "appearance")
LIGHT = ("brick-strong", "weave-middle", "hexagon-middle-rotated")
LIGHT_COLUMNS = {
    ("oracle", "none"): "oracle: a fresh draw",
    ("resample", "own"): "resample",
    ("rsgf", "own"): "rsgf",
    ("tile-set", "own"): "tile-set",
    ("fftm-patch", "own"): "fftm-patch",
    ("ann-pixel", "none"): "ann-pixel: no lattice",
    ("tiling", "own"): "tiling: one tile, repeated",
}
"""Method and source of the lattice of each column, and its title."""
VARIED = ("brick-middle", "weave-strong", "hexagon-strong")
MODEL = {"sample.png": "sample", "extras/elements.png": "elements", "extras/attributes.png": "their colors"}
METHODS = {"oracle": "a fresh draw", "resample": "resample", "rsgf": "rsgf", "tile-set": "tile-set", "copier": "copier"}


def show(axis: Any, image: Any, **labels: str) -> None:
    """Show a picture pixel for pixel, with a title or a line below it."""
    axis.imshow(image, interpolation="nearest", cmap="gray", vmin=0, vmax=1)
    axis.set(xticks=[], yticks=[], **labels)


def save(figure: matplotlib.figure.Figure, name: str, dpi: int, quality: int, pad: float = 1.08) -> None:
    """Write a figure to the folder of the docs."""
    figure.tight_layout(h_pad=pad)
    figure.savefig(DOCS / name, dpi=dpi, pil_kwargs={"quality": quality})


def caption(record: CellRecord) -> str:
    """Return the verdict and the quality of one output, in two lines."""
    preserved, quality = record.values["regularity.preserved"], record.values["quality.score"]
    verdict = {True: "lattice preserved", False: "lattice lost", None: "undecided"}[preserved]
    return f"{verdict}\n" + (f"quality {quality:.2f}" if quality is not None else "not scored further")


def draw_light(run: Run) -> None:
    """Draw one row a texture: sample with its lattice, then an output a method."""
    records = {(r.texture, r.method, r.lattice_source): r for r in run.cells}
    widths = [0.62, *[1] * len(LIGHT_COLUMNS)]
    figure, axes = plt.subplots(len(LIGHT), len(widths), figsize=(16.2, 7.6), width_ratios=widths)
    for row, texture in zip(axes, LIGHT, strict=True):
        first = records[texture, *next(iter(LIGHT_COLUMNS))]
        truth = Lattice.from_dict(first.lattice_truth or {})
        label = f"sample and lattice\nregular share {first.regular_share:.2f}"
        show(row[0], draw_lattice(read_image(first.folder / "sample.png"), truth), xlabel=label)
        for axis, (column, title) in zip(row[1:], LIGHT_COLUMNS.items(), strict=True):
            record = records[texture, *column]
            title = title if texture == LIGHT[0] else ""
            show(axis, read_image(record.folder / "output.png"), xlabel=caption(record), title=title)
    save(figure, "first-light.jpg", 96, 85, 1.6)


def draw_methods(run: Run) -> None:
    """Draw one row a texture: the sample, its elements and their colors, then the outputs with their quality."""
    records = {(r.texture, r.method): r for r in run.cells}
    widths = [0.5] * len(MODEL) + [1.0] * len(METHODS)
    figure, axes = plt.subplots(len(VARIED), len(widths), figsize=(16.4, 7.9), width_ratios=widths)
    for row, texture in zip(axes, VARIED, strict=True):
        folder = records[texture, "resample"].folder
        for axis, (name, title) in zip(row, MODEL.items(), strict=False):
            show(axis, read_image(folder / name), title=title)
        for axis, (method, title) in zip(row[len(MODEL) :], METHODS.items(), strict=True):
            record = records[texture, method]
            quality = record.values["quality.score"]
            label = "not scored" if quality is None else f"quality {quality:.2f}"
            show(axis, read_image(record.folder / "output.png"), title=title, xlabel=label)
    save(figure, "resample.jpg", 75, 88)


def draw_perils(run: Run) -> None:
    """Draw for each peril the output of `resample` with the lowest and the median score beside a fresh draw."""
    records = {(r.texture, r.cell.replicate, r.method): r for r in run.cells if r.status == "ok"}
    figure, axes = plt.subplots(len(PERILS), 4, figsize=(13, 13.6))
    for row, peril in zip(axes, PERILS, strict=True):
        scores = sorted(
            (value, key)
            for key, record in records.items()
            if key[2] == "resample" and (value := record.values[f"quality.{peril}"]) is not None
        )
        for k, (score, (texture, replicate, _)) in enumerate((scores[0], scores[len(scores) // 2])):
            label = f"{peril} {score:.2f}, the {('lowest', 'median')[k]} of {len(scores)}"
            for axis, method in zip(row[2 * k : 2 * k + 2], ("oracle", "resample"), strict=True):
                image = read_image(records[texture, replicate, method].folder / "output.png")[:256, :256]
                title = f"{texture}, {METHODS[method]}"
                show(axis, image, title=title, xlabel=label if method == "resample" else "")
    save(figure, "resample_perils.jpg", 75, 88)


CASES = {
    "prints": ("prints: dots-three", "prints: flowers", "prints: pixels"),
    "photographs": ("photograph: brick, all", "default: brick-material", "default: weave-material"),
    "failures": ("prints: checks", "report2004: figure-27-windows", "photograph: brick"),
}
"""The textures of each row: a suite and its texture, or a part of the photograph of scikit-image."""
CASE = 256
"""px: side of the outputs."""


def find_case(name: str) -> Texture:
    """Return the texture of a case."""
    source, _, texture = name.partition(": ")
    if source == "photograph":
        image = skimage.data.brick()
        return Texture(as_image(image[:200, 100:300] if texture == "brick" else image[::2, ::2]))
    if source == "prints":
        with graded_samples([texture]) as (sample,):
            made = sample.texture
    else:
        made = next(iter(draw_samples(load_suite(source), [texture]))).texture
    assert made is not None
    return made


def draw_cases() -> None:
    """Draw one row a group: each sample beside an output of `resample`, pixel for pixel; the lattice is given if known.

    The line above an output is the note of the method.
    """
    made = {name: find_case(name) for group in CASES.values() for name in group}
    wide = max(texture.image.shape[1] for texture in made.values()) + CASE + 2 * SPACE
    height = len(CASES) * (CASE + HEADING + SPACE)
    figure = matplotlib.figure.Figure((3 * wide / 100, height / 100), dpi=100)
    for row, group in enumerate(CASES.values(), 1):
        below = height - row * (CASE + HEADING + SPACE)
        for column, name in enumerate(group):
            left, texture = column * wide, made[name]
            try:
                result = nrbench.synthesize("resample", texture.image, (CASE, CASE), texture.lattice, seed=1)
                output, note = result.image, result.note
            except Refused as why:
                output, note = None, f"refused: {why}"
            pictures = [(texture.image, left, name), (output, left + wide - CASE - SPACE, note)]
            for image, at, text in pictures:
                figure.text(at / (3 * wide), (below + CASE + 5) / height, textwrap.shorten(text, 40), size=8)
                if image is not None:
                    gray = image if image.shape[2] == 3 else image.repeat(3, 2)
                    figure.figimage(gray, at, below + CASE - len(gray))
    figure.savefig(DOCS / "resample_cases.jpg", dpi=100, pil_kwargs={"quality": 90})


PRESET_TEXTURES = ("brick", "weave", "hexagon")
SAMPLE, OUTPUT, SPACE, HEADING = 128, 224, 6, 18
"""px: sides of the samples and outputs, the space between them, and the height of the titles."""


def draw_presets(names: list[str]) -> None:
    """Draw a picture for each method that has presets, one row a texture: the sample, the default and each preset.

    Methods that use a lattice get the true one, so that the pictures show how they synthesize. Pixels are not scaled.
    """
    samples = [nrbench.texture(name, (SAMPLE, SAMPLE), 3, color=0.3) for name in PRESET_TEXTURES]
    for name in names or plugins.names("synthesizers"):
        cls = plugins.find("synthesizers", name).cls
        presets = getattr(cls, "presets", {})
        if not presets:
            continue
        columns, defaults = {"sample": "", "default": name}, plugins.parameters_of(cls())
        for preset, values in presets.items():
            if values.items() <= defaults.items():
                columns[f"default, also preset={preset}"] = columns.pop("default")
            else:
                columns[f"preset={preset}"] = f"{name}:preset={preset}"
        width, height = SAMPLE + (len(columns) - 1) * (OUTPUT + SPACE), len(samples) * (OUTPUT + SPACE) + HEADING
        figure = matplotlib.figure.Figure((width / 100, height / 100), dpi=100)
        left = 0
        for title, method in columns.items():
            figure.text(left / width, (height - HEADING + 5) / height, title, size=9)
            for row, sample in enumerate(samples, 1):
                image, below = sample.image, (len(samples) - row) * (OUTPUT + SPACE)
                if method:
                    try:
                        image = nrbench.synthesize(method, sample, (OUTPUT, OUTPUT), sample.lattice, seed=1).image
                    except Refused as why:
                        print(f"{method} on {sample.name}: {why}")
                        figure.text(left / width, (below + OUTPUT - 20) / height, "refused", size=9)
                        continue
                figure.figimage(image, left, below + OUTPUT - len(image))
            left += (OUTPUT if method else SAMPLE) + SPACE
        (DOCS / "presets").mkdir(exist_ok=True)
        figure.savefig(DOCS / "presets" / f"{name}.jpg", dpi=100, pil_kwargs={"quality": 88})


STEPS = {"cli": 1, "suites": 2, "running": 3, "detectors": 4, "synthesizers": 4, "metrics": 5, "runs": 6, "reports": 7}
"""The packages through which a cell goes, in order."""
FILLS = {"plugins": "#fff3d6", "core": "#e4eefb", "base": "#eeeeee"}
WIDE, MARGIN, GAP, LINE = 800, 10, 8, 15
"""px: width of the picture, margin, gap between boxes, and height of a line of text."""


def list_floors() -> list[list[str]]:
    """Return the packages of each floor, from the highest to the lowest, as the tests of the structure declare them."""
    tree = ast.parse((ROOT / "tests" / "core" / "test_structure.py").read_text("utf-8"))
    named = (node for node in tree.body if isinstance(node, ast.Assign))
    floors = next(ast.literal_eval(node.value) for node in named if ast.unparse(node.targets[0]) == "FLOORS")
    return [[name.removeprefix("nrbench.") for name in floor if not name.endswith("__")] for floor in floors]


def describe(name: str) -> str:
    """Return the first line of a package's or a module's docstring."""
    places = (ROOT / name / "__init__.py", ROOT / "nrbench" / name / "__init__.py", ROOT / "nrbench" / f"{name}.py")
    page = ast.get_docstring(ast.parse(next(path for path in places if path.exists()).read_text("utf-8"))) or ""
    return page.partition("\n")[0].rstrip(".").replace("`", "")


def draw_structure() -> None:
    """Draw one row a floor and one box a package; numbers are the way of a cell."""
    parts, top, floors = [], MARGIN, list_floors()
    for floor in floors:
        width = (WIDE - 2 * MARGIN - GAP * (len(floor) - 1)) / len(floor)
        texts = {name: textwrap.wrap(describe(name), int((width - 16) / 6.9)) for name in floor}
        height = LINE * max(map(len, texts.values())) + 34
        for k, (name, lines) in enumerate(texts.items()):
            left = MARGIN + k * (width + GAP)
            wing = (ROOT / name / "__init__.py").exists() or name == "detectors"
            single = (ROOT / "nrbench" / f"{name}.py").exists()
            fill = FILLS["plugins" if wing else "base" if single else "core"]
            box = f'width="{width:.0f}" height="{height}" rx="5" fill="{fill}" stroke="#8090a0"'
            parts.append(f'<rect x="{left:.0f}" y="{top}" {box}/>')
            parts.append(f'<text x="{left + 10:.0f}" y="{top + 20}" class="name">{name}</text>')
            for n, line in enumerate(lines):
                parts.append(f'<text x="{left + 10:.0f}" y="{top + 38 + n * LINE}">{escape(line)}</text>')
            if name in STEPS:
                x, y = left + width - 18, top + 17
                parts.append(f'<circle cx="{x:.0f}" cy="{y}" r="11" fill="#b03020"/>')
                parts.append(f'<text x="{x:.0f}" y="{y + 4}" class="step">{STEPS[name]}</text>')
        top += height + GAP
    style = "text{font:12px sans-serif;fill:#202830}.name{font-weight:bold;font-size:14px}"
    style += ".step{fill:#fff;font-weight:bold;text-anchor:middle}"
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDE} {top + GAP}" width="{WIDE}">'
    ground = f'<style>{style}</style>\n<rect width="{WIDE}" height="{top + GAP}" fill="#fff"/>'
    (DOCS / "structure.svg").write_text("\n".join([head, ground, *parts, "</svg>", ""]), "utf-8")


def draw_resample(run: Run) -> None:
    """Draw the two pictures of the page on `resample`."""
    draw_methods(run)
    draw_perils(run)


PAGES: Mapping[str, Callable[[list[str]], None]] = {
    "first-light": lambda names: draw_light(Run(Path(*names))),
    "resample": lambda names: draw_resample(Run(Path(*names))),
    "cases": lambda names: draw_cases(),
    "presets": draw_presets,
    "structure": lambda names: draw_structure(),
}


def main() -> None:
    """Draw the pictures of one page."""
    options = read_options(__doc__, ["page", "names"], {"page": PAGES}, page="structure", names=[])
    PAGES[options.page](options.names)


if __name__ == "__main__":
    main()
