"""Claims about planted defects: each has the size of its parameter, and is known to the pixel."""

from dataclasses import replace

import numpy as np
import pytest
from planted_cases import LARGEST, MODELS, NEEDS_NO_LATTICE, TEXTURE, TEXTURES, Draws, S, plant, planted
from scipy.ndimage import gaussian_filter

from nrbench.datasets_procedural.brick import Brick
from nrbench.errors import BadInput
from nrbench.imaging.mean_tile import fold
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Refused, Shape, Texture
from nrbench.synthesizers.planted import DEFECTS, Planted, read_displaced


@pytest.mark.parametrize("kind", DEFECTS)
@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("shape", [(101, 77), (40, 33), (8, 8)])
def test_every_kind_fits_every_shape(kind: str, name: str, shape: Shape) -> None:
    """An image of any shape has the defect, and the note names it; or, in the smallest image, it is refused."""
    seed = list(MODELS).index(name)
    try:
        image, displacement, covered, fresh, _ = planted(kind, 0.4, name, shape, seed)
    except Refused as refusal:
        assert shape == (8, 8) or (kind, name) == ("noise", "plain"), refusal
        assert "covers no pixel" in refusal.reason
        return
    assert displacement.shape == (*shape, 2) and covered.shape == shape
    assert image.shape == (*shape, 3) and image.dtype == np.float32
    assert 0 <= image.min() <= image.max() <= 1
    assert name != "brick" or kind in plant(kind, 0.4, seed, Draws(name), shape).note
    np.testing.assert_array_equal(image[~covered], fresh[~covered])
    assert covered.any() == (image[covered] != fresh[covered]).any() == (kind != "none")


@pytest.mark.parametrize("kind", ["phase-step", "displaced-tile", "off-lattice"])
@pytest.mark.parametrize("size", [0.15, 0.3, 0.5])
def test_content_moves_as_far_as_the_size_says(kind: str, size: float) -> None:
    """The largest displacement is the size, to within a pixel's rounding, and the note gives it."""
    made = plant(kind, size)
    distance = np.hypot(*np.moveaxis(made.extras["displacement"], -1, 0)).max()
    assert distance == pytest.approx(size * S, abs=0.6)
    assert f"({distance:.1f} px)" in made.note


@pytest.mark.parametrize("name", ["brick", "weave", "hexagon"])
@pytest.mark.parametrize("kind", ["off-lattice", "slipped-course", "dropped-row", "doubled-row", "doubled-tile"])
def test_moved_content_is_the_draw_itself(kind: str, name: str) -> None:
    """Each pixel is, to the bit, the pixel of one wider fresh draw that its displacement points at."""
    image, field, _, _, again = planted(kind, 0.3, name)
    margin = (again.seen[-1].shape[0] - 150) // 2
    y, x = np.indices((150, 180)) + margin
    assert field.any()
    np.testing.assert_array_equal(field, np.rint(field))
    dx, dy = np.moveaxis(field.astype(int), -1, 0)
    np.testing.assert_array_equal(image, again.seen[-1][y - dy, x - dx])


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("kind", DEFECTS)
def test_size_zero_is_the_fresh_draw(kind: str, name: str) -> None:
    """At size 0 the output is the draw, to the bit, nothing has moved, and no pixel is covered."""
    image, field, covered, fresh, _ = planted(kind, 0.0, name)
    np.testing.assert_array_equal(image, fresh)
    assert not field.any() and not covered.any()


@pytest.mark.parametrize("name", ["brick", "weave", "hexagon"])
@pytest.mark.parametrize("kind", [kind for kind in DEFECTS if kind != "none"])
def test_the_difference_grows_with_the_size(kind: str, name: str) -> None:
    """Below saturation, a larger defect differs more from the draw, on average over some seeds."""
    sizes = LARGEST.get(kind, 1.0) * np.array([0, 0.25, 0.5, 1])
    cases = [[planted(kind, float(size), name, (100, 100), seed) for seed in range(3 if size else 1)] for size in sizes]
    change = [np.mean([np.abs(image - fresh).mean() for image, _, _, fresh, _ in case]) for case in cases]
    assert change[0] == 0
    assert (np.diff(change) > 0).all(), change


