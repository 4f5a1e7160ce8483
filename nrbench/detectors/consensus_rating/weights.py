"""The weights of the traits of the consensus detector, and how they were fitted.

``benchmarks/consensus_calibration.py`` fits and prints them. Textures: 801 draws of the seeds 1011, 1012 and 1013 (6 of
each model, 1 of each further kind), 2217 choices; penalty 1; candidates rated by the code of commit c2c1f5f.
"""

WEIGHTS: dict[str, float] = {
    "constant": -8.158,
    "significance": 3.226,
    "votes": 1.848,
    "nested_votes": 1.445,
    "relief": 1.17,
    "alternation": -2.838,
    "best": 0.171,
}
"""The weight of each field of :class:`~.candidates.Traits`."""
