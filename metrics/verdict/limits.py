"""The limits of the verdict, and what they were set on.

Command: ``OMP_NUM_THREADS=1 python benchmarks/regularity_validation.py run calibration --out FILE``.
Textures: brick, weave and hexagon of random periods, joints and mix of departures, half of them rotated, at six regular
shares.

*Calibration* set the limits: no statistic of its fresh draws comes nearer to its limit than 0.83 of it (144 of 256 px
at regular shares from 0.3; before that 576 of 128, 256 and 512 px from 0.45: 0.8). The floor of the fit lies between
covered tiles (fit up to 0.57 of the usual) and tiles cut and rejoined a pixel off (from 0.65). The structure counts
below a half alone: blur of 2 px takes it to 0.6 and moves nothing. The scatter of windows was added on 300 and more
fresh draws of its first 72 textures, courses slid as a whole on 288 of share 0.4, 256 px. *Report*, on other models and
seeds, judges them: false alarms, detectability by defect, size and regular share, and what is not reached stand in
``docs/validation.md``, each table with its command.
"""

TILE_SURPRISAL = 8.0
"""Surprise above which one tile is bad."""
GAIN_FLOOR = 0.05
"""A displaced tile fits better elsewhere by at least this much NCC."""
FIT_FLOOR = 0.6
"""A broken tile's NCC, or its slope, is below this share of the references' median."""
SINGLE_TILE_SHARE = 0.6
"""Regular share from which a single tile is looked for with :data:`TILE_SURPRISAL`."""
INTACT_SHARE = 0.85
"""Regular share from which a tile that is not seen is not there: at 0.93 all bad tiles of 0.3 s or more are called
lost, at 0.8 a covered one is missed in one image of six, at 0.7 in four of ten."""
FAINT_TILE_SURPRISAL = 20.0
"""The same below that share, where single tiles of fresh draws fit by chance elsewhere."""
NEIGHBORHOOD_SURPRISAL = 8.0
"""Surprise above which the worst neighborhood has moved."""
COURSE_SURPRISAL = 3.0
"""Surprise above which a course of tiles has slid."""
COURSE_GAIN = 0.1
"""A course has slid where its tiles fit better elsewhere on the whole (gain above 0), in steps of this much NCC."""
STRIP_DEVIATIONS = 8.5
"""A course has slid where it is likelier elsewhere, by this many standard deviations of the references' courses more
than is usual: 288 fresh draws at a share of 0.4 come to 8.0, courses that slid by 0.15 s to 7.8 and, the second lowest
of 96, to 9.2."""
SURE_SHARE = 0.4
"""Regular share below which nothing seen does not mean nothing there, while what is seen still counts."""
SCATTER_RATIO = 2.0
"""The third quartile of the windows' misplacement over the references', above which the content is bent..."""
SCATTER = 0.035
"""...and the least that it is, in s."""
MISPLACED_SHARE = 0.1
"""Share of misplaced windows above which regularity is lost."""
STRUCTURE = 0.5
"""Structure, as a share of the references', below which regularity is lost; too much of it is the other peril's."""
LEAST_SHARE = 0.35
"""Regular share below which only what is gross counts."""
NO_SHARE = 0.05
"""Regular share below which there is nothing to follow: chance explains as much."""
LEAST_WINDOWS = 3
"""Windows along each side below which nothing seen does not mean nothing there."""
REFERENCE_MISPLACED = 0.03
"""Share of misplaced windows in the references above which the verdict has no power."""
GROSS_SHARE = 0.5
"""Share of misplaced windows above which regularity is lost even if smaller faults could stay undetected."""
REFERENCE_SCATTER = 0.125
"""Misplacement (in s) that 95 % of the references' windows may have and still be a reference."""
LEAST_SPREAD = 1e-3
"""Interquartile range of the references' NCC below which nothing is to be compared: windows all but equal."""