def test_a_course_slides_along_itself() -> None:
    """Between two joints, and nowhere else, bricks move along t1 by the size, half a brick at most."""
    _, field, covered, *_ = planted("slipped-course", 0.5, "plain")
    s = TEXTURES["plain"].lattice.s
    assert np.unique(np.abs(field[covered]), axis=0).tolist() == [[round(s / 2), 0]]
    assert covered.all(1).sum() == covered.any(1).sum() == 12
    assert np.abs(planted("slipped-course", 1.0, "plain")[1]).max() == 15


@pytest.mark.parametrize(("kind", "step"), [("dropped-row", -3), ("doubled-row", 3)])
def test_rows_close_up_or_make_room(kind: str, step: int) -> None:
    """Everything beyond a joint moves by a quarter of a course of 12 px, and by half of it at most."""
    image, field, covered, fresh, _ = planted(kind, 0.25, "plain")
    first = int(np.argmax(covered[:, 0]))
    assert (covered == (np.arange(150) >= first)[:, np.newaxis]).all()
    assert np.unique(field[covered], axis=0).tolist() == [[0, step]]
    np.testing.assert_array_equal(image[first : first + 9], fresh[first - step : first - step + 9])
    assert np.abs(planted(kind, 1.0, "plain")[1]).max() == 6


def test_a_doubled_tile_leaves_its_original() -> None:
    """The copy shows, next to it, pixels that the output still holds where it does not hide them."""
    image, field, covered, fresh, _ = planted("doubled-tile", 0.5)
    step = np.unique(field[covered], axis=0).astype(int)
    assert len(step) == 1
    assert covered.sum() == pytest.approx(TEXTURE.lattice.area, rel=0.1)
    moved = np.roll(fresh, step[0, ::-1], (0, 1))
    np.testing.assert_array_equal(image, np.where(covered[..., np.newaxis], moved, fresh))


def test_a_warp_is_smooth_and_as_large_as_its_size() -> None:
    """Its largest displacement is the size, its steps between pixels are small, its correlation falls to 1/e at 2 s."""
    fields = [planted("warp", 0.4, shape=(200, 200), seed=seed)[1] for seed in range(3)]
    assert [np.hypot(*np.moveaxis(field, -1, 0)).max() for field in fields] == pytest.approx([0.4 * S] * 3, rel=1e-5)
    assert max(np.abs(np.diff(field, axis=0)).max() for field in fields) < 0.4
    lag = round(2 * S)
    pairs = [(field[:, lag:] * field[:, :-lag]).mean() / (field**2).mean() for field in fields]
    assert np.mean(pairs) == pytest.approx(np.exp(-1), abs=0.2)


def test_a_stretch_is_the_fraction_of_its_size() -> None:
    """Along one axis content moves in proportion to its distance from the middle; across it, it does not move."""
    field = planted("stretch", 0.02, shape=(101, 101))[1]
    y, x = np.indices((101, 101)) - 50
    slopes = np.linalg.lstsq(np.stack([x.ravel(), y.ravel()], 1), field.reshape(-1, 2), rcond=None)[0]
    assert np.linalg.eigvalsh(slopes) == pytest.approx([0, 0.02 / 1.02], abs=1e-6)
    assert not field[50, 50].any()


def test_a_seam_steps_by_its_contrast() -> None:
    """Brightness jumps by the size at the line, and nothing changes 16 px away from it."""
    image, _, covered, fresh, _ = planted("seam", 0.1)
    change = (image - fresh)[..., 0]
    assert change.max() - change.min() == pytest.approx(0.1, abs=0.01)
    assert np.abs(change[covered]).min() < 0.002


