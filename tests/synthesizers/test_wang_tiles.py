"""Claims about Wang tiles: their set, their edges, how they are laid, and what is written."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from synthesis_cases import noise

from nrbench.calling.method_calls import InvalidOutput, checked_synthesis
from nrbench.cli.picture_commands import synth_command
from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice
from nrbench.pictures.files import read_image, write_image
from nrbench.plugins.forms import Refused, Synthesis, Task
from nrbench.synthesizers.representative_tile import RepresentativeTile
from nrbench.synthesizers.wang_tiling.wang_tiles import WangTiles, pair_cycle

LATTICE = Lattice((12, 0), (0, 10))


def synthesize(sample: Image, shape: tuple[int, int], tileable: bool = False, colors: int = 2) -> Synthesis:
    """Run the method with Wang tiles of 24 x 20 px."""
    task = Task(sample, shape, LATTICE, np.random.default_rng(1), tileable=tileable)
    return RepresentativeTile(edge_colors=colors).synthesize(task)


def noisy_wall(shape: tuple[int, int] = (90, 96)) -> Image:
    """Return a picture that repeats by LATTICE, with noise: no two cells are equal."""
    y, x = np.indices(shape)
    cells = 0.5 + 0.15 * (np.cos(2 * np.pi * x / 12) + np.cos(2 * np.pi * y / 10))
    return np.asarray(cells[..., np.newaxis] + 0.2 * (noise(*shape) - 0.5), np.float32)


@pytest.mark.parametrize("colors", [1, 2, 3])
def test_each_pair_of_colors_follows_once_in_the_cycle(colors: int) -> None:
    """All ordered pairs of colors are neighbors in the cycle, so that the packed set has all combinations of four."""
    cycle = pair_cycle(colors)
    assert len(set(pairwise([*cycle, cycle[0]]))) == colors**2 == len(cycle)


def cut_set(colors: int) -> WangTiles:
    """Return the set that is cut from blocks of one value each: 0 for the corner, then the edges, then the tiles."""
    blocks = [np.zeros((10, 12, 3), np.float32) for _ in range(1 + 2 * colors + colors**4)]
    y, x = np.indices((10, 12))
    for k, block in enumerate(blocks):
        block[..., 0], block[..., 1], block[..., 2] = k / len(blocks), x, y + 100 * k
    return WangTiles.cut(blocks, colors)


def test_tiles_show_their_colors_at_their_edges() -> None:
    """Each edge shows the block of its color on either side, the corners one block, and the middle the tile's own."""
    tiles = cut_set(2)
    number = np.rint(tiles.layers[..., 0] * 21).astype(int)
    rules = json.loads(tiles.describe("a-"))
    for tile in rules["wangsets"][0]["wangtiles"]:
        own = number[divmod(tile["tileid"], 4)]
        top, right, bottom, left = tile["wangid"][::2]
        assert (own[0, 5:7] == top).all() and (own[-1, 5:7] == bottom).all()
        assert (own[4:6, 0] == left).all() and (own[4:6, -1] == right).all()
        assert not own[[0, 0, -1, -1], [0, -1, 0, -1]].any()
        assert own[4, 5] == 5 + tile["tileid"]
    assert len({tuple(tile["wangid"]) for tile in rules["wangsets"][0]["wangtiles"]}) == 16
    assert tiles.atlas.shape == (40, 48, 1) and (rules["imageheight"], rules["imagewidth"]) == (40, 48)


def test_neighbors_continue_each_other_across_their_edge() -> None:
    """Laid at random, tiles meet in one block of the sample: its rows and columns run on across each edge."""
    tiles = cut_set(2)
    rows, columns = tiles.lay((7, 9), np.random.default_rng(0))
    shown = tiles.layers[rows, columns]
    points = shown[..., 1:].swapaxes(1, 2).reshape(70, 108, 2)
    for axis, side, step in ((0, 10, [0, 1]), (1, 12, [1, 0])):
        jump = np.roll(points, -1, axis) - points
        assert (jump.take(range(side - 1, points.shape[axis], side), axis) == step).all()
    assert len(np.unique(rows * 4 + columns)) == 16


