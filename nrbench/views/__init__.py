"""Detection in overlapping views of an image whose lattice changes from place to place."""
