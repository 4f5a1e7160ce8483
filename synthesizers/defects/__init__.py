"""TODO nrbench.synthesizers.defects."""
