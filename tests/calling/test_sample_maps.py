"""Materials of several maps: one layout for colors, normals and heights, and the alpha channel of fences."""

from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
import tifffile
from numpy.typing import NDArray

import nrbench
from nrbench.errors import BadInput
from nrbench.imaging.convert import Image, gray, quantize
from nrbench.imaging.source_maps import are_normals
from nrbench.pictures.files import read_map, write_image, write_map
from nrbench.plugins import inventory
from tests.shared.commands import call

WALL = nrbench.texture("brick", (112, 120), seed=3, color=0.3, noise=0.05)
FAST = {
    "ann-pixel": "neighborhood=2,search=k-coherence",
    "gpnn": "iterations=2,first_iterations=3",
    "graph-cuts": "passes=0",
    "quilting": "block=24",
    "texture-optimization": "iterations=2",
}
"""Parameters with which slow methods take less time."""
SLOW = "fftm-patch", "fftm-pixel"
ABLE = [one.name for one in inventory("synthesizers") if getattr(one.cls, "maps", "") and one.name not in SLOW]
Values = NDArray[Any]


def heights_of(image: Image) -> Values:
    """Return heights of 16 bits that go with the brightness of an image."""
    return np.rint(65535 * (0.2 + 0.6 * gray(image))).astype(np.uint16)


def normals_of(heights: Values, bits: int = 8) -> Values:
    """Return the normals of heights, as a picture holds them."""
    down, across = np.gradient(heights / 65535 * 6)
    vectors = np.stack([-across, -down, np.ones_like(down)], -1)
    units = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True) / 2 + 0.5
    return np.rint(units * (2**bits - 1)).astype(np.uint8 if bits == 8 else np.uint16)


def lengths(normals: Values) -> Values:
    """Return the lengths of the vectors of a normal map."""
    return np.asarray(np.linalg.norm(2 * (normals / np.iinfo(normals.dtype).max) - 1, axis=-1))


def method(name: str) -> str:
    """Return a method with parameters that make it fast."""
    return f"{name}:{FAST[name]}" if name in FAST else name


@pytest.mark.parametrize("name", ABLE)
def test_heights_go_with_colors_in_the_output_as_in_the_sample(name: str) -> None:
    """Correlation of brightness and height within .02 of the sample's 1; normals have length 1."""
    heights = heights_of(WALL.image)
    normals = normals_of(heights)
    made = nrbench.synthesize(method(name), WALL, (48, 60), WALL.lattice, seed=2, maps=[heights, normals])
    found, turned = made.maps
    assert found.dtype == np.uint16 and found.shape == (48, 60) and turned.shape == (48, 60, 3)
    assert np.corrcoef(gray(made.image).ravel(), found.ravel())[0, 1] > 0.98
    assert np.abs(lengths(turned) - 1).max() < 0.02


def test_methods_without_maps_are_refused_before_they_run() -> None:
    """The message names the method and those that can; ``apply`` does as well."""
    with pytest.raises(BadInput, match=r"cartoon cannot lay out.*rsgf.* can"):
        nrbench.synthesize("cartoon", WALL, (64, 64), maps=[heights_of(WALL.image)])
    with pytest.raises(BadInput, match=r"such as tile-set"):
        nrbench.synthesize("random-phase", WALL, (64, 64), tileable=True, maps=[heights_of(WALL.image)])
    with pytest.raises(BadInput, match=r"no complete source map; .*quilting"):
        nrbench.synthesize("random-phase", WALL, (64, 64)).apply(heights_of(WALL.image))


@pytest.mark.parametrize("tileable", [False, True])
def test_strained_and_bent_samples_keep_their_maps(tileable: bool) -> None:
    """Sources in the sample itself are found through strain and bending: heights go with brightness as before."""
    bent = nrbench.texture("weave", (128, 128), seed=1, bend=0.0 if tileable else 0.5, rotation=0.0 if tileable else 5)
    heights = heights_of(bent.image)
    made = nrbench.synthesize("rsgf:block=24,border=6", bent, (83, 98), bent.lattice, tileable=tileable, maps=[heights])
    assert ("closes" if tileable else "bent") in made.note
    assert np.corrcoef(gray(made.image).ravel(), made.maps[0].ravel())[0, 1] > 0.98


