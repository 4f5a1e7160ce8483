"""Packages for authors of plugins to start from."""
