"""The lattice of a texture, followed through a picture."""
