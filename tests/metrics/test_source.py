import numpy as np
import pytest

from nrbench.metrics.source import SourceUse
from nrbench.plugins.forms import Observation, Score, SourceMap

SAMPLE = np.zeros((32, 48, 3), np.float32)


def use(source: SourceMap | None) -> Score:
    """Return the score of a source map, and check that every None has its reason."""
    output = SAMPLE if source is None else np.zeros((*source.shape[:2], 3), np.float32)
    score = SourceUse().score(Observation(SAMPLE, output, source=source))
    assert set(score.values) == set(SourceUse.columns)
    assert all(score.reasons.get(column) for column, value in score.values.items() if value is None)
    return score


def blocks(side: int, count: int, seed: int = 0) -> SourceMap:
    """Return the map of ``count`` x ``count`` square patches from random places."""
    rng = np.random.default_rng(seed)
    source = np.ones((side * count, side * count, 3), np.float32)
    y, x = np.indices((side, side))
    for row in range(count):
        for column in range(count):
            part = source[row * side : (row + 1) * side, column * side : (column + 1) * side]
            part[..., 0] = x + rng.integers(48 - side + 1)
            part[..., 1] = y + rng.integers(32 - side + 1)
    return source


def test_a_plain_copy_is_one_run() -> None:
    """In a copy of the sample the runs are as long as its sides, and all of it is used evenly."""
    y, x = np.indices((32, 48))
    values = use(np.stack([x, y, np.ones_like(x)], -1).astype(np.float32)).values
    assert values["mean_copy_length"] == pytest.approx(2 * 32 * 48 / (32 + 48))
    assert values["used"] == 1
    assert values["entropy"] == pytest.approx(1)


@pytest.mark.parametrize("side", [4, 8, 16])
def test_runs_are_as_long_as_the_patches(side: int) -> None:
    """Patches of n px give runs of about n px, also at real-valued places."""
    source = blocks(side, 8)
    assert use(source).values["mean_copy_length"] == pytest.approx(side, rel=0.1)
    source[..., :2] += np.float32(0.3)
    assert use(source).values["mean_copy_length"] == pytest.approx(side, rel=0.1)


def test_single_pixels_from_anywhere_have_runs_of_one() -> None:
    """Pixels in random order have runs of 1 px, and use the sample almost evenly."""
    rng = np.random.default_rng(0)
    source = np.stack([rng.integers(48, size=(99, 99)), rng.integers(32, size=(99, 99)), np.ones((99, 99))], -1)
    values = use(source.astype(np.float32)).values
    assert values["mean_copy_length"] == pytest.approx(1, abs=0.01)
    assert values["used"] > 0.99
    assert values["entropy"] > 0.98


def test_one_patch_repeated_uses_little() -> None:
    """A patch of 8 x 8 px that is repeated uses 64 pixels, and has their entropy."""
    values = use(np.tile(blocks(8, 1), (8, 8, 1))).values
    assert values["used"] == pytest.approx(64 / SAMPLE[..., 0].size)
    assert values["entropy"] == pytest.approx(np.log(64) / np.log(SAMPLE[..., 0].size))


def test_missing_scores_have_reasons() -> None:
    """Without a map, with an empty one, and for a single pixel the scores are None, with a reason."""
    assert set(use(None).reasons.values()) == {"not applicable: the method gives no source map"}
    empty = np.full((9, 9, 3), np.nan, np.float32)
    assert set(use(empty).reasons.values()) == {"not applicable: the source map names no pixel"}
    assert set(use(np.ones((1, 1, 3), np.float32)).reasons) == {"entropy"}


def test_pixels_without_a_source_break_runs() -> None:
    """Pixels of unknown source divide a copy, and do not count as used."""
    y, x = np.indices((16, 21))
    source = np.stack([x, y, np.ones_like(x)], -1).astype(np.float32)
    source[:, 10] = np.nan
    score = use(source)
    assert score.values["mean_copy_length"] == pytest.approx(2 * 320 / (2 * 16 + 20))
    assert score.records["mapped"] == pytest.approx(20 / 21)
