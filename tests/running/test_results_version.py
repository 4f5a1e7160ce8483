"""The results of every method are pinned: a change of an output or a score raises RESULTS_VERSION and pins anew.

``python tests/running/test_results_version.py`` writes the pins to ``pinned_results.json``.
"""

import json
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from nrbench import plugins, run
from nrbench.lattice.geometry import Lattice
from nrbench.pictures.files import read_image, write_image
from nrbench.plugins.forms import NoLatticeFound
from nrbench.running.runner import Options
from nrbench.runs.records import CellRecord
from nrbench.streams import pixels_hash
from nrbench.suites.cell import RESULTS_VERSION
from nrbench.suites.plan import PlannedMethod, make_plan
from nrbench.suites.suite import Suite, validated_suite

PINNED_FILE = Path(__file__).with_name("pinned_results.json")
PINNED: dict[str, Any] = json.loads(PINNED_FILE.read_text("utf-8"))
SCORES = ("regularity.score", "integrity.score", "quality.", "randomness.", "appearance.score")
"""The names of the scores that are pinned, or their beginnings: those that rank the methods, and their parts."""

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
DETECTORS = PROJECT["project"]["entry-points"]["nrbench.detectors"]
TEXTURES = {"brick": 0.0, "weave": 12.0, "hexagon": 33.0, "squares": 0.0}
"""Models, and the rotations by which they are drawn, degrees."""
ON_EVERY_TEXTURE = ("oracle", "rsgf:block=24,border=6,subpixel=false", "scatter")
"""Methods that are pinned on all textures; the default of every method is pinned on the weave."""

SHORTENED = {"gpdm": ",steps=2"}
"""What is changed of the preset of a paper that would take a minute."""


def suite_of(methods: list[str], *textures: str, lattice: str = "given", metrics: tuple[str, ...] = ("cost",)) -> Suite:
    """Return a suite of some methods on some of :data:`TEXTURES`."""
    rows = [
        {"name": name, "dataset": name, "parameters": {"rotation": TEXTURES[name], "color": 0.3, "noise": 0.03}}
        for name in textures
    ]
    content = {"sample": "128x128", "size": "144x136", "lattice": [lattice], "metrics": metrics}
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
    found = [name for name, cls in classes.items() if "paper" in getattr(cls, "presets", {})]
    return [f"{name}:preset=paper{SHORTENED.get(name, '')}" for name in found]


def cells_of(suite: Suite, place: Path) -> list[CellRecord]:
    """Run a suite, and return its cells, all of which succeed."""
    done = run(suite, out=place, options=Options(jobs=0))
    assert all(record.status == "ok" for record in done.cells), [record.message for record in done.cells]
    return done.cells


def output_hash(record: CellRecord) -> str:
    """Return a hash of the output's pixels."""
    return pixels_hash(read_image(record.folder / "output.png"))[:12]


def measure_outputs(place: Path) -> dict[str, dict[str, Any]]:
    """Return the hash of the output, and the scores, of each cell with a given lattice."""
    metrics = ("regularity", "integrity", "randomness", "quality")
    cells = [
        *cells_of(suite_of(list(ON_EVERY_TEXTURE), *TEXTURES, metrics=metrics), place / "all"),
        *cells_of(suite_of(default_methods(place / "files"), "weave", metrics=metrics), place / "default"),
    ]
    return {
        f"{record.texture}/{method_name(record)}": {
            "output": output_hash(record),
            **{name: rounded(value) for name, value in record.values.items() if name.startswith(SCORES)},
        }
        for record in cells
    }


def method_name(record: CellRecord) -> str:
    """Return the method with its parameters, but without the paths on this machine."""
    return record.cell.method if record.cell.method in ("command", "precomputed") else record.method


def measure_papers(place: Path) -> dict[str, str]:
    """Return the hash of the output of each method as its paper describes it, on the weave."""
    return {record.cell.method: output_hash(record) for record in cells_of(suite_of(paper_methods(), "weave"), place)}


