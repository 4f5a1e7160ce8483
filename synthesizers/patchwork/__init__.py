"""Patches matched to an output and cut into it along minimum cuts, for the methods graph-cuts and fftm-patch."""
