"""TODO nrbench.spectra."""
