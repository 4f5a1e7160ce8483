"""TODO nrbench.running."""
