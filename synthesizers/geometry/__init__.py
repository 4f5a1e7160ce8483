"""Geometry: straighten a deformed sample, and deform the output again."""
