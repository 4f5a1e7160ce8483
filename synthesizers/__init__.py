"""Synthesis methods, one a file."""
