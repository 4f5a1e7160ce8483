"""Weights of two multinomial logistic regressions that ``benchmarks/consensus_calibration.py`` fits and prints."""

WEIGHTS: dict[str, list[float]] = {
    "exact": [
        *(-4.988, 1.813, -0.475, 1.801, -0.451, -2.564, -0.966, 2.169, -0.989, -0.724),
        *(0.466, -0.428, 0.999, 0.189, 0.95, 2.238, 1.356, 1.416, 1.018),
    ],
    "sub_or_supercell": [
        *(-3.177, 1.523, -0.381, 0.295, -0.431, -1.0, -1.06, 1.71, -0.155, 0.594),
        *(-0.779, 0.046, 0.216, -0.463, 0.214, 0.879, 0.268, 1.444, 1.295),
    ],
}
"""For any lattice, for each class but ``none``: a constant, then one weight for each trait."""
CHOSEN: dict[str, list[float]] = {
    "exact": [-1.061, 0.639, 0.428, -0.419],
    "sub_or_supercell": [-0.821, 0.225, 0.626, 0.064],
}
"""For the chosen lattice: a constant, then weights of the logarithms of the first two probabilities over the third, and
of the probability of the next one."""
