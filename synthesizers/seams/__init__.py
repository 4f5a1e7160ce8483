"""Seams between overlapping pictures: exact minimum cuts and dynamic programming."""
