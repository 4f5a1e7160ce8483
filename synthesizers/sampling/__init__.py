"""Read patches of a sample at real-valued places, find the places that a lattice makes equal, and correlate images."""
