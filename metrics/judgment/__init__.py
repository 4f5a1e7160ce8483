"""The reference of a texture, and all numbers by which outputs are judged."""
