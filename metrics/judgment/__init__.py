"""The reference of a texture, and the examination of an output beside it."""
