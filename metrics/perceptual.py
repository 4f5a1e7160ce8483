"""Perceptual: a network's distance between output and fresh draws; needs optional packages and weights."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

import lazy_loader
import numpy as np

from nrbench.imaging.convert import Image
from nrbench.plugins.forms import Column, Observation, Score

from .judgment.texture_reference import fresh_images

piq: Any = lazy_loader.load("piq", error_on_import=False)
torch: Any = lazy_loader.load("torch", error_on_import=False)

WEIGHTS = ("vgg16-397923af.pth", "dists_weights.pt")
"""Files that the first call of ``piq.DISTS()`` downloads into the folder ``checkpoints`` of torch's hub."""
_DRAWS = 3


@dataclass(frozen=True)
class Perceptual:
    """Distance between output and fresh draws for a network that is trained to agree with people.

    The network is DISTS, which tolerates resampled texture (Ding, Ma, Wang, Simoncelli, IEEE Transactions on Pattern
    Analysis 44, 2022), from the package piq. The mean distance between the output and three fresh draws of its size is
    divided by that between the draws.

    Install the packages with ``pip install 'nrbench[perceptual]'`` and call ``piq.DISTS()`` once to download the
    weights; scoring never downloads them. Without packages and weights the column is empty.
    """

    version: ClassVar[str] = "2"
    columns: ClassVar[Mapping[str, Column]] = {
        "dists": Column(
            "DISTS distance between output and fresh draws, over that between fresh draws.",
            "",
            (0.0, math.inf),
            "lower",
        )
    }

    def score(self, observation: Observation) -> Score:
        """Return the distance, or None and the reason: packages, weights or fresh draws are missing."""
        reason = _missing()
        draws = [] if reason else fresh_images(observation, _DRAWS)
        if not reason and len(draws) < _DRAWS:
            reason = "not applicable: there are no fresh draws of the output's size"
        if reason:
            return Score.missing(self.columns, reason)
        network = piq.DISTS()
        own = float(np.mean([_distance(network, observation.output, draw) for draw in draws]))
        pairs = [(one, other) for k, one in enumerate(draws) for other in draws[:k]]
        usual = float(np.mean([_distance(network, one, other) for one, other in pairs]))
        if not usual > 0:
            return Score.missing(self.columns, "not applicable: fresh draws do not differ")
        return Score({"dists": own / usual})


def _missing() -> str:
    """Return which packages or weights are missing; empty if none is."""
    absent = [name for name in ("torch", "piq") if find_spec(name) is None]
    if absent:
        return f"{' and '.join(absent)}: not installed; pip install 'nrbench[perceptual]'"
    folder = Path(torch.hub.get_dir()) / "checkpoints"
    absent = [name for name in WEIGHTS if not (folder / name).is_file()]
    return (
        f"weights {', '.join(absent)} are not in {folder}: call piq.DISTS() once with internet access" if absent else ""
    )


def _distance(network: Any, one: Image, other: Image) -> float:
    """Return the network's distance between two images of one shape; gray images are repeated in three channels."""
    with torch.no_grad():
        return float(network(_tensor(one), _tensor(other)))


def _tensor(image: Image) -> Any:
    planes = np.broadcast_to(np.moveaxis(image, -1, 0), (3, *image.shape[:2]))
    return torch.from_numpy(np.array(planes, np.float32))[None]
