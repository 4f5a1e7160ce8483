"""TODO nrbench.detectors.rectangular_periods."""
