"""Weights of two multinomial logistic regressions that ``benchmarks/consensus_calibration.py`` fits and prints."""

WEIGHTS: dict[str, list[float]] = {
    "exact": [
        *(-4.898, 1.649, -0.364, 1.805, -0.919, -1.994, -0.597, 1.774),
        *(-1.107, 0.0, 0.0, -0.539, 0.938, 0.298, 0.839, 1.925, 1.117, 1.327, 0.988),
    ],
    "sub_or_supercell": [
        *(-3.483, 1.594, -0.324, 0.296, -0.451, -1.048, -1.002, 1.66),
        *(0.026, 0.0, 0.0, 0.065, 0.158, -0.558, 0.275, 0.694, 0.152, 1.289, 1.156),
    ],
}
"""For any lattice, for each class but ``none``: a constant, then one weight for each trait."""
CHOSEN: dict[str, list[float]] = {
    "exact": [0.16, 0.621, 0.399, 0.0],
    "sub_or_supercell": [-0.929, 0.083, 0.84, 0.0],
}
"""For the chosen lattice: a constant, then weights of the logarithms of the first two probabilities over the third, and
of the probability of the next one."""
