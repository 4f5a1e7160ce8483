"""Helpers of the method ``resample``."""
