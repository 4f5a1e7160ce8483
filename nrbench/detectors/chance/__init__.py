"""TODO nrbench.detectors.chance."""
