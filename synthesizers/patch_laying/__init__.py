"""Square patches laid over one another in raster order, for the methods quilting and patch-based."""
