"""Runs for the tests of reports: real records over tiny pictures, with every status that a cell can have."""

import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nrbench.lattice.geometry import Lattice
from nrbench.pictures.files import write_image
from nrbench.plugins.forms import Column
from nrbench.reports.statistics.method_comparison import Comparison, compare_methods
from nrbench.runs.records import CellRecord, Run
from nrbench.suites.cell import Cell, Recipe

TRUTH = Lattice((8.5, 0.0), (4.25, 6.1), (1.0, 2.0))
COLUMNS: dict[str, Column] = {
    "regularity.preserved": Column("Whether the lattice is preserved.", better="higher"),
    "regularity.score": Column("Share of tiles in place and intact.", better="higher"),
    "randomness.variation": Column("Tile-by-tile variation against fresh draws.", "", (0.0, float("inf")), "one"),
    "randomness.repetition": Column("Excess of near-exact twins <b>over</b> fresh draws.", better="lower"),
    "randomness.distance": Column("Energy distance to fresh draws.", better="lower"),
    "quality.score": Column("The worst of the four perils.", better="higher"),
    "quality.complete": Column("Whether all perils were measured.", better="higher"),
    "quality.regularity": Column("Share of tiles in place.", better="higher"),
    "quality.integrity": Column("Wholeness of the elements.", better="higher"),
    "quality.randomness": Column("Randomness kept.", better="higher"),
    "quality.appearance": Column("Color, light and detail kept.", better="higher"),
    "cost.note": Column("A number without a better way.", "px"),
}
PERILS = ("regularity", "integrity", "randomness", "appearance")
HOSTILE = "<img src=x onerror=\"alert(1)\"> & 'co'"
STATUSES = ("ok", "refused", "error", "timeout", "memory", "crash", "invalid", "missing")

Make = Callable[..., Any]
"""A maker of records, or of runs."""


def _picture(path: Path, side: int, seed: int) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    return write_image(path, np.random.default_rng(seed).random((side, side, 3), np.float32))


def cell_maker(root: Path) -> Make:
    """Return a maker of records: ``make_cell(texture, method, preserved=..., score=..., status=..., ...)``.

    ``perils`` gives ``regularity``, ``integrity``, ``randomness`` and ``appearance``, or one number for all four; the
    quality is the smallest of them, and an upper bound if one is None although the lattice is preserved.
    """

    def make(
        texture: str = "brick",
        method: str = "rsgf",
        lattice_source: str = "own",
        replicate: int = 0,
        preserved: bool | None = True,
        score: float | None = 0.9,
        status: str = "ok",
        values: Mapping[str, float | bool | None] | None = None,
        reasons: Mapping[str, str] | None = None,
        perils: Mapping[str, float | None] | float | None = None,
        reference: bool = False,
        lattice_used: Lattice | None = TRUTH,
        lattice_truth: Lattice | None = TRUTH,
        log: str = "",
        side: int = 32,
        **more: Any,
    ) -> CellRecord:
        key = hashlib.sha256(f"{texture}|{method}|{lattice_source}|{replicate}".encode()).hexdigest()[:24]
        folder = root / "cells" / key
        cell = Cell(
            suite="tiny",
            texture=texture,
            recipe=Recipe("brick", {}, 0, texture, replicate, (side, side)),
            method=more.pop("plugin", method.partition(":")[0]),
            version="1",
            parameters=more.pop("parameters", {"block": 40}),
            label=method,
            reference=reference,
            lattice_source=lattice_source,
            replicate=replicate,
            seed=0,
            shape=(side, side),
            sample_hash=key,
            family=more.pop("family", "bricks"),
            kind=more.pop("kind", "I"),
            regular_share=0.75,
            lattice_truth=lattice_truth,
            preset=more.pop("preset", ""),
            detector=more.pop("detector", None),
            detected=more.pop("detected", None),
        )
        result: dict[str, Any] = {} if status == "missing" else {"status": status, "seconds": 0.25, **more}
        pictures: dict[str, Path] = {}
        if status != "missing":
            _picture(folder / "sample.png", 24, 1)
        if log and status != "missing":
            (folder / "log.txt").write_text(log, "utf-8")
        if status != "ok":
            return CellRecord(cell, folder, result)
        _picture(folder / "output.png", side, 2)
        pictures["regularity.defects"] = _picture(folder / "scores" / "regularity-defects.png", side, 3)
        result["lattice_used"] = lattice_used.as_dict() if lattice_used else None
        scores = {"regularity.preserved": preserved, "regularity.score": score, **(values or {})}
        records: dict[str, Any] = {}
        if isinstance(perils, float):
            perils = dict.fromkeys(PERILS, perils)
        if perils is not None:
            known = {name: value for name, value in perils.items() if value is not None}
            worst = min(known, key=lambda name: known[name], default=None)
            complete = not preserved or None not in perils.values()
            parts = {"score": known[worst], "complete": complete} if worst else {"score": None, "complete": None}
            parts |= {**dict.fromkeys(PERILS), **perils}
            scores |= {f"quality.{name}": value for name, value in parts.items()}
            records["quality"] = {"worst": worst}
        return CellRecord(cell, folder, result, scores, reasons or {}, pictures, records)

    return make


