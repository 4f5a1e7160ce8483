"""nrbench: a benchmark for near-regular texture synthesis."""
