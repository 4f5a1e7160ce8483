"""Displacement fields of textures whose geometry varies: their covariance, and tests for faults in them."""