@pytest.mark.parametrize("size", [0.02, 0.1, 0.2])
def test_the_mean_color_moves_by_the_size(size: float) -> None:
    """The distance between the means of draw and output is the size, where nothing is clipped."""
    image, _, _, fresh, _ = planted("color-mean", size)
    assert np.linalg.norm((image - fresh).mean((0, 1), np.float64)) == pytest.approx(size, rel=0.05)


def test_a_blurred_band_loses_detail() -> None:
    """A quarter of the output loses most of its differences between neighbors."""
    image, _, covered, fresh, _ = planted("blurred-band", 0.25)
    inside = covered[1:] & covered[:-1]
    detail = [np.abs(np.diff(pixels, axis=0))[inside].mean() for pixels in (image, fresh)]
    assert covered.mean() == pytest.approx(0.25, abs=0.01)
    assert detail[0] < 0.4 * detail[1]


def test_a_blur_and_a_loss_of_contrast_are_as_strong_as_the_size() -> None:
    """A blur is the Gaussian of that standard deviation; a loss of contrast leaves the rest of all departures."""
    image, *_, fresh, _ = planted("blur", 0.8)
    np.testing.assert_allclose(image, gaussian_filter(fresh, (0.8, 0.8, 0), mode="mirror"), atol=1e-6)
    image, *_, fresh, _ = planted("contrast", 0.2)
    np.testing.assert_allclose(image - fresh.mean((0, 1)), 0.8 * (fresh - fresh.mean((0, 1))), atol=1e-5)


def test_noise_keeps_variance_and_tones() -> None:
    """The fine departures are as strong as before, and differ; tones of elements stay."""
    image, _, _, fresh, again = planted("noise", 1.0, "hexagon", (160, 160))
    ideal = again.model.again(again.texture, (160, 160), np.random.default_rng(0)).ideal
    own, before = image - ideal, fresh - ideal
    fine = [one - gaussian_filter(one, (4, 4, 0)) for one in (own, before)]
    assert fine[0].std() == pytest.approx(fine[1].std(), rel=0.05)
    assert abs(np.corrcoef(fine[0].ravel(), fine[1].ravel())[0, 1]) < 0.3
    tones = [one.reshape(10, 16, 10, 16, 3).mean((1, 3)).ravel() for one in (own, before)]
    assert np.corrcoef(*tones)[0, 1] > 0.95


@pytest.mark.parametrize("name", ["brick", "weave", "hexagon"])
def test_two_tone_joins_two_draws_in_place(name: str) -> None:
    """Half of each affected tile is another draw's, pixel for pixel; the share of affected tiles is the size."""
    image, _, covered, fresh, again = planted("two-tone", 0.5, name)
    np.testing.assert_array_equal(image, np.where(covered[..., np.newaxis], again.seen[-1], fresh))
    assert covered.mean() == pytest.approx(0.25, abs=0.04)


@pytest.mark.parametrize("name", ["brick", "weave", "hexagon"])
def test_torn_tiles_show_another_draw_beside_its_place(name: str) -> None:
    """Some of the pixels of each affected tile are another draw's, moved by a quarter of s; the others stay."""
    image, field, covered, _, again = planted("torn", 0.5, name)
    margin = (again.seen[-1].shape[0] - 150) // 2
    y, x = np.nonzero(covered)
    dx, dy = field[covered].astype(int).T
    np.testing.assert_array_equal(image[covered], again.seen[-1][y + margin - dy, x + margin - dx])
    s = TEXTURES[name].lattice.s
    assert np.hypot(dx, dy) == pytest.approx(np.full(len(dx), s / 4), abs=0.75)
    assert 0.15 < covered.mean() < 0.35


