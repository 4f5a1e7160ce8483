"""TODO nrbench.synthesizers.pixel_growing."""
