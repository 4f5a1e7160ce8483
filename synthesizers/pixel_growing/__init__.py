"""Pixel-based synthesis: outputs grown pixel by pixel, for the methods fftm-pixel and ann-pixel."""
