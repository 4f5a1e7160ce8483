"""Normalized cross-correlation of windows with a periodic image."""
