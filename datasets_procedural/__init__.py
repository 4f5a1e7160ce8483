"""Texture models, one a file, and the suites built of them."""
