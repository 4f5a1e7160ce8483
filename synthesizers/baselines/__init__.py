"""Helper of the baselines tiling, supertile and shuffle: the Voronoi cell of a lattice."""
