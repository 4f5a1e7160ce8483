"""The results of every method are pinned: a change of an output or a score raises RESULTS_VERSION and pins anew.

`python tests/running/test_results_version.py` prints the pins.
"""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

import pytest

from nrbench import plugins
from nrbench.api import run
from nrbench.imaging.files import read_image, write_image
from nrbench.running.runner import Options
from nrbench.streams import pixels_hash
from nrbench.suites.cell import RESULTS_VERSION
from nrbench.suites.plan import make_plan
from nrbench.suites.suite import Suite, validated_suite

PINNED_VERSION = 9
Pins = dict[str, tuple[str, float | None, float | None]]
PINNED: Pins = {
    "brick/oracle": ("640969693d75", 1.0, 0.865),
    "brick/rsgf:block=24,border=6,subpixel=False": ("a5d96a5265d3", 1.0, 1.159),
    "brick/scatter": ("9afe72461ece", 0.0, None),
    "weave/oracle": ("65448782c1bf", 1.0, 1.362),
    "weave/rsgf:block=24,border=6,subpixel=False": ("c135d4b02b93", 1.0, 0.983),
    "weave/scatter": ("df704a7cb32a", 0.0, None),
    "hexagon/oracle": ("679af1b7299b", 1.0, 0.974),
    "hexagon/rsgf:block=24,border=6,subpixel=False": ("da4839b09c46", 1.0, 0.963),
    "hexagon/scatter": ("afa4a54fec13", 0.0, None),
    "weave/ann-pixel": ("23ddeb44efe7", 0.0, None),
    "weave/copier": ("1b33286ab27c", 1.0, 0.821),
    "weave/command": ("c7dcc3413662", 0.554, None),
    "weave/fftm-patch": ("55591b94be29", 1.0, 0.647),
    "weave/fftm-pixel": ("38d55f1a6cc0", 1.0, 0.971),
    "weave/graph-cuts": ("a7660d611138", 1.0, 0.794),
    "weave/lattice-only": ("61b98c87908c", 0.994, None),
    "weave/patch-based": ("22ae6fd6bc7a", 1.0, 0.854),
    "weave/planted:kind=phase-step,size=0.25": ("f742306bbc6b", 0.417, None),
    "weave/precomputed": ("ee38e22f8772", 0.0, None),
    "weave/quilting": ("582aafe6ea50", 1.0, 0.927),
    "weave/random-phase": ("569bfad8f2f5", 0.213, None),
    "weave/regularized-patch": ("91a3c3c9ce72", 1.0, 1.0),
    "weave/representative-tile": ("7eb69abc4ad5", 1.0, 0.33),
    "weave/rsgf": ("71d1b2fb2cfd", 1.0, 0.656),
    "weave/shuffle": ("752f026208e9", 1.0, 0.998),
    "weave/supertile": ("765c00215f1b", 1.0, 1.045),
    "weave/auto": ("71d1b2fb2cfd", 1.0, 0.656),
    "weave/tile-set": ("7116eb4d4e52", 1.0, 0.989),
    "weave/tiling": ("b8b538838629", 1.0, 0.008),
}

PINNED_PAPERS = {
    "rsgf": "36d10eb3ddde",
    "tile-set": "496e6a51c35e",
    "fftm-patch": "35be20fcdf9a",
    "representative-tile": "e89f394d7605",
    "fftm-pixel": "c848b68882da",
    "ann-pixel": "23ddeb44efe7",
    "auto": "7116eb4d4e52",
    "patch-based": "3e9c6cf3a162",
    "quilting": "582aafe6ea50",
    "regularized-patch": "578c72c3b049",
    "graph-cuts": "a7660d611138",
}
"""The output of each method with the parameters of its paper, on the weave."""

TOOL = """
import sys
import numpy as np
from PIL import Image

sample, output, width, height, seed = sys.argv[1:]
pixels = np.roll(np.asarray(Image.open(sample)), int(seed) % 97, axis=1)
rows, columns = np.arange(int(height)) % pixels.shape[0], np.arange(int(width)) % pixels.shape[1]
Image.fromarray(pixels[rows][:, columns]).save(output)
"""
PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text("utf-8"))
METHODS = PROJECT["project"]["entry-points"]["nrbench.synthesizers"]
ON_EVERY_TEXTURE = ("oracle", "rsgf:block=24,border=6,subpixel=false", "scatter")
"""Methods that are pinned on all three textures; the default of every method is pinned on the weave."""


