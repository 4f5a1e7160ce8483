"""Parts of `rsgf` and `scatter`: the blocks of an output, their patches, and the matching of patches with borders."""
