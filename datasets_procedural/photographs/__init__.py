"""TODO nrbench.datasets_procedural.photographs."""