def test_a_new_color_is_none_of_the_texture() -> None:
    """Its tiles keep their brightness, and their color is far from those of all tiles of the draw; joints stay."""
    image, _, covered, fresh, _ = planted("new-color", 0.3, "hexagon")
    luma = np.array([0.299, 0.587, 0.114])
    assert np.abs((image - fresh) @ luma).mean() < 0.002
    change = gaussian_filter(np.abs(image - fresh).max(-1), 1) > 0.15
    soft, was = (gaussian_filter(one, (1.5, 1.5, 0)) for one in (image, fresh))
    far = [np.linalg.norm(was.reshape(-1, 3) - color, axis=1).min() for color in soft[change][::97]]
    assert np.median(far) > 0.1 and 0.15 < change.mean() < 0.35
    assert np.abs(image - fresh).max(-1)[covered].min() < 0.01


def test_a_wrong_surface_keeps_amplitudes_and_loses_structure() -> None:
    """On streaks, the values spread as widely at each place of the cell, and as much along the streaks as across."""
    model = Brick(width=30, height=12, phase=(0.2, 0.3), color=0.1, material="wood")
    texture = model.render((128, 128), np.random.default_rng(0))

    def rest(size: float) -> np.ndarray:
        def again(shape: Shape, k: int) -> Texture:
            return model.again(texture, shape, np.random.default_rng(k))

        ideal = again((200, 200), 0).ideal
        return plant("wrong-surface", size, again=again, shape=(200, 200)).image - ideal

    before, after = rest(0.0), rest(1.0)
    tones = [fold(one * one, Lattice((30, 0), (15, 12))).values[..., 1].ravel() for one in (before, after)]
    assert np.corrcoef(*tones)[0, 1] > 0.9 and tones[0].mean() == pytest.approx(tones[1].mean(), rel=0.1)
    fine = [one - gaussian_filter(one, (2, 2, 0)) for one in (before, after)]
    slopes = [np.diff(one, axis=0).std() / np.diff(one, axis=1).std() for one in fine]
    assert slopes[0] > 1.5 and slopes[1] == pytest.approx(1, abs=0.15)


@pytest.mark.parametrize("name", ["brick", "weave", "hexagon"])
def test_over_regular_repeats_one_tile(name: str) -> None:
    """At full weight every pixel is one of a single tile's; at half weight, half of it is."""
    image, field, _, fresh, _ = planted("over-regular", 1.0, name)
    colors = np.unique(image.reshape(-1, 3), axis=0)
    assert len(colors) < 1.5 * TEXTURES[name].lattice.area
    rest = TEXTURES[name].lattice.wrap(field)
    assert np.hypot(rest[..., 0], rest[..., 1]).max() < 0.8
    np.testing.assert_allclose(planted("over-regular", 0.5, name)[0], (image + fresh) / 2, atol=1e-6)


@pytest.mark.parametrize("name", ["brick", "weave", "hexagon"])
@pytest.mark.parametrize(("size", "share"), [(0.1, 0.1), (0.3, 0.3), (0.9, 0.5)])
def test_verbatim_copies_lie_elsewhere_in_the_output(name: str, size: float, share: float) -> None:
    """The share of the area that the size says is equal, to the bit, to equivalent places of the output."""
    image, field, covered, *_ = planted("verbatim", size, name, (200, 200))
    assert covered.mean() == pytest.approx(share, abs=1e-4)
    y, x = np.nonzero(covered)
    dx, dy = field[covered].astype(int).T
    np.testing.assert_array_equal(image[y, x], image[y - dy, x - dx])
    assert not covered[y - dy, x - dx].any()
    rest = TEXTURES[name].lattice.wrap(field[covered])
    assert np.hypot(rest[..., 0], rest[..., 1]).max() < 0.8


def test_a_phase_step_moves_one_half() -> None:
    """Half of the pixels move, all alike."""
    field = plant("phase-step", 0.3).extras["displacement"].reshape(-1, 2)
    assert len(np.unique(field, axis=0)) == 2
    assert field.any(1).mean() == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("seed", range(5))
