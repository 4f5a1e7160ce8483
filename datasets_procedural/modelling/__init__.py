"""TODO nrbench.datasets_procedural.modelling."""
