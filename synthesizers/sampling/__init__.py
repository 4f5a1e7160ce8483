"""TODO nrbench.synthesizers.sampling."""
