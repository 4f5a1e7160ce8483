"""Weights of two multinomial logistic regressions that ``benchmarks/consensus_calibration.py`` fits and prints."""

WEIGHTS: dict[str, list[float]] = {
    "exact": [
        *(-4.977, 1.823, -0.474, 1.808, -0.517, -2.572, -0.968, 2.189, -0.98, -0.841),
        *(0.407, -0.428, 0.983, 0.218, 0.958, 2.242, 1.345, 1.412, 1.023),
    ],
    "sub_or_supercell": [
        *(-3.188, 1.54, -0.384, 0.296, -0.423, -1.023, -1.061, 1.693, -0.11, 0.504),
        *(-1.032, 0.055, 0.207, -0.472, 0.215, 0.863, 0.257, 1.44, 1.295),
    ],
}
"""For any lattice, for each class but ``none``: a constant, then one weight for each trait."""
CHOSEN: dict[str, list[float]] = {
    "exact": [-1.423, 0.706, 0.247, 0.102, 0.107, -0.728],
    "sub_or_supercell": [1.966, 0.251, 0.463, 0.945, 0.37, -0.501],
}
"""For the chosen lattice: a constant, then weights of what :func:`~.short_list.describe_choice` returns."""
