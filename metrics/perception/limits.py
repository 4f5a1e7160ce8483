"""Every number by which the four perils are judged, with its unit and where it comes from.

No other module of the perils holds a constant that decides a score. ``nrbench show limits`` prints :data:`TABLE`.
"""

from __future__ import annotations

from typing import NamedTuple

TABLE: list[Limit] = []
"""All limits, in the order of their definition."""


class Limit(NamedTuple):
    """One number of the judge.

    Parameters
    ----------
    name
        Name of the constant in this module.
    value
        Its value.
    unit
        Its unit; ``""`` for shares and ratios.
    origin
        Why it has this value: theory, a measurement, or a convention.
    """

    name: str
    value: float
    unit: str
    origin: str


def _limit(name: str, value: float, unit: str, origin: str) -> float:
    """Enter a number into the table and return it."""
    TABLE.append(Limit(name, value, unit, origin))
    return value


# What an eye sees

BLUR = _limit(
    "BLUR",
    0.75,
    "px",
    "central Gaussian of luminance in S-CIELAB (Zhang and Wandell 1997) at 38 px a degree: 96 dpi, 57 cm",
)
CHROMA_BLUR = _limit("CHROMA_BLUR", 2.0, "px", "the Gaussians of chroma in S-CIELAB, as one of half their bandwidth")
JND = _limit("JND", 2.0, "CIELAB", "just noticeable side by side (Mahy and others 1994: 2.3)")

# Registration

PLACES = int(_limit("PLACES", 8, "places", "convention: samples of a cell along each vector, times 1, 2 or 3"))
MOST_SAMPLES = int(
    _limit("MOST_SAMPLES", 24, "samples", "convention: three times PLACES; more cost time and gain nothing")
)
SURE = _limit("SURE", 0.12, "s", "windows are widened until those of the references lie this close to their places")
LEAST_STEP = _limit("LEAST_STEP", 0.08, "s", "below half the smallest fault that labelers call lost half of the time")
MOST_STEP = _limit("MOST_STEP", 0.25, "s", "a tile that is out of place by this is wholly out of place")
LOOSE = _limit("LOOSE", 1.5, "", "factor of LEAST_STEP and SLIP beside one sample: photographed walls wander by .1 s")
OF_NOISE = _limit("OF_NOISE", 1.3, "", "margin over the largest departure of the references")
TORN = _limit("TORN", 1.6, "", "margin over the largest misfit of a cell of the references")
TORN_OF_SAMPLE = _limit("TORN_OF_SAMPLE", 2.0, "", "the same beside one sample, which shows fewer cells")
TOP = _limit("TOP", 0.999, "", "quantile of the windows of the references that counts as the largest")
TOP_OF_SAMPLE = _limit("TOP_OF_SAMPLE", 0.98, "", "the same for a sample: one window may lock onto a wrong place")
OF_FLAT = _limit("OF_FLAT", 0.2, "", "convention: a torn cell lacks a fifth of what a flat one lacks")
SEEN_MISFIT = _limit("SEEN_MISFIT", 0.5, "", "mean squared difference to the mean cell, over JND^2, that nobody sees")
BLANK = _limit("BLANK", 0.05, "", "a contrast to other places that nobody sees; windows of fresh draws show 0.27")
SLIP = _limit("SLIP", 0.1, "s", "smallest difference between the two sides of a line that counts as a slip")
OF_SLIP = _limit("OF_SLIP", 1.2, "", "margin over the largest difference between two sides in the references")

APART = _limit("APART", 0.75, "s", "convention: a place of a sample is matched to others, not to its own element")
GOOD_MATCH = _limit("GOOD_MATCH", 0.15, "s", "a match at its own phase; votes are spread by two thirds of it")
COHERENT = _limit("COHERENT", 0.1, "", "share of matches in a sample, beyond chance, that lie at their phase at least")
FEWEST_CELLS = _limit("FEWEST_CELLS", 3.5, "cells", "convention: four, to within the uncertainty of their lattice")

