from pathlib import Path

import numpy as np
import pytest

from nrbench.errors import BadInput
from nrbench.imaging.convert import Image, quantize
from nrbench.imaging.files import write_image
from nrbench.plugins.forms import Refused, Synthesis, Task
from nrbench.synthesizers.precomputed import Precomputed, name_for


def noise(height: int, width: int, seed: int) -> Image:
    """Return noise of 8 bits."""
    return quantize(np.random.default_rng(seed).random((height, width, 3), np.float32))


SAMPLE, OUTPUT = noise(20, 24, 0), noise(30, 50, 1)


def look_up(folder: Path, sample: Image = SAMPLE, shape: tuple[int, int] = (30, 50)) -> Synthesis:
    """Ask the method for the output of a sample."""
    return Precomputed(str(folder)).synthesize(Task(sample, shape, None, np.random.default_rng(0)))


def test_a_file_named_by_the_samples_pixels_and_the_size_is_found(tmp_path: Path) -> None:
    """HASH-WIDTHxHEIGHT.png is the output for that sample at that size."""
    name = name_for(SAMPLE, (30, 50))
    assert name.endswith("-50x30.png")
    write_image(tmp_path / name, OUTPUT)
    np.testing.assert_array_equal(look_up(tmp_path).image, OUTPUT)


def test_a_table_pairs_files_under_any_names(tmp_path: Path) -> None:
    """index.csv pairs samples, compared by their pixels, with outputs; the row of the right size is taken."""
    for name, image in (
        ("a.png", noise(20, 24, 5)),
        ("b.png", SAMPLE),
        ("small.png", noise(9, 9, 2)),
        ("c.png", OUTPUT),
    ):
        write_image(tmp_path / name, image)
    (tmp_path / "index.csv").write_text("sample,output\na.png,c.png\nb.png,small.png\nb.png,c.png\n")
    np.testing.assert_array_equal(look_up(tmp_path).image, OUTPUT)
    assert look_up(tmp_path, shape=(9, 9)).image.shape == (9, 9, 3)


def test_where_there_is_none_the_refusal_tells_the_name_looked_for(tmp_path: Path) -> None:
    """An author learns how to name the file."""
    with pytest.raises(Refused, match=f"{name_for(SAMPLE, (30, 50))}.*index.csv"):
        look_up(tmp_path)


def test_a_missing_folder_is_bad_input(tmp_path: Path) -> None:
    """A folder that does not exist is the user's to mend."""
    with pytest.raises(BadInput, match="give the one that holds the outputs"):
        look_up(tmp_path / "none")


@pytest.mark.parametrize("name", ["../b.png", "/etc/hostname", "x/../../b.png"])
def test_a_table_reaches_no_file_outside_its_folder(tmp_path: Path, name: str) -> None:
    """A folder from a stranger cannot read other files."""
    (tmp_path / "index.csv").write_text(f"sample,output\n{name},b.png\n")
    with pytest.raises(BadInput, match=r"line 2: .* is not in"):
        look_up(tmp_path)


def test_a_table_without_its_columns_is_bad_input(tmp_path: Path) -> None:
    """The error about a table with other columns says what its first line must be."""
    (tmp_path / "index.csv").write_text("input,result\na.png,b.png\n")
    with pytest.raises(BadInput, match="first line must be sample,output"):
        look_up(tmp_path)
