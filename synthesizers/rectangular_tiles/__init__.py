"""Helpers of representative-tile: the frame of a rectangular tile."""
