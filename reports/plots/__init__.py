"""Plots that reports write as files and show on the page."""
