"""TODO nrbench.metrics.deformations."""
