"""TODO nrbench.tracking."""
