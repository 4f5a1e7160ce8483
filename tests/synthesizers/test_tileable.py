"""Outputs that repeat without a seam, by each method that can make them."""

import numpy as np
import pytest
from commands import call, refusal

import nrbench
from nrbench import plugins
from nrbench.calling.tileable import close_lattice
from nrbench.imaging.mean_tile import fold
from nrbench.synthesizers.canvas.canvas import Canvas
from nrbench.synthesizers.lattice_places.equal_places import CellTorus

SHAPE = (306, 231)
OTHERS = {"fftm-patch", "fftm-pixel", "representative-tile"}
"""Slow methods, whose own tests make tileable outputs, and one that refuses turned lattices."""
LOSING = {"ann-pixel", "gpdm", "gpnn", "random-phase", "scatter", "texture-optimization"}
"""They know no lattice, and lose it in any output."""
QUICK = {"gpdm": "gpdm:steps=60"}
ABLE = [one.name for one in plugins.inventory("synthesizers") if one.built_in and getattr(one.cls, "wraps", False)]


@pytest.fixture(scope="module")
def hexagons() -> nrbench.Texture:
    """Return turned hexagons, whose lattice closes on ``SHAPE`` by a strain of 1.1 %."""
    return nrbench.texture("hexagon", shape=(128, 128), seed=3, color=0.3, rotation=17)


def step_across_edges(image: nrbench.Image, axes: tuple[int, ...] = (0, 1)) -> float:
    """Return the mean step across the edges over the 0.99 quantile of the steps inside, the largest one of the axes."""
    ratios = []
    for axis in axes:
        steps = np.abs(np.roll(image, -1, axis) - image).mean((1 - axis, 2))
        ratios.append(steps[-1] / np.quantile(steps[:-1], 0.99))
    return float(max(ratios))


@pytest.mark.parametrize("name", sorted(set(ABLE) - OTHERS))
def test_opposite_edges_continue_each_other(name: str, hexagons: nrbench.Texture) -> None:
    """The edges are no rougher than the inside, and the closed lattice explains the outputs that keep a lattice."""
    made = nrbench.synthesize(QUICK.get(name, name), hexagons, SHAPE, hexagons.lattice, seed=1, tileable=True)
    assert step_across_edges(made.image) < 1.1
    if name in LOSING:
        return
    closed = close_lattice(hexagons.lattice, SHAPE)
    mean = fold(made.image, closed).unfold(SHAPE)
    assert np.square(made.image - mean).mean() < 0.35 * made.image.var()


def test_a_representative_tile_repeats_a_whole_number_of_times(hexagons: nrbench.Texture) -> None:
    """Upright tiles repeat at sizes that close; whole-pixel tiles at multiples of their size; turned tiles at none."""
    brick = nrbench.texture("brick", shape=(128, 128), seed=3, color=0.3)
    made = nrbench.synthesize("representative-tile", brick, (169, 189), brick.lattice, tileable=True)
    assert step_across_edges(made.image) < 1.1
    with pytest.raises(nrbench.Refused, match="--size 189x168"):
        nrbench.synthesize("representative-tile:rescale=false", brick, (169, 189), brick.lattice, tileable=True)
    with pytest.raises(nrbench.Refused, match="is turned"):
        nrbench.synthesize("representative-tile", hexagons, SHAPE, hexagons.lattice, tileable=True)


@pytest.mark.parametrize(("along", "shape"), [("x", (170, 196)), ("y", (196, 170))])
@pytest.mark.parametrize("name", ["tile-set", "quilting", "rsgf"])
def test_an_output_may_repeat_along_one_axis(name: str, along: str, shape: tuple[int, int]) -> None:
    """It continues across two edges, is cut between the others, and is part of an output that repeats along both.

    The side along which it repeats is the one that has to close.
    """
    brick = nrbench.texture("brick", (128, 128), seed=1, color=0.3, rotation=7.0 if along == "x" else 97.0)
    made = nrbench.synthesize(name, brick, shape, brick.lattice, seed=1, tileable=along)
    axis = 1 if along == "x" else 0
    assert made.image.shape[:2] == shape
    assert step_across_edges(made.image, (axis,)) < 1.1 and step_across_edges(made.image, (1 - axis,)) > 1.5
    assert made.source is None or made.source.shape[:2] == shape
    other = {"x": "y", "y": "x"}[along]
    with pytest.raises(nrbench.Refused, match=r"of \d+x\d+ px would need .* use --size (196x\d+|\d+x196)$"):
        nrbench.synthesize("rsgf", brick, shape, brick.lattice, tileable=other)
    for wrong in ("z", 2):
        with pytest.raises(nrbench.BadInput, match="give True, or one of both, x, y"):
            nrbench.synthesize("rsgf", brick, shape, tileable=wrong)


