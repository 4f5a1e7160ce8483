"""Detection of straight seams in any direction."""
