"""Patch-based synthesis: patches matched to an output and cut into it, for the method fftm-patch."""