def run_maker(root: Path) -> Make:
    """Return a maker of runs: ``make_run(cells, **info)``."""

    def make(cells: list[CellRecord], columns: Mapping[str, Column] = COLUMNS, **info: Any) -> Run:
        run = Run(root)
        suite = {"name": "tiny", "version": 1, "hash": "abc123", "description": "A tiny suite."}
        vars(run).update(info={"suite": suite, **info}, columns=dict(columns), cells=cells)
        return run

    return make


@pytest.fixture
def make_cell(tmp_path: Path) -> Make:
    """Return a maker of the records of one test."""
    return cell_maker(tmp_path / "run")


@pytest.fixture
def make_run(tmp_path: Path) -> Make:
    """Return a maker of the runs of one test."""
    return run_maker(tmp_path / "run")


@pytest.fixture(scope="module")
def makers(tmp_path_factory: pytest.TempPathFactory) -> tuple[Make, Make]:
    """Return a maker of records and a maker of runs, for runs that the tests of a module share."""
    root = tmp_path_factory.mktemp("module") / "run"
    return cell_maker(root), run_maker(root)


@pytest.fixture(scope="session")
def every_ending(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Return a run with a cell of every status and verdict, a reference, a note, and hostile names."""
    root = tmp_path_factory.mktemp("every_ending") / "run"
    make_cell, make_run = cell_maker(root), run_maker(root)
    plain = [
        make_cell("brick", "oracle", "none", reference=True, values={"randomness.variation": 1.0}),
        make_cell("brick", "rsgf", "given", values={"randomness.variation": 0.9}, note="a note of its own"),
        make_cell("brick", "rsgf", "own", preserved=False, score=0.2, lattice_used=Lattice((9.9, 0.0), (0.0, 7.0))),
    ]
    why = {"regularity.preserved": "undecided: too little power", "randomness.variation": "not scored"}
    nothing = {"randomness.variation": None}
    undecided = make_cell("weave", "rsgf", "given", preserved=None, score=0.6, values=nothing, reasons=why)
    broken = make_cell(
        "weave", "rsgf", "own", preserved=None, score=None, reasons={"regularity.preserved": "failed: KeyError: 'x'"}
    )
    ended = [
        make_cell(f"t-{status}", "rsgf", "own", status=status, message=f"{status} because of {HOSTILE}", phase="score",
                  log=f"\x1b[31mlog of {status}\x1b[0m {HOSTILE}")
        for status in STATUSES[1:]
    ]  # fmt: skip
    hostile = make_cell(HOSTILE, HOSTILE, "own", family=HOSTILE, parameters={HOSTILE: HOSTILE}, note=HOSTILE)
    info = {"argv": ["nrbench", HOSTILE], "versions": {"numpy": "2.0", HOSTILE: HOSTILE}, "git": None}
    plugin = {"kind": "metrics", "name": HOSTILE, "distribution": "d", "version": "1", "error": HOSTILE}
    return make_run([*plain, undecided, broken, *ended, hostile], **info, plugins=[plugin], machine={"cpu": HOSTILE})


@pytest.fixture(scope="session")
def every_comparison(every_ending: Run) -> Comparison:
    """Return the comparison of that run."""
    return compare_methods(every_ending)


@pytest.fixture(scope="module")
def ranked(makers: tuple[Make, Make]) -> Run:
    """Return a run with qualities.

    A good method, one that the paired differences do not separate from it, one that refuses, one that loses some
    lattices, one that loses all of them, and three references. The textures have three levels of one departure.
    """
    make_cell, make_run = makers
    cells: list[CellRecord] = []
    for i, texture in enumerate("abc"):
        good = {"regularity": 1.0, "integrity": 0.9, "randomness": 0.7 - 0.01 * i, "appearance": 1.0}
        lost = {"regularity": 0.1 * i, "integrity": None, "randomness": None, "appearance": 0.8}
        cells += [
            make_cell(texture, "drifter", perils=lost, preserved=False),
            make_cell(texture, "shaky", preserved=bool(i), perils={**good, "integrity": 0.4} if i else lost),
            make_cell(texture, "refuser", perils=good) if i else make_cell(texture, "refuser", status="refused"),
            make_cell(texture, "close", perils={**good, "randomness": 0.65 + 0.04 * i}),
            make_cell(texture, "good", perils=good),
            make_cell(texture, "oracle", "none", reference=True, perils=1.0),
            make_cell(texture, "copier", "none", reference=True, perils={**good, "integrity": 1.0}),
            make_cell(texture, "tiling", "none", reference=True, perils={**good, "randomness": 0.0}),
        ]
    rows = [{"name": name, "departure": "bend", "level": level} for name, level in zip("abc", (1, 2, 4), strict=True)]
    suite = {"name": "tiny", "version": 1, "hash": "abc123", "content": {"texture": rows}}
    return make_run(cells, suite=suite)
