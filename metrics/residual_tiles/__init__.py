"""Tiles of output, sample and fresh draws, cut on one grid, and repetition among them."""
