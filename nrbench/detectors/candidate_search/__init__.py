"""How well an image agrees with itself when shifted by a lattice's vectors, and the search for the best lattice."""
