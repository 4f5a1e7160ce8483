"""TODO nrbench.synthesizers.seams."""
