"""A plan holds its cells, and what is needed to draw their samples again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import nrbench
from nrbench.imaging.files import write_image
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
    assert region is not None
    assert pixels_hash(region) == cell.again_hash
