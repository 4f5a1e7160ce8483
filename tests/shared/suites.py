"""Suites of one wall, for tests of runs."""

from __future__ import annotations

from typing import Any

from nrbench.suites.suite import Suite, validated_suite

WALL = {"name": "wall", "dataset": "brick", "parameters": {"color": 0.2}}


def wall_suite(methods: list[str], *metrics: str, **more: Any) -> Suite:
    """Return a suite of one brick wall, 64 x 64 px, scored by some metrics."""
    content = {"name": "small", "sample": "64x64", "size": "64x64", "methods": methods, "metrics": list(metrics)}
    return validated_suite({**content, "texture": [WALL], **more}, "test")
