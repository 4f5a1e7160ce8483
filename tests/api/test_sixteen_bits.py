"""Claims about depth: a sample of 16 bits a channel gives an output of 16 bits, from the command line and in Python."""

from pathlib import Path

import numpy as np
import PIL.Image
import pytest

import nrbench
from nrbench import Options
from nrbench.imaging.convert import Image, depth_of, quantize
from nrbench.labelling.labels import encode_pixels
from nrbench.pictures.files import read_image, write_image
from nrbench.plugins.forms import Observation, Score
from nrbench.reports.page.pictures import read_pixels
from tests.shared.commands import call


def heights(channels: int = 1) -> Image:
    """Return a smooth map of bumps in squares of 18.4 px, of 16 bits a channel."""
    y, x, c = np.ogrid[:64, :72, :channels]
    bumps = np.sin(2 * np.pi * x / 18.4) * np.sin(2 * np.pi * y / 18.4 + c)
    return quantize((0.5 + 0.4 * bumps + 0.0007 * (x + y)).astype(np.float32), 16)


def share_of_8_bits(image: Image) -> float:
    """Return the share of the values that a file of 8 bits holds."""
    return float((np.rint(image * 65535).astype(int) % 257 == 0).mean())


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("ending", ["png", "tif"])
def test_synth_keeps_16_bits(channels: int, ending: str, capsys: pytest.CaptureFixture[str]) -> None:
    """The output of a method that copies pixels holds values of the sample alone; the ending of -o is the format."""
    write_image("sample.png", heights(channels))
    assert call(f"synth sample.png -m quilting:block=16 --size 90x80 -o out.{ending}") == 0
    output = read_image(f"out.{ending}")
    assert output.shape == (80, 90, channels) and depth_of(output) == 16
    assert np.isin(output, heights(channels)).all()
    assert "warning" not in capsys.readouterr().err


def test_synth_writes_webp(capsys: pytest.CaptureFixture[str]) -> None:
    """WebP rounds to 8 bits, and a warning on standard error says so; JPEG, which loses pixels, is refused."""
    write_image("sample.png", heights(3))
    assert call("synth sample.png -m quilting:block=16 --size 90x80 -o out.webp") == 0
    assert "WebP has 8 bits a channel" in capsys.readouterr().err
    assert PIL.Image.open("out.webp").format == "WEBP" and depth_of(read_image("out.webp")) == 8
    assert call("synth sample.png -m quilting:block=16 --size 90x80 -o out.jpg") == 2
    assert "end the name in .png or .tif or .tiff or .webp" in capsys.readouterr().err


METHODS = ("patch-based:patch=20,zone=5", "tile-set:parts=4", "tile-set:stitch=dynamic", "rsgf:block=24,border=6")


@pytest.mark.parametrize("method", [*METHODS, "quilting:block=20"])
def test_methods_keep_16_bits(method: str) -> None:
    """Methods that blend, interpolate or compare in 8 bits make outputs of 16 bits, in their seams, too."""
    made = nrbench.synthesize(method, heights(), (100, 100), lattice=(18.4, 0, 0, 18.4), seed=1)
    assert depth_of(made.image) == 16 and share_of_8_bits(made.image) < 0.02


def test_depth_of_arrays() -> None:
    """Arrays of uint16 and of floats give 16 bits, those of 8 bits, of any type, and textures of models give 8."""
    floats = np.random.default_rng(0).random((40, 40))
    brick = nrbench.texture("brick", shape=(40, 40))
    eight = np.rint(floats * 255).astype(np.uint8)
    for image, bits in (
        ((floats * 65535).astype(np.uint16), 16),
        (floats, 16),
        (heights(), 16),
        (eight, 8),
        (eight / 255, 8),
        (brick, 8),
    ):
        assert depth_of(nrbench.synthesize("scatter", image, (50, 50)).image) == bits


def test_a_tileable_output_keeps_16_bits() -> None:
    """The strained sample of a tileable output has the 16 bits of the sample."""
    made = nrbench.synthesize("tile-set", heights(), (92, 92), lattice=(18.3, 0, 0, 18.4), tileable=True)
    assert share_of_8_bits(made.image) < 0.02


def test_a_run_keeps_16_bits(tmp_path: Path) -> None:
    """In a run the sample and the output of a picture of 16 bits have 16; its pages show them with their brightness."""
    (tmp_path / "in").mkdir()
    write_image(tmp_path / "in" / "bumps.png", heights())
    options = {"metrics": ["cost"], "options": Options(jobs=0), "size": "80x80", "out": tmp_path / "run"}
    run = nrbench.run(tmp_path / "in", methods="quilting:block=16", lattice="own", **options)
    for name in ("sample.png", "output.png"):
        path = run.cells[0].folder / name
        image = read_image(path)
        assert depth_of(image) == 16
        assert share_of_8_bits(image) < 0.02
        np.testing.assert_allclose(read_pixels(path) / 255, np.repeat(image, 3, 2), atol=0.51 / 255)
        (tmp_path / "label.png").write_bytes(encode_pixels(path))
        np.testing.assert_array_equal(read_image(tmp_path / "label.png"), np.repeat(quantize(image), 3, 2))


def test_files_of_16_bits_are_judged_as_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The judge compares the values of the files, which 8 bits would have made equal."""
    seen: list[Observation] = []
    monkeypatch.setattr(
        "nrbench.metrics.cost.Cost.score", lambda self, observation: seen.append(observation) or Score({})
    )
    files = [
        write_image(tmp_path / f"{name}.png", image) for name, image in (("a", heights()), ("b", quantize(heights())))
    ]
    nrbench.score(files[0], files[1], metrics="cost")
    assert [len(np.unique(each)) > 256 for each in (seen[0].sample, seen[0].output)] == [True, False]
