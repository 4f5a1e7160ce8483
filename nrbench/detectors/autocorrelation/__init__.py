"""TODO nrbench.detectors.autocorrelation."""
