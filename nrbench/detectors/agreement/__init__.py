"""TODO nrbench.detectors.agreement."""
