"""Random projections of all patches of an image, and the matching of their distributions."""
