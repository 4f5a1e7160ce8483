"""Tests of runs on pictures of which some pixels do not count."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import PIL.Image

import nrbench
from nrbench import Options, Synthesis, Task

PIXELS = np.random.default_rng(5).integers(0, 255, (40, 48, 3), np.uint8)


@dataclass(frozen=True)
class KnownPixels:
    """Random pixels of those that count, or of the others.

    Parameters
    ----------
    others
        Whether to take the others.
    """

    others: bool = False
    name: ClassVar[str] = "known-pixels"
    masks: ClassVar[bool] = True
    uses_lattice: ClassVar[bool] = False

    def synthesize(self, task: Task) -> Synthesis:
        """Draw pixels."""
        known = np.ones(task.sample.shape[:2], bool) if task.known is None else task.known ^ self.others
        y, x = np.nonzero(known)
        drawn = task.rng.integers(len(y), size=task.shape)
        source = np.stack([x[drawn], y[drawn], np.ones(task.shape)], -1).astype(np.float32)
        return Synthesis(task.sample[y[drawn], x[drawn]], source=source)


def _write(path: Path, hole: slice | None) -> None:
    alpha = np.full((40, 48), 255, np.uint8)
    if hole is not None:
        alpha[hole, hole] = 0
    PIL.Image.fromarray(np.dstack([PIXELS, alpha])).save(path)


def test_masks_are_part_of_a_run(tmp_path: Path) -> None:
    """Equal pixels with another mask are another cell, which keeps its mask; methods that ignore masks are refused."""
    for name, hole in (("whole", None), ("left", slice(5, 15)), ("right", slice(20, 30))):
        (tmp_path / "in").mkdir(exist_ok=True)
        _write(tmp_path / "in" / f"{name}.png", hole)
    methods = [KnownPixels(), KnownPixels(others=True), "scatter"]
    done = nrbench.run(tmp_path / "in", methods=methods, out=tmp_path / "R", options=Options(jobs=0), size="24x24")
    found = {(one.texture, one.method): one for one in done.cells}
    assert len({one.cell.key for one in done.cells}) == len(done.cells) == 9
    status = {key: one.status for key, one in found.items()}
    assert {status["whole", name] for name in ("known-pixels", "scatter")} == {"ok"}
    for texture in ("left", "right"):
        assert status[texture, "known-pixels"] == "ok" and status[texture, "scatter"] == "refused"
        assert "scatter cannot leave out" in found[texture, "scatter"].message
        wrong = found[texture, "known-pixels:others=True"]
        assert wrong.status == "invalid" and "576 pixels that the mask leaves out" in wrong.message
        mask = nrbench.read_image(found[texture, "known-pixels"].folder / "known.png")
        assert (mask == 0).sum() == 100


def test_a_sheet_leaves_out_what_a_mask_leaves_out(tmp_path: Path) -> None:
    """The mask of a sheet may be a file or an array."""
    _write(tmp_path / "a.png", None)
    mask = np.ones((40, 48), bool)
    mask[5:15] = False
    PIL.Image.fromarray(mask).save(tmp_path / "mask.png")
    for given in (mask, tmp_path / "mask.png"):
        table = nrbench.sheet(
            tmp_path / "a.png", tmp_path / "s.png", methods=[KnownPixels(), "scatter"], lattice="9,0,0,9", mask=given,
            size="24x24", options=Options(jobs=0),
        )  # fmt: skip
        assert dict(zip(table["method"], table["status"], strict=True)) == {"known-pixels": "ok", "scatter": "refused"}
