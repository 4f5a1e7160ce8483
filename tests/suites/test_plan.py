"""A plan holds what is needed to draw its samples again; the keys of its cells name all that decides a result."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import nrbench
from nrbench.detectors.consensus import Consensus
from nrbench.detectors.dominance import Dominance
from nrbench.pictures.files import write_image
from nrbench.plugins import registry
from nrbench.runs.store import metric_key
from nrbench.streams import pixels_hash
from nrbench.suites.plan import make_plan
from nrbench.suites.suite import Suite, validated_suite


def suite_of(*textures: dict[str, Any], **more: Any) -> Suite:
    """Return a suite of some textures."""
    content = {"name": "planned", "sample": "48x40", "size": "56x52", "methods": ["oracle", "tiling"]}
    return validated_suite({**content, "metrics": ["cost"], "texture": list(textures), **more}, "test")


@pytest.mark.usefixtures("faulty")
def test_a_plan_holds_what_cannot_be_drawn_again(tmp_path: Path) -> None:
    """It holds the bytes of pictures, and of samples of datasets of others, once, and draws the others again."""
    write_image(tmp_path / "wall.png", nrbench.texture("brick", shape=(200, 220)).image)
    picture = {"name": "picture", "dataset": "images", "parameters": {"path": str(tmp_path / "wall.png")}}
    model = {"name": "model", "dataset": "weave", "parameters": {"noise": 0.1}}
    foreign = {"name": "foreign", "dataset": "picture", "parameters": {"how": "fine"}}
    plan = make_plan(suite_of(model, picture, foreign, replicates=2))
    assert len(plan.cells) == 12
    kept = {(cell.texture, sample.kept[0] is not None, sample.kept[1] is not None) for cell, sample in plan.cells}
    assert kept == {("model", False, False), ("picture", True, True), ("foreign", True, False)}
    for cell, sample in plan.cells:
        assert sample.size == sample.image().shape[:2] == (40, 48)
        assert pixels_hash(sample.image()) == cell.sample_hash
    regions = [(cell.texture, sample.again()) for cell, sample in plan.cells if cell.again_hash]
    assert {name for name, _ in regions} == {"picture"}
    assert all(region is not None and region.shape == (52, 56, 3) for _, region in regions)


def test_references_run_once() -> None:
    """With references_once, the references run on the first draw alone and with the first source of the lattice."""
    wall = {"name": "wall", "dataset": "brick"}
    more: dict[str, Any] = {"methods": ["oracle", "tiling", "rsgf"], "lattice": ["given", "own"], "replicates": 2}
    cells = [
        [(cell.method, cell.lattice_source, cell.replicate) for cell, _ in make_plan(suite_of(wall, **once)).cells]
        for once in (more, {**more, "references_once": True})
    ]
    assert len(cells[0]) == 10
    assert cells[1] == [
        *(("oracle", "none", 0), ("tiling", "given", 0)),
        *(("rsgf", source, replicate) for replicate in (0, 1) for source in ("given", "own")),
    ]


def test_a_picture_that_changes_during_a_run(tmp_path: Path) -> None:
    """A plan keeps the sample and the region of a picture: the run goes on as if the file had not changed."""
    image = nrbench.texture("brick", shape=(200, 220)).image
    write_image(tmp_path / "wall.png", image)
    row = {"name": "wall", "dataset": "images", "parameters": {"path": str(tmp_path / "wall.png")}}
    cell, sample = make_plan(suite_of(row)).cells[0]
    write_image(tmp_path / "wall.png", 1 - image)
    assert pixels_hash(sample.image()) == cell.sample_hash
    (tmp_path / "wall.png").unlink()
    region = sample.again()
    assert pixels_hash(region) == cell.again_hash


@pytest.fixture
def fresh_registry(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Forget the plugins that a test loads or changes, before it and after it."""
    monkeypatch.setattr(registry, "_files", {})
    metric_key.cache_clear()
    yield
    monkeypatch.undo()
    metric_key.cache_clear()


SOURCES = ("own", "given", "30,0,0,20", "gncc", "dominance")


def keys() -> dict[tuple[str, str], str]:
    """Return the keys of a small plan by method and source of the lattice."""
    methods = ["rsgf", "rsgf:finder=gncc", "shuffle", "quilting"]
    plan = make_plan(suite_of({"name": "brick", "dataset": "brick"}, methods=methods, lattice=list(SOURCES)))
    return {(cell.label, cell.lattice_source): cell.key for cell, _ in plan.cells}


@pytest.mark.usefixtures("fresh_registry")
@pytest.mark.parametrize(
    ("detector", "changed"),
    [
        # Every lattice is followed through the sample, to see whether it is bent, and Consensus is what follows it.
        (Consensus, {(f"rsgf{end}", source) for end in ("", ":finder=gncc") for source in SOURCES}),
        (Dominance, {("rsgf", "dominance"), ("rsgf:finder=gncc", "dominance"), ("shuffle", "dominance")}),
    ],
)
def test_a_detector_is_in_the_keys_of_the_cells_that_may_call_it(
    detector: type, changed: set[tuple[str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A new version of a detector changes the keys of cells and scores where it may run, and no others."""
    before, scored = keys(), metric_key("regularity")
    monkeypatch.setattr(detector, "version", "changed")
    metric_key.cache_clear()
    after = keys()
    assert {cell for cell, key in before.items() if after[cell] != key} == changed
    assert (metric_key("regularity") != scored) == (detector is Dominance)
