"""Geometry of two-dimensional lattices, and the detectors that recover one from an image."""
