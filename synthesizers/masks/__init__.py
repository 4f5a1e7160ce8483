"""Texture masks: the regular part of a sample, which guides the methods fftm-patch and fftm-pixel."""