SAME_CELL = _limit("SAME_CELL", 10.0, "", "theory: 99 % of squared normal values are below 6.6; more for few cells")
SAME_SHARE = _limit(
    "SAME_SHARE", 0.2, "", "measured: brick walls moved by half a cell depart by 0.29 or more, supercells by up to 0.14"
)

# Regularity

SLOPE = _limit("SLOPE", 2.0, "", "the score is 0 when half of the tiles are out of place: no half is the right one")
PRESERVED = _limit("PRESERVED", 0.85, "", "convention: lost if more than one tile in fourteen is out of place")
MOST_OWN = _limit("MOST_OWN", 0.35, "", "if more tiles of the references are out of place, nothing can be told")
DEVIATIONS = _limit("DEVIATIONS", 3.0, "sd", "theory: one normal value in 740 is larger")
SURE_SHARE = _limit("SURE_SHARE", 0.002, "", "convention: share of a tile in 500 that is overlooked")
DRIFT = _limit("DRIFT", 0.02, "", "uncertainty of a lattice marked by hand: 3 px over the six tiles of a sample")
MOST_DRIFT = _limit("MOST_DRIFT", 0.06, "", "convention: three times the uncertainty is another lattice")

# Integrity

FREEDOM = _limit("FREEDOM", 6.0, "", "degrees of freedom of a heavy-tailed likelihood: one odd place decides nothing")
WHOLE_SHARES = (0.1, 0.05, 0.03, 0.02, 0.01, 0.005, 0.002)
"""Shares of whole elements above the limit that are tried; the one with the least chance for its power is used."""
LEAST_POWER = _limit("LEAST_POWER", 0.3, "", "least share of joined elements, beyond whole ones, for a score")
UNSEEN_NOISE = _limit("UNSEEN_NOISE", 0.75, "CIELAB", "measured: root mean square of what is seen of JPEG 85")
OVERLOOKED = _limit("OVERLOOKED", 0.005, "", "convention: share of broken elements that is overlooked")
FEWEST_SHOWN = _limit("FEWEST_SHOWN", 12.0, "cells", "measured: beside nine cells, fresh plaids are called joined")
LEAST_LEVEL = _limit("LEAST_LEVEL", 0.2, "", "convention: a change of squared differences by a fifth is not seen")
SEEN_STEP = _limit(
    "SEEN_STEP", 2.5, "", "squared step across a joint over that in whole elements, below which labelers see no joint"
)
FEW_CELLS = _limit("FEW_CELLS", 100.0, "cells", "with fewer cells, covariances of neighboring places are pooled")

# Randomness

VARIES = _limit(
    "VARIES",
    0.5,
    "JND",
    "convention: half of what is just noticed; a smaller root mean square departure of tiles from their mean, or "
    "difference of two windows, is not seen",
)
TWINS = _limit("TWINS", 0.1, "", "pairs of the references below the limit of twins, over those of an ideal copier")
RETURNING = _limit("RETURNING", 6.0, "pairs", "lags with fewer pairs are ignored: half of them can be twins by chance")
LEAST_SCALE = _limit(
    "LEAST_SCALE", 0.25, "", "least energy of an output, over the references', to which distances are relative"
)
TOLERANCE = _limit("TOLERANCE", 0.1, "", "convention: a variation that differs by 10 % is not seen")
ARRANGED = _limit("ARRANGED", 0.15, "", "convention: a change of a correlation that is not seen")
ARRANGED_DEVIATIONS = _limit("ARRANGED_DEVIATIONS", 4.0, "sd", "theory: one of 30 normal values is larger once in 500")
LEAST_DISTANCE = _limit("LEAST_DISTANCE", 0.03, "", "convention: share of the energy distance that is not seen")
DISTANCE_SLOPE = _limit("DISTANCE_SLOPE", 4.0, "", "convention: the score reaches 0 at a quarter of what is possible")
ODD = _limit("ODD", 4.5, "", "median absolute deviations of the logarithm of the misfit: one normal value in 400")
OF_DISTANCE = _limit("OF_DISTANCE", 1.1, "", "margin over the largest distance of 24 parts of the references")
DECISIVE = _limit("DECISIVE", 10.0, "", "Kass and Raftery (1995): a gain of the BIC that is very strong evidence")
CLASS_GAP = _limit(
    "CLASS_GAP", 6.0, "sd", "theory: classes of colors do not overlap; with the floor at least three JND apart"
)
AMPLITUDE = _limit(
    "AMPLITUDE", 0.06, "s", "the references' geometry does not vary below it; methods take samples for bent from 0.04 s"
)
AMPLITUDE_TOLERANCE = _limit("AMPLITUDE_TOLERANCE", 0.35, "", "convention: a difference of 40 % is not seen")

