"""Helper of the baselines tiling, supertile and shuffle, with the Voronoi cell of a lattice."""
