"""TODO nrbench.synthesizers.tile_laying."""
