"""Pinned results: a kernel that changes an output or a score must raise RESULTS_VERSION, and pin anew.

`python tests/running/test_results_version.py` prints what to pin.
"""

from __future__ import annotations

import pytest

from nrbench.api import run
from nrbench.imaging.files import read_image
from nrbench.running.runner import Options
from nrbench.streams import pixels_hash
from nrbench.suites.cell import RESULTS_VERSION
from nrbench.suites.suite import Suite, validated_suite

PINNED_VERSION = 4
PINNED: dict[str, tuple[str, float | None, float | None]] = {
    "brick/oracle": ("640969693d75", 1.0, 0.865),
    "brick/rsgf:block=24,border=6,subpixel=False": ("a5d96a5265d3", 1.0, 1.159),
    "brick/scatter": ("9afe72461ece", 0.0, None),
    "weave/oracle": ("65448782c1bf", 1.0, 1.362),
    "weave/rsgf:block=24,border=6,subpixel=False": ("c135d4b02b93", 1.0, 0.983),
    "weave/scatter": ("df704a7cb32a", 0.0, None),
    "hexagon/oracle": ("679af1b7299b", 1.0, 0.974),
    "hexagon/rsgf:block=24,border=6,subpixel=False": ("da4839b09c46", 1.0, 0.963),
    "hexagon/scatter": ("afa4a54fec13", 0.0, None),
}


def small_suite() -> Suite:
    """Return one texture of each family, and the methods whose outputs are copies of the sample's pixels."""
    rows = [
        {"name": name, "dataset": name, "parameters": {"rotation": turn, "color": 0.3, "noise": 0.03}}
        for name, turn in (("brick", 0.0), ("weave", 12.0), ("hexagon", 33.0))
    ]
    methods = ["oracle", "rsgf:block=24,border=6,subpixel=false", "scatter"]
    return validated_suite(
        {
            "name": "pinned",
            "sample": "128x128",
            "size": "144x136",
            "lattice": ["given"],
            "methods": methods,
            "texture": rows,
        },
        "pinned",
    )


def measured(place: str) -> dict[str, tuple[str, float | None, float | None]]:
    """Return each cell's output hash, regularity score and variation."""
    found = run(small_suite(), out=place, options=Options(jobs=0))
    return {
        f"{record.texture}/{record.method}": (
            pixels_hash(read_image(record.folder / "output.png"))[:12],
            *(_rounded(record.values[name]) for name in ("regularity.score", "randomness.variation")),
        )
        for record in found.cells
    }


def _rounded(value: float | bool | None) -> float | None:
    return None if value is None else round(float(value), 3)


def test_results_are_those_of_this_version(tmp_path: object) -> None:
    """Outputs are pinned to the byte, scores to 2e-3, as long as RESULTS_VERSION stays what it is."""
    assert RESULTS_VERSION == PINNED_VERSION, "pin the results of the new version here"
    found = measured(str(tmp_path))
    assert {key: value[0] for key, value in found.items()} == {key: value[0] for key, value in PINNED.items()}
    for key, (_, *scores) in found.items():
        assert scores == pytest.approx(PINNED[key][1:], abs=2e-3), key


if __name__ == "__main__":
    import tempfile

    for cell, result in measured(tempfile.mkdtemp()).items():
        print(f"    {cell!r}: {result!r},")
