"""TODO nrbench.detectors."""