def test_the_output_keeps_the_lattice_and_is_no_wallpaper() -> None:
    """Every pixel is copied from an equal place of the sample, and the output does not repeat by its tiles."""
    sample = noisy_wall()
    made = synthesize(sample, (100, 120))
    assert made.source is not None and (made.source[..., 2] == 1).all()
    y, x = np.indices((100, 120))
    np.testing.assert_array_equal((made.source[..., 0] - x) % 12, 0)
    np.testing.assert_array_equal((made.source[..., 1] - y) % 10, 0)
    np.testing.assert_array_equal(made.image, sample[made.source[..., 1].astype(int), made.source[..., 0].astype(int)])
    assert np.abs(made.image[20:] - made.image[:-20]).mean() > 0.01


def test_an_output_of_whole_tiles_repeats() -> None:
    """With --tileable the tiles at opposite edges agree; a size that holds no whole number of tiles is refused."""
    source = synthesize(noisy_wall(), (40, 72), tileable=True).source
    np.testing.assert_array_equal((source[0] - source[-1])[:, 1] % 10, 1)
    across = source[:, 0, :2] - source[:, -1, :2]
    assert (np.abs(across - [1, 0]).max(1) == 0).sum() > 20
    with pytest.raises(Refused, match="24x20 px"):
        synthesize(noisy_wall(), (50, 72), tileable=True)


def test_small_samples_are_refused() -> None:
    """A sample with too few blocks for the colors is refused, and a number of colors that no set has is an error."""
    with pytest.raises(Refused, match="the sample holds 1 blocks of 2x2 tiles, 24x20 px"):
        synthesize(noisy_wall((24, 28)), (30, 30))


def test_the_best_tiles_come_with_their_tilings() -> None:
    """The m best tiles are apart; each tiling repeats its tile in the place where it lies (figure 4)."""
    sample = noisy_wall()
    task = Task(sample, (20, 20), LATTICE, np.random.default_rng(0))
    extras = RepresentativeTile(best_tiles=3).synthesize(task).extras
    assert (np.diff(extras["best"][:, 4]) >= 0).all()
    for number, (x, y) in enumerate(extras["best"][:, :2].astype(int), 1):
        tile, tiling = extras[f"best-{number:02d}"], extras[f"tiling-{number:02d}"]
        np.testing.assert_array_equal(tiling[y : y + 10, x : x + 12], tile)
        np.testing.assert_array_equal(tiling[10:, 12:], tiling[:-10, :-12])
        assert tiling.shape == sample.shape


def test_the_command_line_writes_the_atlas_and_its_rules(tmp_path: Path) -> None:
    """``synth --extras`` writes the packed tiles and a tileset that names their picture."""
    arguments = [write_image(tmp_path / "sample.png", noisy_wall()), "-m", "representative-tile:edge_colors=2"]
    arguments += ["--size", "48x40", "--lattice", "12,0,0,10", "-o", tmp_path / "out.png", "--extras"]
    done = CliRunner().invoke(synth_command, [str(word) for word in arguments])
    assert done.exit_code == 0, done.output
    rules = json.loads((tmp_path / "out-atlas.json").read_text())
    assert read_image(tmp_path / rules["image"]).shape == (80, 96, 3)
    assert (rules["tilewidth"], rules["tileheight"], rules["tilecount"], rules["columns"]) == (24, 20, 16, 4)


def test_files_are_functions_of_a_prefix() -> None:
    """The tileset names its picture with any prefix; a file that is no function, or returns no text, is refused."""
    sample = noisy_wall()
    made = synthesize(sample, (40, 48))
    for prefix in ("", 'a"b-'):
        assert json.loads(made.files["atlas.json"](prefix))["image"] == f"{prefix}atlas.png"
    for wrong in ("text", lambda prefix: 3):
        with pytest.raises(InvalidOutput, match=r"wrong file 'a.json': expected a function of a prefix"):
            checked_synthesis(replace(made, files={"a.json": wrong}), sample, (40, 48))
