"""Where content went: a lattice is followed through a bent image, which is straightened, and outputs are bent."""
