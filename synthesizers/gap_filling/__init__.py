"""TODO nrbench.synthesizers.gap_filling."""
