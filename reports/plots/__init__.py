"""TODO nrbench.reports.plots."""
