"""Seams between overlapping pictures: minimum cuts and dynamic programming."""
