"""TODO nrbench.synthesizers.rectangular_tiles."""
