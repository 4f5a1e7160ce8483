"""TODO nrbench.metrics.whole_elements."""
