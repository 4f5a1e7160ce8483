"""How the core calls a method: on a bent sample, on a large one, and for an output that repeats."""