def test_apply_keeps_type_axes_and_values() -> None:
    """Copies are exact for any dtype and number of channels; another size is an error that names both."""
    rng = np.random.default_rng(0)
    made = nrbench.synthesize("quilting:block=24", WALL, (60, 50), seed=1)
    x, y = made.source[..., :2].astype(int).transpose(2, 0, 1)
    for other in (rng.random((112, 120)) * 1e3, rng.integers(0, 99, (112, 120, 5)), rng.random((112, 120, 1)) > 0.5):
        laid = made.apply(other)
        assert laid.dtype == other.dtype
        np.testing.assert_array_equal(laid, other[y, x])
    with pytest.raises(BadInput, match="120x64 px, the sample 120x112"):
        made.apply(np.zeros((64, 120)))


@pytest.mark.parametrize("name", ["rsgf", "gpnn"])
def test_labels_and_truth_values_are_not_blended(name: str) -> None:
    """A map of few values keeps them, and the share of a mask, where the method blends or models its maps jointly."""
    mask = gray(WALL.image) > 0.45
    labels = np.where(mask, np.uint8(200), np.uint8(30))
    made = nrbench.synthesize(method(name), WALL, (90, 90), seed=1, maps=[mask, labels])
    assert set(np.unique(made.maps[1]).tolist()) == {30, 200}
    assert abs(made.maps[0].mean() - mask.mean()) < 0.15


def test_opposed_normals_are_not_averaged() -> None:
    """Where vectors that point apart are blended, the nearest is taken; all lengths are 1."""
    apart = np.full((112, 120, 3), (0.0, 0.5, 0.5))
    apart[:, ::2] = 1.0, 0.5, 0.5
    assert are_normals(apart) and not are_normals(WALL.image.astype(np.float64))
    blended = nrbench.synthesize("rsgf:seam=blend,block=24,border=6", WALL, (80, 80), WALL.lattice).apply(apart)
    assert np.abs(np.linalg.norm(2 * blended - 1, axis=-1) - 1).max() < 1e-6