def suite_of(methods: list[str], *textures: str) -> Suite:
    """Return a suite of some methods on one texture of each family that is named, all with their true lattices."""
    rotations = {"brick": 0.0, "weave": 12.0, "hexagon": 33.0}
    rows = [
        {"name": name, "dataset": name, "parameters": {"rotation": rotations[name], "color": 0.3, "noise": 0.03}}
        for name in textures
    ]
    content = {"sample": "128x128", "size": "144x136", "lattice": ["given"], "metrics": ["regularity", "randomness"]}
    return validated_suite({"name": "pinned", **content, "methods": methods, "texture": rows}, "pinned")


def default_methods(folder: Path) -> list[str]:
    """Return every registered method with its default parameters, and what ``command`` and ``precomputed`` need."""
    folder.mkdir()
    (folder / "tool.py").write_text(TOOL)
    ((_, sample),) = make_plan(suite_of(["oracle"], "weave")).cells
    write_image(folder / "sample.png", sample.image())
    write_image(folder / "output.png", sample.image()[::-1].repeat(2, axis=0).repeat(2, axis=1)[:136, :144])
    (folder / "index.csv").write_text("sample,output\nsample.png,output.png\n")
    words = f"{sys.executable} {folder / 'tool.py'} {{sample}} {{output}} {{width}} {{height}} {{seed}}"
    required = {"command": f"command:run={words}", "precomputed": f"precomputed:directory={folder}"}
    return [required.get(name, name) for name in METHODS]


def paper_methods() -> list[str]:
    """Return every registered method that has the preset of a paper, with this preset."""
    classes = {name: plugins.find("synthesizers", name).cls for name in METHODS}
    return [f"{name}:preset=paper" for name, cls in classes.items() if "paper" in getattr(cls, "presets", {})]


def measure_papers(place: Path) -> dict[str, str]:
    """Return the hash of the output of each method as its paper describes it."""
    done = run(suite_of(paper_methods(), "weave"), out=place / "papers", options=Options(jobs=0))
    assert all(record.status == "ok" for record in done.cells), [record.message for record in done.cells]
    return {record.cell.method: pixels_hash(read_image(record.folder / "output.png"))[:12] for record in done.cells}


def measure(place: Path) -> Pins:
    """Return the hash of the output, the regularity score and the variation of each cell."""
    runs = (
        run(suite_of(list(ON_EVERY_TEXTURE), "brick", "weave", "hexagon"), out=place / "all", options=Options(jobs=0)),
        run(suite_of(default_methods(place / "files"), "weave"), out=place / "default", options=Options(jobs=0)),
    )
    pins: Pins = {}
    for record in (record for one in runs for record in one.cells):
        assert record.status == "ok", (record.method, record.message)
        outside = record.cell.method in ("command", "precomputed")
        pins[f"{record.texture}/{record.cell.method if outside else record.method}"] = (
            pixels_hash(read_image(record.folder / "output.png"))[:12],
            _rounded(record.values["regularity.score"]),
            _rounded(record.values["randomness.variation"]),
        )
    return pins


def _rounded(value: float | bool | None) -> float | None:
    return None if value is None else round(float(value), 3)


@pytest.fixture(scope="module")
def pins(tmp_path_factory: pytest.TempPathFactory) -> Pins:
    """Measure the pins once."""
    return measure(tmp_path_factory.mktemp("pins"))


def test_results_are_those_of_this_version(pins: Pins) -> None:
    """Outputs are pinned to the byte and scores to 2e-3 as long as RESULTS_VERSION stays the same."""
    assert RESULTS_VERSION == PINNED_VERSION, "pin the results of the new version here"
    assert {key: pin[0] for key, pin in pins.items()} == {key: pin[0] for key, pin in PINNED.items()}
    for key, (_, *scores) in pins.items():
        assert scores == pytest.approx(PINNED[key][1:], abs=2e-3), key


def test_every_method_is_pinned() -> None:
    """The default output of each registered method is pinned on at least one texture."""
    pinned = {key.partition("/")[2].partition(":")[0] for key in PINNED if "rsgf:" not in key}
    assert set(METHODS) == pinned


def test_the_methods_of_the_papers_are_those_of_this_version(tmp_path: Path) -> None:
    """The output of every method with ``preset=paper`` is pinned to the byte."""
    assert measure_papers(tmp_path) == PINNED_PAPERS


if __name__ == "__main__":
    import tempfile

    for method, pin in measure_papers(Path(tempfile.mkdtemp())).items():
        print(f"    {method!r}: {pin!r},")

    for cell, result in measure(Path(tempfile.mkdtemp())).items():
        print(f"    {cell!r}: {result!r},")
