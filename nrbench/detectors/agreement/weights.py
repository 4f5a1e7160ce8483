"""Weights of two multinomial logistic regressions that ``benchmarks/consensus_calibration.py`` fits and prints."""

WEIGHTS: dict[str, list[float]] = {
    "exact": [
        -6.048,
        1.597,
        0.009,
        1.179,
        -0.475,
        -1.438,
        0.717,
        -1.871,
        -0.227,
        2.036,
        0.924,
        1.859,
        1.216,
        1.383,
        0.464,
    ],
    "sub_or_supercell": [
        -6.212,
        1.714,
        -0.149,
        -0.109,
        -0.171,
        -1.087,
        -1.188,
        1.958,
        -0.339,
        -0.598,
        0.527,
        0.997,
        0.918,
        1.562,
        1.517,
    ],
}
"""For each class but ``none``: a constant, then one weight for each trait."""

CHOSEN: dict[str, list[float]] = {
    "exact": [0.0, 1.0, 0.0],
    "sub_or_supercell": [0.0, 0.0, 1.0],
}
"""For the chosen lattice: a constant, then weights of the logarithms of the first two probabilities over the third."""
