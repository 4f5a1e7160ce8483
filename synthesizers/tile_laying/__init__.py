"""Parts of `tile-set`: the shape of tiles, the tiles of a sample, and the canvas they are stitched on."""
