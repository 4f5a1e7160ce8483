"""TODO nrbench.metrics.appearance_differences."""
