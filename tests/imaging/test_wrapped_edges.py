"""Whether a picture repeats: pictures that do, one planted fault at a time, and pictures that show nothing."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from commands import answer_json, call
from scipy import ndimage

from nrbench import Lattice, score
from nrbench.errors import BadInput
from nrbench.imaging.convert import Image, quantize
from nrbench.imaging.wrapped_edges import measure_edges
from nrbench.pictures.files import read_image, write_image

LATTICE = Lattice((24, 0), (12, 11))


def wall(width: int = 192, height: int = 132, seed: int = 0, deviation: float = 0.1) -> Image:
    """Draw a wall that repeats every 192 x 132 px: bricks of 24 x 11 px, each of its own color, and grain."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width] % np.array([132, 192])[:, None, None] + 5
    row = y // 11
    right = x - 12 * (row % 2)
    color = rng.normal((0.6, 0.4, 0.3), deviation, (96, 3))[row % 12 * 8 + right // 24 % 8]
    joint = (right % 24 < 2) | (y % 11 < 2)
    grain = np.tile(rng.normal(0, 0.02, (132, 192, 1)), (2, 2, 1))[:height, :width]
    return quantize(np.clip(np.where(joint[..., None], 0.75, color) + grain, 0, 1).astype(np.float32))


def noise(sigma: float, seed: int = 1) -> Image:
    """Draw noise that repeats, smooth over some px."""
    values = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal((120, 150)), sigma, mode="wrap")
    return (0.5 + 0.1 * values / values.std()).clip(0, 1).astype(np.float32)[..., np.newaxis]


@pytest.mark.parametrize("image", [wall(), wall(seed=2, deviation=0.02), noise(1), noise(6)], ids=range(4))
def test_a_picture_that_repeats_does_so_wherever_it_is_cut(image: Image) -> None:
    """Both edges of a wall, and of fine and of smooth noise, lie within the limits, whichever column comes first."""
    lattice = LATTICE if image.shape[2] == 3 else None
    for shift in (0, 7, 40):
        rolled = np.roll(image, shift, (0, 1))
        assert all(edge.ratio < 1 and edge.score > 0.5 for edge in measure_edges(rolled, lattice))


@pytest.mark.parametrize(
    ("name", "spoil"),
    [
        ("lattice", lambda image: image[:, 1:]),
        ("lattice", lambda image: image[:, 4:]),
        ("lattice", lambda image: image[:, 12:]),
        ("step", lambda image: image[:, np.r_[:192, 0]]),
        ("color", lambda image: image * np.linspace(0.96, 1.04, 192, dtype=np.float32)[:, np.newaxis]),
        (
            "sharpness",
            lambda image: np.where(
                (np.arange(192) % 188 < 4)[:, None], ndimage.gaussian_filter(image, (1, 1, 0), mode="wrap"), image
            ),
        ),
    ],
    ids=["1 px", "4 px", "half a brick", "doubled", "brighter", "blurred"],
)
def test_a_fault_at_the_right_edge_is_found(name: str, spoil: Callable[[Image], Image]) -> None:
    """Columns lost or doubled, a step of brightness and a blur break x by the number that is meant, but not y."""
    right, lower = measure_edges(spoil(wall(deviation=0.04)), LATTICE)
    assert right.ratios[name] > 1 and right.score < 0.5
    assert lower.ratio < 1.1


def test_the_score_falls_steadily() -> None:
    """The more columns are lost, up to half a period, the lower is the score."""
    scores = [measure_edges(wall(deviation=0.04)[:, lost:], LATTICE)[0].score for lost in (0, 1, 2, 4, 6)]
    assert scores == sorted(scores, reverse=True) and len(set(scores)) == 5


def test_noise_is_judged_by_its_gradients() -> None:
    """Noise that lost 20 columns breaks along x alone, and the reasons say that there is no lattice."""
    found = score(noise(3)[:, 20:], tileable=True)
    assert found.values["tileable.x.repeats"] is False and found.values["tileable.y.repeats"] is True
    assert found.values["tileable.x.lattice"] is None and "no lattice" in found.reasons["tileable.x.lattice"]


@pytest.mark.parametrize(
    ("image", "expected"),
    [
        (np.full((40, 40, 1), 0.5, np.float32), True),
        (np.full((9, 40, 3), 0.2, np.float32), None),
        (wall(24, 22, deviation=0.0), True),
        (wall(48, 44, deviation=0.0), True),
        (quantize(wall() * np.float32(0.02), 16), True),
    ],
    ids=["one value", "tiny", "one cell", "four cells", "16 bits, dark"],
)
def test_small_and_flat_pictures(image: Image, expected: bool | None) -> None:
    """One gray value repeats; too short a side cannot be told; few cells are judged by colors; 16 bits are kept."""
    assert score(image, tileable=True, lattice=LATTICE).values["tileable.y.repeats"] is expected


def test_the_command_says_where_a_picture_breaks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`score --tileable` prints a line for each axis, draws the seam of x alone, and gives booleans as JSON."""
    write_image(tmp_path / "wall.png", wall(deviation=0.04)[:, 6:])
    assert call("score --tileable wall.png -o seam.png --lattice 24,0,12,11") == 0
    first, second, _ = capsys.readouterr().out.splitlines()
    assert first.startswith("x: breaks at the right edge") and second.startswith("y: repeats")
    seam = read_image(tmp_path / "seam.png")
    pink = (seam == quantize(np.array([1.0, 0.1, 0.6], np.float32))).all(-1)
    assert set(np.flatnonzero(pink.any(0))) == {92, 93}
    values = answer_json(capsys, "score --tileable wall.png --json --lattice 24,0,12,11")
    assert values["tileable.x.repeats"] is False and values["tileable.y.repeats"] is True


def test_one_picture_or_two(tmp_path: Path) -> None:
    """A sample without an output, or --tileable with an output or metrics, is refused."""
    write_image(tmp_path / "wall.png", wall())
    for text in (
        "",
        "wall.png --tileable",
        "--tileable --metrics quality",
        "wall.png -o seam.png",
        "--tileable -o wall.png",
    ):
        assert call(f"score wall.png {text}") == 2
    with pytest.raises(BadInput, match="one picture"):
        score(wall(), wall(), tileable=True)
