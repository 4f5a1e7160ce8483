"""Texels: parallelograms of a sample on its lattice, chosen for an output and pasted with feathered borders."""