def material(folder: Path) -> tuple[Path, dict[str, Path]]:
    """Write a color picture and its maps, as people have them; return their paths."""
    heights = heights_of(WALL.image)
    normals = normals_of(heights, 16)
    (folder / "other").mkdir()
    paths = {
        name: folder / name
        for name in ("my normal.png", "height.tif", "rough.png", "glow.jpg", "other/albedo.png", "turned.png")
    }
    write_map(paths["my normal.png"], normals, b"")
    tifffile.imwrite(paths["height.tif"], (heights / 1000.0 - 20).astype(np.float32))
    palette = PIL.Image.fromarray((heights // 257).astype(np.uint8)).convert("P")
    palette.save(paths["rough.png"])
    profile = PIL.ImageCms.ImageCmsProfile(PIL.ImageCms.createProfile("sRGB")).tobytes()
    PIL.Image.fromarray(np.uint8(255 * WALL.image)).save(paths["glow.jpg"], quality=95, icc_profile=profile)
    PIL.Image.fromarray(np.uint8(255 * WALL.image)).save(paths["other/albedo.png"])
    PIL.Image.fromarray(heights.T).save(paths["turned.png"])
    return write_image(folder / "albedo.png", quantize(WALL.image)), paths


def test_files_of_a_material_keep_their_names_depths_and_values(tmp_path: Path) -> None:
    """16 bits, floats beyond [0, 1], gray palettes and profiles stay; endings that are not written become .png."""
    albedo, paths = material(tmp_path)
    given = [
        part for name in ("my normal.png", "height.tif", "rough.png", "glow.jpg") for part in ("--with", paths[name])
    ]
    words = ["synth", albedo, *given, "-m", "rsgf:block=24,border=6", "--size", "90x72", "-o", tmp_path / "out"]
    assert call(*map(str, words)) == 0
    normal, height, rough, glow, color = (
        read_map(tmp_path / "out" / name)
        for name in ("my normal.png", "height.tif", "rough.png", "glow.png", "albedo.png")
    )
    assert normal[0].dtype == np.uint16 and np.abs(lengths(normal[0]) - 1).max() < 1e-4
    assert height[0].dtype == np.float32 and height[0].shape == (72, 90) and height[0].max() > 5
    assert rough[0].dtype == np.uint8 and rough[0].ndim == 2 and not rough[1]
    assert glow[1] and glow[0].shape == (72, 90, 3)
    tone = gray(np.float32(color[0] / 255)).ravel()
    assert min(np.corrcoef(tone, each.ravel())[0, 1] for each in (height[0], rough[0])) > 0.98


@pytest.mark.parametrize(
    ("name", "folder", "message"),
    [
        ("other/albedo.png", "out", "would both be written to"),
        ("turned.png", "out", "is 112x120 px, IMAGE 120x112"),
        ("rough.png", ".", "would be replaced"),
    ],
)
def test_what_cannot_be_written_is_one_clear_error(
    tmp_path: Path, name: str, folder: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two maps of one name, another size, and an output folder that holds the maps: exit code 2, nothing is lost."""
    albedo, paths = material(tmp_path)
    words = ("synth", albedo, "--with", paths[name], "-m", "tiling", "--size", "64x64", "-o", tmp_path / folder)
    before = paths[name].read_bytes()
    assert call(*map(str, words)) == 2
    assert message in capsys.readouterr().err and paths[name].read_bytes() == before


def test_values_of_a_map_are_never_converted(tmp_path: Path) -> None:
    """A profile, or gAMA 1.0, in a height map changes none of its values, and the profile is written again."""
    heights = (heights_of(WALL.image) // 257).astype(np.uint8)
    chunks = PIL.PngImagePlugin.PngInfo()
    chunks.add(b"gAMA", (100000).to_bytes(4, "big"))
    PIL.Image.fromarray(heights).save(tmp_path / "linear.png", pnginfo=chunks)
    values, profile = read_map(tmp_path / "linear.png")
    np.testing.assert_array_equal(values, heights)
    assert not profile


def fence() -> Values:
    """Return a fence of gray wires with transparent holes, 8 bits with alpha, whose holes hold garbage."""
    y, x = np.indices((120, 120))
    wire = (np.minimum((x + y) % 24, (x - y) % 24) < 6)[..., np.newaxis]
    tone = 90 + 60 * ((x // 24 + y // 24) % 3)[..., np.newaxis] / 2
    color = np.where(wire, tone + np.array((0, 5, 10)), (255, 0, 255))
    return np.uint8(np.concatenate([color, 255 * wire], -1))


def test_a_fence_keeps_its_holes(tmp_path: Path) -> None:
    """--keep-alpha: share of holes as in the sample, no garbage in the wires; PNG, TIFF and WebP hold the alpha."""
    PIL.Image.fromarray(fence()).save(tmp_path / "fence.png")
    for ending in ("png", "tif", "webp"):
        out = tmp_path / f"out.{ending}"
        words = ("synth", tmp_path / "fence.png", "--keep-alpha", "-m", "rsgf", "--size", "100x90", "-o", out)
        assert call(*map(str, words)) == 0
        pixels = read_map(out)[0]
        assert pixels.shape == (90, 100, 4)
        assert (pixels[..., 3] > 127).mean() == pytest.approx((fence()[..., 3] > 127).mean(), abs=0.06)
        wire = pixels[pixels[..., 3] > 200].astype(int)
        assert np.abs(wire[:, 0] - wire[:, 1] + 5).max() < 12


def test_alpha_that_is_not_there_cannot_be_kept() -> None:
    """A picture without an alpha channel is one clear error."""
    with pytest.raises(BadInput, match="no alpha channel to keep"):
        nrbench.synthesize("rsgf", WALL, (64, 64), keep_alpha=True)
