"""Appearance: color, gradients, spectrum, blur and seams of the output beside those of fresh draws."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Column, Observation, Score, Value

from .appearance_differences.bands import SPECTRUM_WINDOW, local_energies, sharpness, spectrum, spectrum_distance
from .appearance_differences.line_map import line_map
from .appearance_differences.seams import Line, worst_lines
from .appearance_differences.tileable import border_excess, byte_share, claimed_tile
from .appearance_differences.wasserstein import color_histograms, color_scale, cumulative, distance
from .ncc.periodic import tile_box
from .verdict.reference import FIRST_DRAW

DRAWS = 2
_OWN_DRAWS = FIRST_DRAW + (1 << 10)
_LEAST_SIDE = 16
_NO_SEAM = "undecided: lines of less than 16 px tell nothing"
_WIDEST, _TILES = 4, 1.5


def _distance(meaning: str, unit: str) -> Column:
    return Column(meaning, unit, (0.0, math.inf), "lower")


@dataclass(frozen=True)
class Appearance:
    """Whether the output looks like the texture when its lattice is left aside.

    Everything is compared with two fresh draws of the output's size (of a photograph: with the sample). Distances are
    between distributions of the whole image, so they know of no place; a fresh draw's own distance is not 0, and the
    oracle's row shows it. Sharpness and seams are ratios to fresh draws, about 1 for a fresh draw.

    Seams are looked for on every straight line of at least half the image's side, in every direction: nobody tells the
    judge where a method has cut. A tile that claims to wrap (``extras["tile"]``, or ``extras["tileable"]`` not zero for
    the output itself) is looked at where it wraps.
    """

    version: ClassVar[str] = "2"
    columns: ClassVar[Mapping[str, Column]] = {
        "color": _distance("Sliced Wasserstein distance between the colors of output and fresh draws.", "values"),
        "gradient": _distance(
            "Wasserstein distance between gradient magnitudes of output and fresh draws, over the latter's mean.", ""
        ),
        "spectrum": _distance("Difference of the power spectra of output and fresh draws, rms over frequencies.", "dB"),
        "sharpness": Column(
            "Amplitude of four octaves of detail over that of fresh draws; below 1: blur.", "", (0.0, math.inf), "one"
        ),
        "sharpness_worst": Column(
            "The same in the blurriest window, over that of fresh draws' blurriest.", "", (0.0, math.inf), "one"
        ),
        "seam": Column(
            "Visibility (size and contrast to its parallels) of the worst line, over that of fresh draws' worst.",
            "",
            (0.0, math.inf),
            "lower",
        ),
        "seam_step": _distance("Step of brightness across the line whose step stands out most.", "values"),
        "tileable": Column(
            "Gradient across the wrapped border over that of lines inside; up to 1: nothing to see.",
            "",
            (0.0, math.inf),
            "lower",
        ),
        "tile_bytes": Column("Bytes of the tile over bytes of the sample.", "", (0.0, math.inf), "lower"),
    }

    def score(self, observation: Observation) -> Score:
        """Return the scores, and the picture ``seam``: the line that stands out most."""
        output, references = observation.output, reference_images(observation)
        lattice = _repeated(observation)
        values: dict[str, Value] = dict(_distributions(output, references))
        reasons: dict[str, str] = {}
        width = _window(lattice, min(min(image.shape[:2]) for image in (output, *references)))
        values["sharpness"], values["sharpness_worst"] = sharpness(
            local_energies(output, width), [local_energies(reference, width) for reference in references]
        )
        values["seam"], values["seam_step"], line = _seam(output, references, lattice)
        if line is None:
            reasons |= dict.fromkeys(("seam", "seam_step"), _NO_SEAM)
        tile = claimed_tile(output, observation.extras)
        wraps = None if isinstance(tile, str) else tile
        values["tileable"] = None if wraps is None else border_excess(wraps)
        values["tile_bytes"] = None if wraps is None else byte_share(wraps, observation.sample)
        if isinstance(tile, str):
            reasons |= dict.fromkeys(("tileable", "tile_bytes"), tile)
        pictures = {} if line is None else {"seam": line_map(output, line)}
        records = {"reference": "sample" if references[0] is observation.sample else "fresh draws"}
        return Score({name: values[name] for name in self.columns}, reasons, pictures, records)


def _repeated(observation: Observation) -> Lattice | None:
    """Return the lattice where sample and output hold two cells along each side: else all would be regular."""
    lattice = observation.truth.lattice if observation.truth else None
    room = np.minimum(observation.sample.shape[1::-1], observation.output.shape[1::-1])
    return lattice if lattice is not None and (2 * tile_box(lattice.canonical()) <= room).all() else None


def reference_images(observation: Observation) -> list[Image]:
    """Return fresh draws of the output's shape; where there are none, the sample."""
    return fresh_images(observation, DRAWS) or [observation.sample]