# Appearance: floors in units of the features, 20 ln of an amplitude for bands

COLOR_FLOOR = _limit("COLOR_FLOOR", 2.0, "CIELAB", "one JND of the mean")
GRAIN_FLOOR = _limit("GRAIN_FLOOR", 4.0, "20 ln", "a fifth of the amplitude of grain")
FINE_FLOOR = _limit("FINE_FLOOR", 5.0, "20 ln", "a fourth of the amplitude of the finest band")
BAND_FLOOR = _limit("BAND_FLOOR", 4.0, "20 ln", "a fifth of the amplitude of a band")
CHROMA_FLOOR = _limit("CHROMA_FLOOR", 6.0, "20 ln", "a third of the contrast of chroma, which depends on few elements")
TURN_FLOOR = _limit(
    "TURN_FLOOR", 0.8, "20 ln", "measured: half a pixel, interpolated, turns slopes by up to 1.0 on 15 textures"
)
CLUSTER_FLOOR = _limit("CLUSTER_FLOOR", 0.35, "20 ln", "measured: a blur of .6 px changes it by up to 0.4")
SPREAD_FLOOR = _limit(
    "SPREAD_FLOOR", 0.15, "", "convention: a standard deviation or a correlation that differs by 15 % is not seen"
)
LEVEL_OFFSET = _limit("LEVEL_OFFSET", 2.0, "20 ln", "convention: levels that vary by a tenth are even")
PLATEAUS = _limit("PLATEAUS", 0.05, "", "convention: share of neighbors that are alike, of which nobody sees plateaus")
LACK = _limit("LACK", 6.0, "20 ln", "convention: a window may lack a fourth of the amplitude of the least one")
WHOLE_WINDOW = _limit("WHOLE_WINDOW", 0.97, "", "convention: share of a window that lies inside the picture")
LOSS = _limit("LOSS", 0.6, "", "lost fine detail counts less: a blur of .6 px is not seen, noise of as much energy is")
GRAIN_OFFSET = _limit("GRAIN_OFFSET", 1.5, "CIELAB", "grain of this amplitude is not seen")
BAND_OFFSET = _limit("BAND_OFFSET", 0.5, "CIELAB", "detail of this amplitude is not seen")
LEAST_LOCAL = _limit("LEAST_LOCAL", 3.5, "sd", "theory: the norm of eight normal values exceeds it once in 30 windows")
LEAST_WHOLE = _limit("LEAST_WHOLE", 2.0, "sd", "convention: half of what was seen in all edits")
LEAST_OF_SAMPLE = _limit("LEAST_OF_SAMPLE", 1.25, "sd", "the same beside one sample, whose own means count as exact")
UNEVEN_WHOLE = _limit("UNEVEN_WHOLE", 3.0, "", "two pictures differ by both variances; half more for four strips")
UNEVEN_QUARTERS = _limit("UNEVEN_QUARTERS", 8.0, "", "the same for quarters: one of the sample varies four times more")
UNSEEN_TONES = _limit(
    "UNSEEN_TONES", 1.6, "", "convention: a sample of few elements does not show all of their tones, nor how inks meet"
)
OF_LOOKS = _limit("OF_LOOKS", 1.15, "", "margin over the largest distance of the references")
OF_MEANS = _limit("OF_MEANS", 1.3, "", "the same for quarters, of which there are few")
OF_SAMPLE_LOOKS = _limit("OF_SAMPLE_LOOKS", 1.25, "", "the same for parts of one sample")
LOOKS_SLOPE = _limit("LOOKS_SLOPE", 2.0, "", "the score reaches 0 at 1.5 times the limit")
