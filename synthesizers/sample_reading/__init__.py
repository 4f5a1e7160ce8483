"""Read a sample at real-valued places, and record where each pixel comes from."""
