"""TODO nrbench.metrics.verdict."""
