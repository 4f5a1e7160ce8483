"""Displacement fields of tracked lattices."""
