"""The weights of the traits of the consensus detector, and how they were fitted.

``benchmarks/consensus_calibration.py`` fits and prints them. Textures: 600 draws of the seeds 1011 and 1012 (6 of each
model, 1 of each further kind); penalty 1; candidates rated by the code of commit 4cecf4d, whose further kinds included
cloth in two dyes and surfaces in perspective.
"""

WEIGHTS: dict[str, float] = {
    "constant": -7.75,
    "significance": 2.82,
    "votes": 2.07,
    "nested_votes": 1.63,
    "relief": 1.0,
    "alternation": -2.52,
    "best": 0.38,
}
"""The weight of each field of :class:`~.candidates.Traits`."""
