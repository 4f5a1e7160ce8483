"""Read patches of a sample at real-valued places, and find the places that a lattice makes equal."""