def measure_own(place: Path) -> dict[str, dict[str, Any]]:
    """Return the hash of the output, and the lattice, of each method that calls a detector, on upright squares."""
    methods = [spec for spec in default_methods(place / "files") if PlannedMethod.parse(spec).finder]
    return {
        record.cell.method: {
            "output": output_hash(record),
            "lattice": numbers(Lattice.from_dict(record.lattice_used)) if record.lattice_used else None,
        }
        for record in cells_of(suite_of(methods, "squares", lattice="own"), place / "own")
    }


def measure_bent(place: Path) -> dict[str, dict[str, Any]]:
    """Return the hash of the output, and the note, of two methods on bent samples, which are straightened first."""
    bent = {"color": 0.3, "noise": 0.03, "bend": 0.5}
    rows = [{"name": name, "dataset": name, "parameters": bent} for name in ("brick", "hexagon")]
    content = {"sample": "192x192", "size": "144x136", "lattice": ["given"], "metrics": ["cost"], "texture": rows}
    suite = validated_suite({"name": "bent", **content, "methods": ["rsgf", "tile-set"]}, "bent")
    return {
        f"{record.texture}/{record.cell.method}": {"output": output_hash(record), "note": record.note}
        for record in cells_of(suite, place / "bent")
    }


def measure_detections(place: Path) -> dict[str, dict[str, Any] | None]:
    """Return the lattice and the confidence of each detector on each texture, and on noise; None if it finds none."""
    content = {"sample": "128x128", "texture": [{"name": "noise", "dataset": "noise"}], "methods": ["oracle"]}
    suites = (suite_of(["oracle"], *TEXTURES), validated_suite({"name": "noise", **content}, "noise"))
    found: dict[str, dict[str, Any] | None] = {}
    for cell, sample in (pair for suite in suites for pair in make_plan(suite).cells):
        for detector in DETECTORS:
            try:
                detection = plugins.build("detectors", detector).detect(sample.image())
            except NoLatticeFound:
                found[f"{cell.texture}/{detector}"] = None
                continue
            known = {"lattice": numbers(detection.lattice), "confidence": rounded(detection.confidence)}
            found[f"{cell.texture}/{detector}"] = known
    return found


def numbers(lattice: Lattice) -> list[float]:
    """Return the two vectors of a lattice, rounded to 0.001 px."""
    return [round(float(x), 3) for x in (*lattice.t1, *lattice.t2)]


def rounded(value: float | bool | None) -> float | None:
    """Return a score rounded to 0.001."""
    return None if value is None else round(float(value), 3)


MEASURES = {
    "outputs": measure_outputs,
    "papers": measure_papers,
    "own": measure_own,
    "bent": measure_bent,
    "detections": measure_detections,
}
"""The parts of the file of pins, and the functions that measure them."""


@pytest.mark.parametrize("part", MEASURES)
def test_results_are_those_of_this_version(part: str, tmp_path: Path) -> None:
    """Outputs are pinned to the byte, lattices and scores to 2e-3, as long as RESULTS_VERSION stays the same."""
    assert PINNED["results_version"] == RESULTS_VERSION, "pin the results of the new version"
    found = MEASURES[part](tmp_path)
    assert found.keys() == PINNED[part].keys()
    for name, values in found.items():
        pinned = PINNED[part][name]
        if not isinstance(values, dict) or not isinstance(pinned, dict):
            assert values == pinned, name
            continue
        assert values.keys() == pinned.keys()
        for key, value in values.items():
            exact = value is None or pinned[key] is None or isinstance(value, str)
            assert value == (pinned[key] if exact else pytest.approx(pinned[key], abs=2e-3)), (name, key)


def test_every_plugin_is_pinned() -> None:
    """The output of each registered method is pinned on at least one texture, and each detector on five."""
    assert set(METHODS) == {key.partition("/")[2].partition(":")[0] for key in PINNED["outputs"]}
    assert {key.partition("/")[2] for key in PINNED["detections"]} == set(DETECTORS)


if __name__ == "__main__":
    import tempfile

    place = Path(tempfile.mkdtemp())
    for part in sys.argv[1:] or MEASURES:
        (place / part).mkdir()
        PINNED[part] = MEASURES[part](place / part)
    PINNED["results_version"] = RESULTS_VERSION
    PINNED_FILE.write_text(json.dumps(PINNED, indent=1) + "\n", "utf-8")
