"""Lattice detectors, one in each file."""
