"""Texture models, one in each file, and suites of textures."""
