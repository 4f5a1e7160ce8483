"""The suites that are installed: what they promise of their textures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view

from nrbench.errors import BadInput
from nrbench.imaging.convert import Image, to_bytes
from nrbench.plugins.parameters import parse_size
from nrbench.suites.plan import Sample, draw_samples
from nrbench.suites.suite import builtin, load_suite, validated_suite

CORE = draw_samples(load_suite("core"))


def windows(image: Image, side: int = 16) -> set[bytes]:
    """Return every square window of an image as bytes."""
    views = sliding_window_view(to_bytes(image), (side, side), axis=(0, 1))
    return {window.tobytes() for row in views for window in row}


@pytest.mark.parametrize("sample", CORE, ids=lambda sample: sample.row.name)
def test_no_window_of_the_oracle_occurs_in_the_sample(sample: Sample) -> None:
    """A fresh draw shares no 16 x 16 window with the sample: it is independent of it, not a copy."""
    assert sample.texture is not None
    fresh = sample.recipe.again(sample.texture)((256, 256), 0)
    assert fresh is not None
    assert not windows(sample.texture.image) & windows(fresh.image)


@pytest.mark.parametrize("name", builtin())
def test_every_suite_loads(name: str) -> None:
    """Each installed suite is valid, says what it is, and names methods and textures."""
    suite = load_suite(name)
    assert suite.name == name and suite.description and suite.all_methods and suite.texture


def test_a_deep_file_is_bad_input(tmp_path: Path) -> None:
    """A file that is nested thousands of levels deep is refused in one sentence."""
    file = tmp_path / "deep.toml"
    file.write_text("x = " + "[" * 3000 + "]" * 3000)
    with pytest.raises(BadInput, match="nested too deeply"):
        load_suite(str(file))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"name": "x"}, "has no texture"),
        ({"name": "x", "sed": 3, "texture": [{"name": "a", "dataset": "brick"}]}, "did you mean 'seed'"),
        ({"name": "x", "texture": [{"name": "a", "dataset": "brick"}] * 2}, "two textures have the name 'a'"),
        ({"name": "x", "texture": [{"name": "a", "data": "brick"}]}, "did you mean 'dataset'"),
        ({"name": "x", "size": "3", "texture": [{"name": "a", "dataset": "brick"}]}, "write WIDTHxHEIGHT"),
        ({"name": "x", "seed": -1, "texture": [{"name": "a", "dataset": "brick"}]}, "seed"),
        ({"name": "a/b", "texture": [{"name": "a", "dataset": "brick"}]}, "name"),
    ],
)
def test_bad_suites(content: dict[str, object], message: str) -> None:
    """Each mistake in a suite is named, with the nearest valid key where there is one."""
    with pytest.raises(BadInput, match=message):
        validated_suite(content, "suite x")


def test_sizes() -> None:
    """``WIDTHxHEIGHT`` becomes (height, width)."""
    assert parse_size("256x128") == (128, 256)
    for bad in ("256", "0x3", "x", "3x-1", "99999x3", "axb"):
        with pytest.raises(BadInput, match=r"WIDTHxHEIGHT|from 1 to"):
            parse_size(bad)


def test_samples_are_rounded_to_8_bits() -> None:
    """The sample that a method sees is the one that the PNG holds."""
    texture = CORE[0].texture
    assert texture is not None
    np.testing.assert_array_equal(texture.image, to_bytes(texture.image) / np.float32(255))
