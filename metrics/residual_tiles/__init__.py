"""TODO nrbench.metrics.residual_tiles."""