def test_the_option_takes_an_axis_or_stands_alone(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before a picture, before another option, and last, ``--tileable`` alone means both axes."""
    nrbench.write_image("wall.png", nrbench.texture("brick", (96, 96)).image)
    seen = []
    monkeypatch.setattr("nrbench.calling.tileable.synthesize_tileable", lambda method, task, along: seen.append(along))
    rest = "-m scatter --size 64x64 -o out.png"
    for line in (
        f"wall.png --tileable {rest}",
        f"--tileable wall.png {rest}",
        f"wall.png {rest} --tileable",
        f"--tileable x wall.png {rest}",
        f"wall.png {rest} --tileable=y",
        f"wall.png {rest} --tileable both",
    ):
        call(f"synth {line}")
    assert seen == ["both"] * 3 + ["x", "y", "both"]
    assert "'z' is not one of 'both', 'x', 'y'" in refusal(capsys, f"synth wall.png {rest} --tileable=z")


def test_other_outputs_have_edges(hexagons: nrbench.Texture) -> None:
    """Without the option, the edges are rougher than the inside, also at a size at which the lattice closes."""
    assert step_across_edges(nrbench.synthesize("rsgf", hexagons, SHAPE, hexagons.lattice, seed=1).image) > 1.8


@pytest.mark.parametrize("name", ["rsgf", "quilting", "graph-cuts"])
def test_a_texture_without_a_lattice_repeats(name: str) -> None:
    """A stochastic texture is not strained, and its opposite edges continue each other."""
    noise = np.random.default_rng(0).random((100, 100, 1))
    smooth = np.mean([np.roll(noise, (i, j), (0, 1)) for i in range(5) for j in range(5)], 0)
    sample = (smooth - smooth.min()) / np.ptp(smooth)
    assert step_across_edges(nrbench.synthesize(name, sample, (150, 170), seed=1, tileable=True).image) < 1.1
    strip = nrbench.synthesize(name, sample, (150, 170), seed=1, tileable="x").image
    assert strip.shape[:2] == (150, 170) and step_across_edges(strip, (1,)) < 1.1 < step_across_edges(strip, (0,))


def test_a_size_that_does_not_close_is_refused(hexagons: nrbench.Texture) -> None:
    """The message names a size that closes."""
    with pytest.raises(nrbench.Refused, match=r"strain of 7.5 % to close .*; use --size \d+x\d+"):
        nrbench.synthesize("rsgf", hexagons, (150, 170), hexagons.lattice, tileable=True)


@pytest.mark.parametrize(
    ("name", "reason"), [("rsgf:block=40,border=10", "even number of blocks"), ("tile-set", "at least as large")]
)
def test_an_output_smaller_than_its_patches_is_refused(name: str, reason: str) -> None:
    """A patch must not meet itself around the edges."""
    brick = nrbench.texture("brick", shape=(128, 128), seed=3, width=28, height=24, bond="stack")
    with pytest.raises(nrbench.Refused, match=reason):
        nrbench.synthesize(name, brick, (24, 28), brick.lattice, tileable=True)


def test_a_bent_sample_gives_a_straight_output_that_repeats() -> None:
    """The sample is straightened before its lattice is closed, and the source map leads to the bent sample."""
    bent = nrbench.texture("brick", shape=(160, 160), seed=1, bend=0.6, color=0.3)
    made = nrbench.synthesize("rsgf", bent, (244, 273), bent.lattice, tileable=True)
    assert "straightened" in made.note
    assert step_across_edges(made.image) < 1.2
    x, y = np.rint(made.source[..., :2]).astype(int).transpose(2, 0, 1)
    assert np.abs(bent.image[y, x] - made.image).mean() < 0.1


def test_methods_that_cannot_repeat_say_so(hexagons: nrbench.Texture) -> None:
    """The message names the methods that can."""
    with pytest.raises(nrbench.BadInput, match=r"cartoon cannot make an output that repeats without a seam; .*rsgf"):
        nrbench.synthesize("cartoon", hexagons, SHAPE, tileable=True)


def test_waves_run_on_around_a_torus_of_cells() -> None:
    """Products of transforms are convolutions on the torus, also if its border is shifted."""
    torus = CellTorus.of([(7, 0), (3, 5)])
    one, other = np.random.default_rng(0).standard_normal((2, torus.columns, torus.rows))
    cells = np.stack(np.indices(one.shape), -1)
    expected = np.zeros(one.shape)
    for i, j in np.ndindex(one.shape):
        expected += one[i, j] * other[tuple(np.moveaxis(torus.wrap(cells - (i, j)), -1, 0))]
    np.testing.assert_allclose(torus.invert(torus.transform(one) * torus.transform(other)), expected, atol=1e-12)


def test_turned_threads_meet_others() -> None:
    """Turned threads run on around the edges in one color; the note tells how many differ. Upright ones stay apart."""
    for rotation, shape, note in ((17.0, (260, 246), "edges and meet others: 2 differ"), (0.0, (250, 246), "")):
        weave = nrbench.texture("weave", shape=(128, 128), seed=3, color=0.3, rotation=rotation)
        made = nrbench.synthesize("resample", weave, shape, weave.lattice, tileable=True)
        assert note in made.note and bool(note) == ("meet others" in made.note)


def test_a_window_across_an_edge_goes_on_at_the_opposite_one() -> None:
    """What is placed across the corner of a canvas that wraps lies in its four corners, and is read again as it is."""
    canvas, window = Canvas((7, 5), 1, wrap=True), (4, 9, -2, 2)
    patch = np.arange(1, 21, dtype=np.float32).reshape(5, 4, 1), np.ones((5, 4, 3), np.float32)
    canvas.place(window, patch)
    np.testing.assert_array_equal(canvas.image[canvas.pixels(window)], patch[0])
    corners = canvas.image[np.ix_([0, 1, 4, 5, 6], [0, 1, 3, 4])][..., 0]
    np.testing.assert_array_equal(corners, np.roll(patch[0][..., 0], (2, 2), (0, 1)))
    assert canvas.known.sum() == 20
