"""TODO nrbench.metrics.ncc."""
