"""The places and the cells that a lattice makes equal."""
