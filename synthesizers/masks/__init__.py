"""TODO nrbench.synthesizers.masks."""
