"""Geometry of two-dimensional lattices, and the comparison of an estimated lattice with the true one."""