def test_one_tile_is_one_cell_inside(seed: int) -> None:
    """The displaced and the missing tile have a cell's area and lie whole within the output."""
    moved = plant("displaced-tile", 0.3, seed).extras["displacement"].any(-1)
    covered = plant("missing-tile", 1.0, seed).extras["covered"] > 0
    for tile in (moved, covered):
        assert tile.sum() == pytest.approx(TEXTURE.lattice.area, rel=0.1)
        assert not (tile[0].any() or tile[-1].any() or tile[:, 0].any() or tile[:, -1].any())


def test_a_covered_tile_is_flat() -> None:
    """Full opacity leaves one color; half of it leaves half the contrast."""
    full, half, none = (plant("missing-tile", size) for size in (1.0, 0.5, 0.0))
    tile = full.extras["covered"] > 0
    assert full.image[tile].std(0).max() < 1e-6
    np.testing.assert_allclose(half.image[tile].std(0), none.image[tile].std(0) / 2, rtol=1e-4)
    np.testing.assert_array_equal(full.image[~tile], none.image[~tile])


@pytest.mark.parametrize("kind", DEFECTS)
def test_equal_seeds_give_equal_bytes(kind: str) -> None:
    """The task's generator decides everything."""
    np.testing.assert_array_equal(plant(kind, 0.3, 4).image, plant(kind, 0.3, 4).image)
    assert (plant(kind, 0.3, 4).image != plant(kind, 0.3, 5).image).any()


def test_wrong_parameters_say_what_to_do() -> None:
    """An unknown kind and a size out of range are bad input."""
    with pytest.raises(BadInput, match=r"kind 'dropped-rows' is unknown \(did you mean 'dropped-row'\?\)"):
        Planted("dropped-rows")
    with pytest.raises(BadInput, match=r"size 1\.5; choose from 0 to 1"):
        Planted("phase-step", 1.5)


@pytest.mark.parametrize("kind", DEFECTS)
def test_without_fresh_draws_or_lattice_it_refuses(kind: str) -> None:
    """A photograph is refused, and a texture without a lattice where the kind needs one."""

    def chaotic(shape: Shape, k: int) -> Texture:
        return replace(TEXTURE, image=np.random.default_rng(k).random((*shape, 1), np.float32), lattice=None)

    with pytest.raises(Refused, match="no fresh draws"):
        plant(kind, 0, again=None)
    if kind in NEEDS_NO_LATTICE:
        assert kind in plant(kind, 0.3, again=chaotic).note
    else:
        with pytest.raises(Refused, match="no lattice"):
            plant(kind, 0.3, again=chaotic)


@pytest.mark.parametrize(
    ("kind", "size", "shape"),
    [
        ("doubled-tile", 0.4, (1, 1)),
        ("verbatim", 0.4, (8, 8)),
        ("blurred-band", 1.0, (1, 1)),
        ("missing-tile", 1.0, (1, 1)),
        ("stretch", 1.0, (1, 1)),
        ("phase-step", 0.01, (64, 48)),
        ("two-tone", 0.001, (64, 48)),
    ],
)
def test_an_empty_defect_is_refused(kind: str, size: float, shape: Shape) -> None:
    """A defect without room, or of less than a pixel or a tile, is refused."""
    with pytest.raises(Refused, match=rf"planted: {kind} of size .* covers no pixel .* give a larger size or output"):
        plant(kind, size, shape=shape)


def test_a_margin_that_is_too_small_is_an_error() -> None:
    """Content that would come from beyond the draw is an error, not the content of the opposite side."""
    with pytest.raises(IndexError, match="a margin of 2 px is too small for displacements of 3 px"):
        read_displaced(np.zeros((14, 14, 1), np.float32), 2, np.full((10, 10, 2), 3))


def test_the_lattice_costs_no_draw_of_the_sample() -> None:
    """All that is drawn beside the output is the smallest draw there is."""
    again = Draws()
    plant("phase-step", 0.3, again=again)
    assert [image.shape[:2] for image in again.seen[:-1]] == [(8, 8)]
