"""Numeric kernels on images, shared by lattice detectors, methods and metrics."""
