"""The limits of the verdict, and the textures that they were set on.

Command: ``python benchmarks/validation.py alarms detection --half calibration --count 72``.
Textures: brick walls, weaves and hexagonal patterns of random periods, joints and mixes of departures, half of them
rotated, at six regular shares.

The limits were set on the *calibration* textures. No statistic of their fresh draws exceeds 0.83 of its limit (144
draws of 256 px, regular shares from 0.3; before that 0.8 for 576 draws of 128, 256 and 512 px, shares from 0.45). The
floor of the fit lies between covered tiles (fit up to 0.57 of the usual) and tiles cut and rejoined a pixel off (from
0.65). Structure counts only below one half: a blur of 2 px lowers it to 0.6 but moves nothing. The limits of the
windows' scatter were added on at least 300 fresh draws of the first 72 textures, those of courses that slid as a whole
on 288 fresh draws of 256 px at a share of 0.4. The *report* textures, of other models and seeds, test the limits:
``docs/validation.md`` shows false alarms, detection by defect, size and regular share, and the bounds that are not
reached.
"""

TILE_SURPRISAL = 8.0
"""Surprisal (negative log probability) above which one tile is bad."""
GAIN_FLOOR = 0.05
"""A displaced tile fits better elsewhere by at least this much NCC."""
FIT_FLOOR = 0.6
"""A broken tile's NCC, or its slope, is below this share of the references' median."""
SINGLE_TILE_SHARE = 0.6
"""Regular share from which :data:`TILE_SURPRISAL` is the limit of a single tile."""
INTACT_SHARE = 0.85
"""Regular share from which finding no bad tile means that there is none: at 0.93 all bad tiles of 0.3 s or more are
called lost, at 0.8 a covered one is missed in one image of six, at 0.7 in four of ten."""
FAINT_TILE_SURPRISAL = 20.0
"""As :data:`TILE_SURPRISAL`, at regular shares below :data:`SINGLE_TILE_SHARE`, where single tiles of fresh draws fit
elsewhere by chance."""
NEIGHBORHOOD_SURPRISAL = 8.0
"""Surprisal above which the worst neighborhood has moved."""
COURSE_SURPRISAL = 3.0
"""Surprisal above which a course of tiles has slid."""
COURSE_GAIN = 0.1
"""Unit, in NCC, of the gain of a course. A course has slid only if its tiles together fit better elsewhere."""
STRIP_DEVIATIONS = 8.5
"""A course has slid if it is likelier elsewhere, and its gain exceeds the median of the references' courses by this
many of their standard deviations. 288 fresh draws at a share of 0.4 reach at most 8.0. Of 96 draws with courses that
slid by 0.15 s, the lowest reaches 7.8 and the second lowest 9.2."""
SURE_SHARE = 0.4
"""Regular share below which finding no fault does not prove that there is none; a fault that is found still counts."""
SCATTER_RATIO = 2.0
"""Third quartile of the windows' misplacement over that of the references, above which the content is bent."""
SCATTER = 0.035
"""The content is bent only if that quartile also exceeds this, in s."""
MISPLACED_SHARE = 0.1
"""Share of misplaced windows above which regularity is lost."""
STRUCTURE = 0.5
"""Structure, as a share of the references', below which regularity is lost. Too much of it means lost randomness."""
LEAST_SHARE = 0.35
"""Regular share below which only gross faults count."""
NO_SHARE = 0.05
"""Regular share that chance alone explains; below it nothing is measured."""
LEAST_WINDOWS = 3
"""Windows along each side below which finding no fault does not prove that there is none."""
REFERENCE_MISPLACED = 0.03
"""Share of misplaced windows in the references above which the verdict has no power."""
GROSS_SHARE = 0.5
"""Share of misplaced windows above which regularity is lost even if smaller faults could stay undetected."""
REFERENCE_SCATTER = 0.125
"""Largest 95th percentile, in s, of the misplacement of the references' windows with which the verdict has power."""
LEAST_SPREAD = 1e-3
"""Interquartile range of the references' NCC below which the ranges are not compared: the windows are nearly equal."""