def fresh_images(observation: Observation, number: int) -> list[Image]:
    """Return fresh draws of the output's shape, as many of them as there are: none of a photograph."""
    shape = (observation.output.shape[0], observation.output.shape[1])
    draws = [observation.again(shape, _OWN_DRAWS + k) for k in range(number)] if observation.again else []
    return [draw.image for draw in draws if draw is not None]


def _distributions(output: Image, references: list[Image]) -> dict[str, float]:
    colors = [color_histograms(image) for image in (output, *references)]
    slopes = [_slopes(image) for image in (output, *references)]
    steep = [cumulative(slope[:, np.newaxis]) for slope in slopes]
    mean = max(float(np.mean([slope.mean() for slope in slopes[1:]])), 1e-6)
    side = min(SPECTRUM_WINDOW, *(min(image.shape[:2]) for image in (output, *references)))
    power = [spectrum(image, side) for image in (output, *references)]
    return {
        "color": distance(colors[0], np.mean(colors[1:], 0)) * color_scale(output.shape[2]),
        "gradient": distance(steep[0], np.mean(steep[1:], 0)) / mean,
        "spectrum": spectrum_distance(power[0], np.mean(power[1:], 0)),
    }


def _slopes(image: Image) -> NDArray[np.float32]:
    """Return the gradient's magnitude at every pixel, rms over channels, as a share of the largest one possible."""
    across, down = np.diff(image[:-1], axis=1), np.diff(image[:, :-1], axis=0)
    squares = np.einsum("ijk,ijk->ij", across, across) + np.einsum("ijk,ijk->ij", down, down)
    return np.asarray(np.sqrt(squares.ravel() / np.float32(2 * image.shape[2])), np.float32)


def _window(lattice: Lattice | None, side: int) -> int:
    """Return the width in px of the windows in which sharpness is measured: some tiles, not too much of the image."""
    wanted = 24.0 if lattice is None else _TILES * float(tile_box(lattice.canonical()).max())
    return int(np.clip(round(wanted), min(8, side // 2), max(side // _WIDEST, 1)))


def _seam(
    output: Image, references: list[Image], lattice: Lattice | None
) -> tuple[float | None, float | None, Line | None]:
    """Return the worst line's strength over that of the references', by step or by gradient, its step, and the line."""
    if min(min(image.shape[:2]) for image in (output, *references)) < _LEAST_SIDE:
        return None, None, None
    own = worst_lines(output, lattice)
    others = [worst_lines(image, lattice) for image in references]
    usual = [max(float(np.mean([_visibility(lines)[kind] for lines in others])), 1e-6) for kind in (0, 1)]
    ratios = [seen / level for seen, level in zip(_visibility(own), usual, strict=True)]
    kind = int(np.argmax(ratios))
    return ratios[kind], own[0].size, own[kind]


def _visibility(lines: tuple[Line, Line]) -> tuple[float, float]:
    """Return what the worst lines by step and by gradient are held against draws by.

    The geometric mean of a line's size (step; root of the excess of squared gradient) and of how far it stands out from
    its parallels. The latter alone saturates, since a strong line shows in its neighbors too; the former alone would
    count what blur leaves along every course.
    """
    step, edge = lines
    return math.sqrt(step.strength * step.size), math.sqrt(edge.strength * math.sqrt(edge.size))
