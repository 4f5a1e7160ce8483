"""Weights of two multinomial logistic regressions that ``benchmarks/consensus_calibration.py`` fits and prints."""

WEIGHTS: dict[str, list[float]] = {
    "exact": [
        *(-6.863, 1.734, -0.027, 1.203, -1.021, -2.054, 0.545, -1.17, 0.0),
        *(0.135, 2.24, 0.991, 1.438, 1.419, 1.559, 0.578),
    ],
    "sub_or_supercell": [
        *(-6.427, 1.831, -0.225, -0.147, -0.05, -1.097, -1.262, 2.234, 0.0),
        *(-0.47, -0.643, 0.552, 1.222, 0.941, 1.528, 1.501),
    ],
}
"""For any lattice, for each class but ``none``: a constant, then one weight for each trait."""
CHOSEN: dict[str, list[float]] = {
    "exact": [0.3, 0.861, 0.267],
    "sub_or_supercell": [-0.291, 0.186, 0.65],
}
"""For the chosen lattice: a constant, then weights of the logarithms of the first two probabilities over the third."""
