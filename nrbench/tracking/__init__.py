"""Tracking of a lattice through a deformed image."""
