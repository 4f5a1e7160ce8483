from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from nrbench.cli.single_images import synth_command
from nrbench.errors import BadInput
from nrbench.imaging.convert import quantize
from nrbench.imaging.files import read_image, write_image
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Refused, Task
from nrbench.synthesizers.representative_tile import RepresentativeTile

from .test_representative_tile import OBLIQUE, UPRIGHT, noise, synthesize, waves

PAPER = RepresentativeTile(**RepresentativeTile.presets["paper"])


def test_an_oblique_lattice_gets_a_rectangle_within_tolerance_or_is_refused() -> None:
    """Without tolerance no rectangle repeats; with some, one does."""
    sample = quantize(waves((128, 128), OBLIQUE))
    with pytest.raises(Refused, match="larger than the sample"):
        synthesize(sample, (64, 64), OBLIQUE, tolerance=0.0)
    assert synthesize(sample, (64, 64), OBLIQUE).extras["tile"].ndim == 3


def test_without_a_lattice_given_its_period_is_that_of_ssdn() -> None:
    """On a stacked wall without a given lattice the sub-pixel period is found, used and reported, with its cost."""
    sample = quantize(waves((128, 128), UPRIGHT))
    made = synthesize(sample, (400, 400), None)
    assert made.lattice is not None and made.detection_seconds > 0
    assert np.abs(np.sort(np.abs(made.lattice.matrix).max(0)) - (18.81, 21.37)).max() < 0.05
    last = synthesize(sample, (64, 64), None, finder="ssdn:preset=paper").lattice
    assert last is not None and last != made.lattice
    peaks = [round(5 * 21.37), round(6 * 18.81)]
    assert np.abs(np.array([last.matrix.max(0)[0] * 5, last.matrix.max(0)[1] * 6]) - peaks).max() < 1


def test_noise_is_refused_and_the_paper_goes_on() -> None:
    """Where no period is better than chance there is no tile; the paper takes the last minimum all the same."""
    sample = noise(64, 64, seed=23)
    with pytest.raises(Refused, match="no lattice found"):
        synthesize(sample, (64, 64), None)
    assert PAPER.synthesize(Task(sample, (64, 64), None, np.random.default_rng(0))).image.shape == (64, 64, 3)


def test_samples_with_less_than_two_periods_are_refused() -> None:
    """The refusal says how far the lattice reaches, and how much there is of it."""
    with pytest.raises(Refused, match="less than two periods"):
        synthesize(noise(70, 70), (256, 256), Lattice((36, 0), (0, 20)))


@pytest.mark.parametrize(
    "parameters",
    [
        {"continuity_weight": -1.0},
        {"continuity_weight": 1e308},
        {"rated_share": 0.0},
        {"rated_share": 1.5},
        {"best_tiles": 0},
        {"best_tiles": 100},
        {"tolerance": 0.5},
    ],
)
def test_parameters_out_of_range_are_refused(parameters: dict[str, Any]) -> None:
    """Each says which parameter it is, and what to choose."""
    with pytest.raises(BadInput, match=f"^representative-tile: .*{next(iter(parameters))}.*choose"):
        RepresentativeTile(**parameters)


def test_a_flat_sample_gives_a_flat_output() -> None:
    """Nothing to rate is no error."""
    made = synthesize(np.full((60, 60, 1), 0.4, np.float32), (40, 40), UPRIGHT)
    np.testing.assert_allclose(made.image, 0.4, atol=1e-6)


def test_every_parameter_changes_something() -> None:
    """No parameter is without effect on a sample whose tiles differ, in brightness, too."""
    light = np.linspace(0.4, 1, 128, dtype=np.float32)[:, np.newaxis, np.newaxis]
    sample = quantize(light * (0.7 * waves((128, 128), UPRIGHT) + 0.3 * noise(128, 128)))
    base = synthesize(sample, (80, 80), UPRIGHT).image
    changes: list[dict[str, Any]] = [
        {"continuity_weight": 0.0}, {"rated_share": 1e-4}, {"best_tiles": 50}, {"rescale": False},
    ]  # fmt: skip
    for change in changes:
        assert (synthesize(sample, (80, 80), UPRIGHT, **change).image != base).any(), change
    plain = quantize(waves((128, 128), UPRIGHT))
    finders = RepresentativeTile.finder, "ssdn:preset=paper"
    found, last = (synthesize(plain, (80, 80), None, finder=finder).image for finder in finders)
    assert (found != last).any()
    oblique = Lattice((20.3, 0), (6.1, 18.7))
    slanted = quantize(waves((128, 128), oblique))
    sizes = {synthesize(slanted, (9, 9), oblique, tolerance=share).extras["tile"].shape for share in (0.05, 0.1)}
    assert sizes == {(60, 50, 3), (23, 32, 3)}


def test_the_command_line_writes_the_tile_beside_the_output(tmp_path: Path) -> None:
    """``synth`` writes the tile as a picture of its own: repeated, it is the paper's output."""
    sample = noise(60, 66, 1)
    arguments = [write_image(tmp_path / "sample.png", sample), "-m", "representative-tile:rescale=false"]
    arguments += ["--size", "40x30", "--lattice", "11,0,0,9", "-o", tmp_path / "out.png"]
    done = CliRunner().invoke(synth_command, [str(word) for word in arguments])
    assert done.exit_code == 0, done.output
    tile, output = read_image(tmp_path / "out-tile.png"), read_image(tmp_path / "out.png")
    windows = (output[y : y + 9, x : x + 11] for y, x in np.ndindex(9, 11))
    assert tile.shape == (9, 11, 1) and any(np.array_equal(window, tile) for window in windows)
