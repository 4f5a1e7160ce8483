"""TODO nrbench.labelling."""
