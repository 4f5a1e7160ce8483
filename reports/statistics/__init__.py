"""TODO nrbench.reports.statistics.statistics."""
