"""Straighten a bent sample, and bend the output as the sample is."""
