"""Whether a picture is bent has one answer: for the command line, the Python functions, the methods and the judge."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bent_pictures import tilted
from commands import answer_json

import nrbench
from nrbench import plugins
from nrbench.calling.bent_samples import survey_sample
from nrbench.cli import lattice_detection
from nrbench.displacement import bent_detection
from nrbench.imaging.convert import Image, quantize
from nrbench.pictures.files import read_image, write_image
from nrbench.plugins.forms import Again, Observation, Task, Texture

SIDE = 192
Case = tuple[Texture, Again | None]
"""A texture, and its fresh draws, which the judge has of a model."""


def model(name: str, **departures: float) -> Case:
    """Return a draw of a model."""
    built = plugins.build("datasets", name, departures)
    texture = built.render((SIDE, SIDE), np.random.default_rng(1))
    return texture, lambda shape, number: built.again(texture, shape, np.random.default_rng(number))


def noise(side: int = 72) -> Case:
    """Return a picture without a lattice."""
    return Texture(np.random.default_rng(3).random((side, side, 1), np.float32), None, kind="stochastic"), None


def grain() -> Case:
    """Return a picture of a model without a lattice."""
    return nrbench.texture("noise", shape=(72, 72), seed=1), None


MODELS = ("brick", "weave", "hexagon")
PICTURES: dict[str, tuple[Callable[[], Case], bool]] = {
    "weave": (partial(model, "weave"), False),
    **{f"{name}, bent": (partial(model, name, bend=0.5), True) for name in MODELS},
    "in perspective": (lambda: (tilted(SIDE), None), True),
    "jitter": (partial(model, "hexagon", jitter=0.3), False),
    "noise": (noise, False),
    "grain": (grain, False),
}


@pytest.fixture(autouse=True)
def _asked_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Answer equal questions about a picture, of the command and of the function, once."""
    known: dict[tuple[bytes, str], bent_detection.Followed] = {}
    find = bent_detection.find_deformation

    def look_up(image: Image, *rest: Any, **more: Any) -> bent_detection.Followed:
        key = image.tobytes(), repr((rest, more))
        known[key] = known.get(key) or find(image, *rest, **more)
        return known[key]

    for module in (bent_detection, lattice_detection):
        monkeypatch.setattr(module, "find_deformation", look_up)


@pytest.mark.parametrize("name", PICTURES)
def test_all_agree_on_what_is_bent(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Straight and bent models, a perspective, jitter, and pictures without a lattice."""
    make, bent = PICTURES[name]
    truth, again = make()
    write_image(Path("picture.png"), quantize(truth.image))
    image = read_image(Path("picture.png"))
    shown = answer_json(capsys, "lattice picture.png --straighten out.png --json")
    assert shown.get("deformation", {}).get("bent", False) is bent
    try:
        assert nrbench.track_lattice(image).bent is bent
    except nrbench.NoLatticeFound:
        assert not bent
    task = Task(image, (64, 64), None, np.random.default_rng(0))
    survey = survey_sample(plugins.build("synthesizers", "rsgf"), task)
    assert survey is not None and (survey.bent is not None) is bent
    score = plugins.build("metrics", "regularity").score(Observation(image, image, truth, again=again))
    assert (score.values["misplacement_ratio"] is not None) is bent
