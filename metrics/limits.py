"""The limits of the verdict, and what they were set on."""

TILE_SURPRISE = 8.0
"""Surprise above which one tile is bad."""
GAIN_FLOOR = 0.05
"""A displaced tile fits better elsewhere by at least this much NCC."""
FIT_FLOOR = 0.6
"""A broken tile's NCC, or its slope, is below this share of the references' median."""
SINGLE_TILE_SHARE = 0.6
"""Regular share from which a single tile is looked for with :data:`TILE_SURPRISE`."""
FAINT_TILE_SURPRISE = 20.0
"""The same below that share, where single tiles of fresh draws fit by chance elsewhere."""
NEIGHBORHOOD_SURPRISE = 6.0
"""Surprise above which the worst neighborhood has moved."""
MISPLACED_SHARE = 0.1
"""Share of misplaced windows above which regularity is lost."""
STRUCTURE = 0.7
"""Structure, as a share of the references', below which regularity is lost."""
LEAST_SHARE = 0.25
"""Regular share below which nothing seen does not mean nothing there."""
LEAST_WINDOWS = 3
"""Windows along each side below which nothing seen does not mean nothing there."""
REFERENCE_MISPLACED = 0.03
"""Share of misplaced windows in the references above which the verdict has no power."""
GROSS_SHARE = 0.5
"""Share of misplaced windows above which regularity is lost even where the judge is blind to less."""
REFERENCE_SCATTER = 0.25
"""Misplacement (in s) that the references may have and still be a yardstick."""
