"""Claims about uneven light: it is separated from the tints of elements, divided out, and named."""

from pathlib import Path

import numpy as np
import pytest
from commands import call
from numpy.typing import NDArray

import nrbench
from nrbench.imaging.convert import Image, quantize
from nrbench.imaging.light import STRONG, describe_light, divide_light, estimate_light
from nrbench.plugins.forms import Texture

SIDE = 256
Y, X = np.mgrid[-1 : 1 : SIDE * 1j, -1 : 1 : SIDE * 1j]
LIGHTS: dict[str, NDArray[np.float64]] = {
    "slope": np.log(1.1 + X),
    "dark corners": np.log(1 - 0.45 * (X**2 + Y**2)),
    "edge of a shadow": np.log(np.where(X + 0.5 * Y > 0.1, 1, 0.4)),
    "lamp in a corner": -np.log1p(0.4 * ((X + 1) ** 2 + (Y + 1) ** 2)),
}


def drawn(name: str, **departures: float) -> Texture:
    """Return a model in even light."""
    return nrbench.texture(name, (SIDE, SIDE), seed=41, **departures)


def lit(image: Image, light: NDArray[np.float64]) -> Image:
    """Return an image in a light."""
    return quantize(divide_light(image, -light))


@pytest.mark.parametrize("name", LIGHTS)
def test_light_is_divided_out(name: str) -> None:
    """Of each light over bricks of several tints, at most a third is left, and at most a half over strong weave."""
    for texture, most in ((drawn("brick", color=0.3), 0.33), (drawn("weave", intensity=0.3, noise=0.1), 0.5)):
        assert texture.lattice is not None
        light = LIGHTS[name] - LIGHTS[name].mean()
        found = estimate_light(lit(texture.image, light), texture.lattice)
        assert np.std(found - light) < most * np.std(light)


def test_a_strip_of_less_than_a_cell_has_a_light() -> None:
    """Where a side has two places for a light of three terms, the light is flat along it; nothing fails."""
    strip = lit(drawn("brick", color=0.1).image, LIGHTS["slope"])[:24]
    light = estimate_light(strip, nrbench.Lattice((40, 0), (0, 40)))
    assert np.corrcoef(light.mean(0), LIGHTS["slope"][0])[0, 1] > 0.9


def test_tints_of_elements_stay() -> None:
    """Bricks that differ much in even light keep nine tenths of their variance, and no light is named."""
    texture = drawn("brick", color=1.0, intensity=0.5, noise=0.25)
    assert texture.lattice is not None
    light = estimate_light(texture.image, texture.lattice)
    even = divide_light(texture.image, light)
    assert even.var((0, 1)).sum() > 0.9 * texture.image.var((0, 1)).sum()
    assert np.corrcoef(even.ravel(), texture.image.ravel())[0, 1] > 0.95
    assert describe_light(light) == "" and np.exp(np.ptp(np.quantile(light, (0.02, 0.98)))) < STRONG


def test_synth_flattens_light_and_names_it(capsys: pytest.CaptureFixture[str]) -> None:
    """`--flatten-light` writes the sample in even light beside the output; without it, a warning says what to do."""
    wall = drawn("brick", color=0.2)
    image = lit(wall.image, LIGHTS["dark corners"])
    nrbench.write_image(Path("wall.png"), image)
    assert call("synth wall.png -m tiling -o out.png --size 96x96") == 0
    assert "varies by a factor of" in (said := capsys.readouterr().err) and "--flatten-light divides it out" in said
    assert call("synth wall.png -m tiling -o out.png --size 96x96 --flatten-light --extras") == 0
    said = capsys.readouterr().err
    assert "it was divided out" in said and "warning" not in said
    even = nrbench.read_image(Path("out-flattened.png"))
    corner, middle = np.s_[:48, :48], np.s_[104:152, 104:152]
    assert image[corner].mean() < 0.7 * image[middle].mean() and even[corner].mean() > 0.85 * even[middle].mean()
    noise = np.random.default_rng(1).random((64, 64, 3))
    with pytest.raises(nrbench.BadInput, match="--flatten-light: no lattice found"):
        nrbench.synthesize("quilting", noise, (64, 64), flatten_light=True)
