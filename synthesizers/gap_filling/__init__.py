"""Parts of `rsgf` and `scatter`: blocks, the canvas that joins them, and matching of patches with borders."""
