"""TODO nrbench.suites."""
