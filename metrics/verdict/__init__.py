"""The verdict on regularity: reference, windows, tiles, courses, and the limits that they are compared with."""
