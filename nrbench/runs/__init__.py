"""TODO nrbench.runs."""
