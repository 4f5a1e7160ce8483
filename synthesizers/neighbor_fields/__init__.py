"""Nearest patches of a sample for all patches of an output, the mean of the patches found, and pyramids of images."""
