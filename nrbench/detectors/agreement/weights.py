"""Weights of two multinomial logistic regressions that ``benchmarks/consensus_calibration.py`` fits and prints."""

WEIGHTS: dict[str, list[float]] = {
    "exact": [
        *(-5.84, 2.192, -0.168, 1.729, -0.816, -2.511, -0.827, 1.285),
        *(-0.789, 0.0, 0.812, 0.713, 1.061, 1.308, 1.105, 1.34, 0.826),
    ],
    "sub_or_supercell": [
        *(-3.923, 1.636, -0.356, 0.212, -0.007, -1.062, -1.006, 1.771),
        *(0.009, 0.0, 0.044, -0.688, 0.217, 0.598, 0.231, 1.313, 1.187),
    ],
}
"""For any lattice, for each class but ``none``: a constant, then one weight for each trait."""
CHOSEN: dict[str, list[float]] = {
    "exact": [0.068, 0.735, 0.286],
    "sub_or_supercell": [-0.939, -0.007, 1.024],
}
"""For the chosen lattice: a constant, then weights of the logarithms of the first two probabilities over the third."""
