"""Peaks of the autocorrelation, ratings of pairs of peaks, and surrogate images of the same autocorrelation."""
