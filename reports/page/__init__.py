"""TODO nrbench.reports.page."""
