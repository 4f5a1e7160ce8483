"""Suites of textures and methods, the cells that they stand for, and their textures as files."""
