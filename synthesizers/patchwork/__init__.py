"""TODO nrbench.synthesizers.patchwork."""
